//! `[http]`: where the server listens, and for which hosts it answers.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

/// The `[http]` section.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HttpSettings {
    /// IP address and port; port 0 takes any free one.
    pub listen: SocketAddr,
    /// Hosts that are answered in addition to this machine's own.
    pub hosts: Vec<HostName>,
}

impl Default for HttpSettings {
    /// Loopback: this machine only.
    fn default() -> Self {
        Self { listen: SocketAddr::from((Ipv4Addr::LOCALHOST, 8090)), hosts: Vec::new() }
    }
}

/// Maximum length of a DNS name, characters (RFC 1035: 255 bytes including the length bytes).
const MAX_NAME: usize = 253;

/// A host without its port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum HostName {
    /// An IP address; IPv4-mapped IPv6 becomes IPv4.
    Address(IpAddr),
    /// A name in lower case, without a trailing dot.
    Name(String),
}

impl HostName {
    /// Parses an IP address (IPv6 with or without brackets) or a name; `None` for anything else,
    /// including a trailing port.
    pub fn parse(text: &str) -> Option<Self> {
        let bare = text.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).filter(|inner| inner.parse::<Ipv6Addr>().is_ok());
        if let Ok(address) = bare.unwrap_or(text).parse::<IpAddr>() {
            return Some(Self::Address(address.to_canonical()));
        }
        let name = text.strip_suffix('.').unwrap_or(text);
        let is_label = |label: &str| !label.is_empty() && label.bytes().all(|b| b.is_ascii_alphanumeric() || b"-_".contains(&b));
        let is_name = name.len() <= MAX_NAME && name.split('.').all(is_label);
        is_name.then(|| Self::Name(name.to_ascii_lowercase()))
    }
}

impl fmt::Display for HostName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address(address) => write!(f, "{address}"),
            Self::Name(name) => f.write_str(name),
        }
    }
}
