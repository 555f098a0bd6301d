//! Asks a running daemon about itself over HTTP.

use std::io::{self, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpStream};
use std::time::Duration;

/// Maximum time for the daemon to answer: longer than a local one needs, short enough to wait for.
/// Raised, a hung daemon delays the report.
const PATIENCE: Duration = Duration::from_secs(1);
/// Maximum bytes taken of an answer: far above the status and the metrics, which are kilobytes.
/// Raised, another server could fill the report.
const MAX_BYTES: u64 = 1 << 20;

/// Returns the answer to a GET request, head and content, or why there is none.
pub(super) fn ask(listen: SocketAddr, path: &str) -> String {
    let address = match listen.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => SocketAddr::from((Ipv4Addr::LOCALHOST, listen.port())),
        IpAddr::V6(ip) if ip.is_unspecified() => SocketAddr::from((Ipv6Addr::LOCALHOST, listen.port())),
        _ => listen,
    };
    answer(address, path).unwrap_or_else(|e| format!("no answer from http://{address}{path}: {e}\n"))
}

fn answer(address: SocketAddr, path: &str) -> io::Result<String> {
    let mut stream = TcpStream::connect_timeout(&address, PATIENCE)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n")?;
    let mut bytes = Vec::new();
    stream.take(MAX_BYTES).read_to_end(&mut bytes)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}
