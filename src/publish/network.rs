//! The network of this machine that multicasts leave by: an address of it for IPv4, its name for IPv6.

use std::ffi::CString;
use std::io;
use std::net::{Ipv4Addr, SocketAddr};

use nix::libc;

/// A network of this machine, as a config or an argument names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Interface {
    /// This machine's address on it; for IPv4.
    Address(Ipv4Addr),
    /// Its name, such as "eth0"; for IPv6.
    Name(String),
}

impl Interface {
    /// An IPv4 address, else a name as Linux allows it.
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

    /// The number that the kernel gives it, which IPv6 asks for; 0, the kernel's own choice, where it is an IPv4 address.
    ///
    /// # Errors
    /// Where there is no network of this name.
    pub fn index(&self) -> io::Result<u32> {
        let Self::Name(name) = self else { return Ok(0) };
        let index = CString::new(name.as_str()).map_or(0, |name| {
            // SAFETY: it reads a string that ends in a zero byte and lives on.
            unsafe { libc::if_nametoindex(name.as_ptr()) }
        });
        let missing = || io::Error::new(io::ErrorKind::NotFound, format!("this machine has no network {name}"));
        (index != 0).then_some(index).ok_or_else(missing)
    }
}

/// Whether an address must name the network that it is reached by.
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
    fn addresses_and_names_are_told_apart() {
        assert_eq!(Interface::parse("192.168.1.10"), Some(Interface::Address(Ipv4Addr::new(192, 168, 1, 10))));
        assert_eq!(Interface::parse("enp0s31f6"), Some(Interface::Name("enp0s31f6".to_owned())));
        for text in ["", "../eth0", "eth 0", "::1", "averyverylongname", "."] {
            assert_eq!(Interface::parse(text), None, "{text}");
        }
        assert!(Interface::Name("lo".to_owned()).index().unwrap() > 0);
        assert!(Interface::Name("nonet7".to_owned()).index().unwrap_err().to_string().contains("no network nonet7"));
    }

    #[test]
    fn multicast_and_link_local_need_one() {
        let needs = ["239.1.2.3:1", "192.168.1.2:1", "[ff15::1]:1", "[fe80::1]:1", "[fe80::1%2]:1", "[fd00::1]:1"]
            .map(|a| needs_interface(&a.parse().unwrap()));
        assert_eq!(needs, [true, false, true, true, false, false]);
    }
}
