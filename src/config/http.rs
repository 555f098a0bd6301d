//! `[http]`: where the server listens, and for which hosts it answers.

use std::net::{Ipv4Addr, SocketAddr};

use super::host_name::HostName;

/// `[http]`
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HttpSettings {
    /// IP address and port; port 0 takes any free one.
    pub listen: SocketAddr,
    /// Hosts that are answered for beside this machine's own.
    pub hosts: Vec<HostName>,
}

impl Default for HttpSettings {
    /// Loopback: only this machine.
    fn default() -> Self {
        Self { listen: SocketAddr::from((Ipv4Addr::LOCALHOST, 8090)), hosts: Vec::new() }
    }
}
