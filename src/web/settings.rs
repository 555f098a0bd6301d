//! Where the server listens.

use std::net::{Ipv4Addr, SocketAddr};

/// `[http]`
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HttpSettings {
    /// IP address and port; port 0 takes any free one.
    pub listen: SocketAddr,
}

impl Default for HttpSettings {
    /// Loopback: only this machine.
    fn default() -> Self {
        Self { listen: SocketAddr::from((Ipv4Addr::LOCALHOST, 8090)) }
    }
}
