//! The network interface for multicasts: an address of this machine for IPv4, a name for IPv6.

use std::ffi::CString;
use std::io;
use std::net::{Ipv4Addr, SocketAddr};

use nix::libc;

/// A network interface, as named in the config or an argument.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Interface {
    /// This machine's address on it; for IPv4.
    Address(Ipv4Addr),
    /// Its name, such as "eth0"; for IPv6.
    Name(String),
}

impl Interface {
    /// Parses an IPv4 address, or an interface name as allowed by Linux.
    pub fn parse(text: &str) -> Option<Self> {
        if let Ok(address) = text.parse() {
            return Some(Self::Address(address));
        }
        let is_name = (1..16).contains(&text.len())
            && !text.starts_with('.')
            && !text.contains([':', '/'])
            && text.chars().all(|c| c.is_ascii_graphic());
        is_name.then(|| Self::Name(text.to_owned()))
    }

    /// Returns the kernel's index of the interface, which IPv6 needs; 0 (the kernel's choice) for
    /// an IPv4 address.
    ///
    /// # Errors
    /// When there is no interface of this name.
    pub fn index(&self) -> io::Result<u32> {
        let Self::Name(name) = self else { return Ok(0) };
        let index = CString::new(name.as_str()).map_or(0, |name| {
            // SAFETY: it only reads a zero-terminated string, which outlives the call.
            unsafe { libc::if_nametoindex(name.as_ptr()) }
        });
        let missing = || io::Error::new(io::ErrorKind::NotFound, format!("this machine has no network {name}"));
        (index != 0).then_some(index).ok_or_else(missing)
    }
}

/// Whether an address is only reachable if the interface is stated.
pub fn needs_interface(to: &SocketAddr) -> bool {
    match to {
        SocketAddr::V4(to) => to.ip().is_multicast(),
        SocketAddr::V6(to) => to.scope_id() == 0 && (to.ip().is_multicast() || to.ip().is_unicast_link_local()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_and_interface_names_are_distinguished() {
        assert_eq!(Interface::parse("192.168.1.10"), Some(Interface::Address(Ipv4Addr::new(192, 168, 1, 10))));
        assert_eq!(Interface::parse("enp0s31f6"), Some(Interface::Name("enp0s31f6".to_owned())));
        for text in ["", "../eth0", "eth 0", "::1", "averyverylongname", "."] {
            assert_eq!(Interface::parse(text), None, "{text}");
        }
        assert!(Interface::Name("lo".to_owned()).index().unwrap() > 0);
        assert!(Interface::Name("nonet7".to_owned()).index().unwrap_err().to_string().contains("no network nonet7"));
    }

    #[test]
    fn multicast_and_link_local_need_an_interface() {
        let needs = ["239.1.2.3:1", "192.168.1.2:1", "[ff15::1]:1", "[fe80::1]:1", "[fe80::1%2]:1", "[fd00::1]:1"]
            .map(|a| needs_interface(&a.parse().unwrap()));
        assert_eq!(needs, [true, false, true, true, false, false]);
    }
}
