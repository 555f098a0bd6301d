//! What the page can see and change of a running daemon, with one file per resource. Each handler
//! runs on a separate thread with lower priority than the tracker's.

mod backup;
#[cfg(feature = "calibrate")]
mod boards;
mod clock;
mod commands;
mod config;
mod drafts;
mod findings;
mod gltf;
mod health;
mod line_index;
mod recordings;
mod retrack;
mod sets;
mod setup;
mod steering;
mod timeline;
mod uploads;

use std::sync::Arc;

use serde::Serialize;
use serde_json::json;

pub use self::gltf::judge as judge_model;
use self::line_index::LineIndex;
use super::entrance::About;
use super::reply::Reply;
use super::routes::Route;
use crate::daemon::Supervisor;
use crate::publish::FrameClock;

/// Returns all routes; ages are by `clock`.
pub fn routes(supervisor: &Arc<Supervisor>, clock: &Arc<FrameClock>) -> Vec<Route> {
    let resources =
        [steering::routes, config::routes, backup::routes, sets::routes, health::routes, setup::routes, drafts::routes, uploads::routes];
    let lines: Arc<LineIndex> = Arc::default();
    let of_recordings =
        [recordings::routes(supervisor, &lines), retrack::routes(supervisor, &lines), commands::routes(supervisor, &lines)].concat();
    #[cfg(feature = "calibrate")]
    let of_recordings = [of_recordings, boards::routes(supervisor)].concat();
    let probes = health::probes(&supervisor.link.statistics, clock);
    resources.into_iter().flat_map(|resource| resource(supervisor)).chain(of_recordings).chain(probes).chain([clock::route()]).collect()
}

/// Returns the daemon's description for /api/v1/session.
pub fn about(supervisor: &Arc<Supervisor>) -> About {
    let supervisor = supervisor.clone();
    Box::new(move || {
        let findings = findings::of_refused(&supervisor);
        json!({
            "mode": supervisor.mode().word(), "config_file": supervisor.file(),
            "has_config": supervisor.settings().is_some(), "findings": findings,
        })
    })
}

/// Returns an answer in JSON; serialising fails only for paths that are not UTF-8.
fn answer(value: &impl Serialize) -> Result<Reply, Reply> {
    let text = serde_json::to_string(value).map_err(|e| Reply::text(500, format!("a name cannot be sent: {e}\n")))?;
    Ok(Reply::json(200, text))
}

/// Returns the reply for an operation that the system refused.
fn failed(what: &str, error: &std::io::Error) -> Reply {
    Reply::text(500, format!("{what}: {error}\n"))
}

#[cfg(test)]
mod guarded_tests;
#[cfg(test)]
mod hostile_tests;
#[cfg(test)]
mod late_tests;
#[cfg(test)]
pub(super) mod types_tests;

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::{Ipv4Addr, SocketAddr, TcpStream};
    use std::path::Path;

    use super::*;
    use crate::config::{HttpSettings, Settings};
    use crate::daemon::live::LiveLink;
    use crate::web::{Server, Site};

    /// Returns a daemon's supervisor with a small valid config in this folder.
    pub(super) fn supervised(folder: &Path) -> Arc<Supervisor> {
        let picture = image::GrayImage::from_fn(128, 96, |x, y| image::Luma([((x * 37 + y * 91) % 251) as u8]));
        picture.save(folder.join("backdrop.png")).unwrap();
        let file = folder.join("stage.toml");
        let text = "[camera]\nfov_deg = 60\n[[stage.surface]]\nimage = \"backdrop.png\"\nsize_m = [4.0, 3.0]\n[recorder]\nfolder = \"recordings\"\n";
        std::fs::write(&file, text).unwrap();
        let supervisor = Arc::new(Supervisor::new(&file, LiveLink::default()));
        supervisor.use_settings(Some(Settings::load(&file).unwrap()));
        supervisor
    }

    /// Returns status and content of a request to a server with these routes.
    pub(super) fn respond(routes: &[Route], method: &str, path: &str, content: &[u8]) -> (u16, Vec<u8>) {
        respond_with(routes, method, path, "", content)
    }

    /// As [`respond`], with additional headers.
    pub(super) fn respond_with(routes: &[Route], method: &str, path: &str, headers: &str, content: &[u8]) -> (u16, Vec<u8>) {
        let settings = HttpSettings { listen: (Ipv4Addr::LOCALHOST, 0).into(), hosts: Vec::new() };
        let server = Server::start(&settings, routes.to_vec()).unwrap();
        let answer = exchange(server.address(), method, path, &format!("Host: localhost\r\n{headers}"), content);
        (answer.status, answer.content)
    }

    /// An answer; status 0 if there was none.
    #[derive(Debug)]
    pub(super) struct Answer {
        pub status: u16,
        /// Status line and headers, in lower case.
        pub head: String,
        pub content: Vec<u8>,
    }

    impl Answer {
        pub fn text(&self) -> String {
            String::from_utf8_lossy(&self.content).into_owned()
        }

        /// Returns all values of a header.
        pub fn values(&self, name: &str) -> Vec<&str> {
            let named = self.head.lines().filter_map(|line| line.split_once(": ")).filter(|(of, _)| *of == name);
            named.map(|(_, value)| value).collect()
        }
    }

    /// Sends a request with these headers to a running server.
    pub(super) fn exchange(server: SocketAddr, method: &str, path: &str, headers: &str, content: &[u8]) -> Answer {
        let mut stream = TcpStream::connect(server).unwrap();
        let head = format!("{method} {path} HTTP/1.0\r\nContent-Length: {}\r\n{headers}\r\n", content.len());
        stream.write_all(head.as_bytes()).unwrap();
        // The server may answer before it has read everything.
        let _ = stream.write_all(content);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        let at = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap_or(answer.len());
        let content = answer.split_off((at + 4).min(answer.len()));
        let head = String::from_utf8_lossy(&answer).to_lowercase();
        Answer { status: head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0), head, content }
    }

    /// Starts a server with all routes of a daemon.
    pub(super) fn whole_server(supervisor: &Arc<Supervisor>, page_dir: Option<&Path>) -> Server {
        whole_site(supervisor, Site { page_dir: page_dir.map(Path::to_owned), ..Site::default() })
    }

    /// As [`whole_server`], with the site's optional parts.
    pub(super) fn whole_site(supervisor: &Arc<Supervisor>, site: Site) -> Server {
        let settings = HttpSettings { listen: (Ipv4Addr::LOCALHOST, 0).into(), hosts: Vec::new() };
        let clock = Arc::new(FrameClock::new(crate::publish::Stamps::Live));
        // A test asks more often than people do, so it has no rate limits.
        let routes = routes(supervisor, &clock).into_iter().map(|route| Route { pace: None, ..route }).collect();
        let site = Site { about: Some(about(supervisor)), ..site };
        Server::start_site(&settings, routes, site).unwrap()
    }
}
