//! systemd's notification protocol: sends READY, STATUS, WATCHDOG and STOPPING as datagrams to
//! $NOTIFY_SOCKET, if it is set.

use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::Duration;

/// The connection to the service manager.
pub(super) struct Notifier {
    socket: Option<(UnixDatagram, SocketAddr)>,
    /// Interval at which WATCHDOG=1 is due, if the manager has a watchdog.
    pub watchdog: Option<Duration>,
}

impl Notifier {
    /// Connects as the environment that systemd sets says.
    pub fn from_environment() -> Self {
        let name = std::env::var("NOTIFY_SOCKET").ok();
        let number = |name: &str| std::env::var(name).ok().and_then(|v| v.parse::<u64>().ok());
        let for_us = number("WATCHDOG_PID").is_none_or(|pid| pid == u64::from(std::process::id()));
        // Half of the manager's limit, as its manual advises.
        let watchdog = number("WATCHDOG_USEC").filter(|us| for_us && *us > 0).map(|us| Duration::from_micros(us / 2));
        Self { socket: name.as_deref().and_then(connect), watchdog }
    }

    /// Sends lines such as "READY=1"; it never waits for the manager.
    pub fn send(&self, lines: &str) {
        if let Some((socket, address)) = &self.socket {
            let _ = socket.send_to_addr(lines.as_bytes(), address);
        }
    }
}

fn connect(name: &str) -> Option<(UnixDatagram, SocketAddr)> {
    let address = match name.strip_prefix('@') {
        Some(name) => SocketAddr::from_abstract_name(name),
        None => SocketAddr::from_pathname(name),
    };
    let socket = UnixDatagram::unbound().ok()?;
    socket.set_nonblocking(true).ok()?;
    Some((socket, address.ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notify_reaches_both_socket_kinds_or_none_without_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let abstract_name = format!("stagepose-test-{}", std::process::id());
        let manager_at = [
            (UnixDatagram::bind(&path).unwrap(), path.to_str().unwrap().to_owned()),
            (UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&abstract_name).unwrap()).unwrap(), format!("@{abstract_name}")),
        ];
        for (manager, name) in manager_at {
            Notifier { socket: connect(&name), watchdog: None }.send("READY=1");
            let mut buffer = [0; 64];
            let n = manager.recv(&mut buffer).unwrap();
            assert_eq!(&buffer[..n], b"READY=1");
        }
        Notifier { socket: connect("/no/such/socket"), watchdog: None }.send("READY=1");
        Notifier { socket: None, watchdog: None }.send("READY=1");
    }
}
