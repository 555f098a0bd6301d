//! What the page can see and change of a running daemon: one file a resource. Each handler runs aside, on a thread that stands back
//! behind the tracker.

mod backup;
mod config;
mod findings;
mod gltf;
mod health;
mod recordings;
mod sets;
mod steering;
mod timeline;

use std::sync::Arc;

use serde_json::json;

use super::entrance::About;
use super::reply::Reply;
use super::routes::Route;
use crate::daemon::Supervisor;

/// All of them.
pub fn routes(supervisor: &Arc<Supervisor>) -> Vec<Route> {
    let resources = [steering::routes, recordings::routes, config::routes, backup::routes, sets::routes, health::routes];
    resources.into_iter().flat_map(|resource| resource(supervisor)).collect()
}

/// What the daemon says of itself in /api/v1/session.
pub fn about(supervisor: &Arc<Supervisor>) -> About {
    let supervisor = supervisor.clone();
    Box::new(move || json!({"mode": supervisor.mode().word(), "config_file": supervisor.file()}))
}

/// Something that the system did not do.
fn failed(what: &str, error: &std::io::Error) -> Reply {
    Reply::text(500, format!("{what}: {error}\n"))
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::{Ipv4Addr, TcpStream};
    use std::path::Path;

    use super::*;
    use crate::config::{HttpSettings, Settings};
    use crate::daemon::live::LiveLink;
    use crate::web::Server;

    /// A daemon's supervisor with a small good config in this folder.
    pub(super) fn supervised(folder: &Path) -> Arc<Supervisor> {
        let picture = image::GrayImage::from_fn(128, 96, |x, y| image::Luma([((x * 37 + y * 91) % 251) as u8]));
        picture.save(folder.join("backdrop.png")).unwrap();
        let file = folder.join("stage.toml");
        let text = "[camera]\nfov_deg = 60\n[[stage.surface]]\nimage = \"backdrop.png\"\nsize_m = [4.0, 3.0]\n[recorder]\nfolder = \"recordings\"\n";
        std::fs::write(&file, text).unwrap();
        let supervisor = Arc::new(Supervisor::new(&file, LiveLink::default()));
        supervisor.use_settings(Settings::load(&file).unwrap());
        supervisor
    }

    /// Status and content of a request to a server with these routes.
    pub(super) fn asked(routes: &[Route], method: &str, path: &str, content: &[u8]) -> (u16, Vec<u8>) {
        asked_with(routes, method, path, "", content)
    }

    /// The same with more headers.
    pub(super) fn asked_with(routes: &[Route], method: &str, path: &str, headers: &str, content: &[u8]) -> (u16, Vec<u8>) {
        let settings = HttpSettings { listen: (Ipv4Addr::LOCALHOST, 0).into(), hosts: Vec::new() };
        let server = Server::start(&settings, routes.to_vec()).unwrap();
        let mut stream = TcpStream::connect(server.address()).unwrap();
        let length = content.len();
        let head = format!("{method} {path} HTTP/1.0\r\nHost: localhost\r\nContent-Length: {length}\r\n{headers}\r\n");
        stream.write_all(head.as_bytes()).unwrap();
        // It may have heard enough before all is read.
        let _ = stream.write_all(content);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        let at = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap_or(answer.len());
        let status = String::from_utf8_lossy(&answer[..at]).split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
        (status, answer.split_off((at + 4).min(answer.len())))
    }
}
