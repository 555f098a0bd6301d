//! The network interface for multicasts: an address of this machine for IPv4, a name for IPv6; and
//! sockets that send and listen on it.

use std::ffi::CString;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use nix::libc;
use socket2::{Domain, Protocol, Socket, Type};

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

/// Opens a UDP socket that multicasts on `interface`; without one, the kernel chooses.
///
/// # Errors
/// When the system has no socket, or no such interface.
pub fn udp_sender(domain: Domain, interface: Option<&Interface>) -> io::Result<Socket> {
    let socket = Socket::new(domain, Type::DGRAM, Some(Protocol::UDP))?;
    match interface {
        Some(Interface::Address(address)) if domain == Domain::IPV4 => socket.set_multicast_if_v4(address)?,
        Some(interface) if domain == Domain::IPV6 => socket.set_multicast_if_v6(interface.index()?)?,
        _ => {}
    }
    Ok(socket)
}

/// Opens a UDP socket that listens on an address of this machine, or on a multicast group, which it
/// joins on `interface`. Any address of IPv6 also hears IPv4.
///
/// # Errors
/// When the port is taken, the address is not this machine's, or there is no such interface.
pub fn udp_listener(at: SocketAddr, interface: Option<&Interface>) -> io::Result<Socket> {
    let socket = Socket::new(Domain::for_address(at), Type::DGRAM, Some(Protocol::UDP))?;
    // Other programs on this machine may listen to the same group.
    socket.set_reuse_address(at.ip().is_multicast())?;
    let index = interface.map_or(Ok(0), Interface::index)?;
    let mut bound = at;
    if let SocketAddr::V6(v6) = &mut bound {
        socket.set_only_v6(false)?;
        if needs_interface(&at) {
            v6.set_scope_id(index);
        }
    }
    socket.bind(&bound.into())?;
    match (at.ip(), interface) {
        (IpAddr::V4(group), Some(Interface::Name(_))) if group.is_multicast() => {
            return Err(io::Error::other("an IPv4 group needs this machine's address on the network, not its name"));
        }
        (IpAddr::V4(group), Some(Interface::Address(address))) if group.is_multicast() => socket.join_multicast_v4(&group, address)?,
        (IpAddr::V4(group), None) if group.is_multicast() => socket.join_multicast_v4(&group, &Ipv4Addr::UNSPECIFIED)?,
        (IpAddr::V6(group), _) if group.is_multicast() => socket.join_multicast_v6(&group, index)?,
        _ => {}
    }
    Ok(socket)
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
