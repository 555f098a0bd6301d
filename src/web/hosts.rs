//! The host names that the server answers to.
//!
//! A page on the web can point its own name to this machine (DNS rebinding); its scripts could then
//! read from and command the server as their own. Their requests still carry that name as `Host`.
//! So only local names are answered: loopback's, the machine's own addresses and host name, and the
//! config's additions.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::config::HostName;

/// The system's names for loopback, as in /etc/hosts.
const LOOPBACK_NAMES: [&str; 3] = ["localhost", "ip6-localhost", "ip6-loopback"];
/// Lifetime of the cached list of the machine's addresses: a network may come up while the server
/// runs. The query takes about 0.1 ms, which a flood of requests must not cost each time. Raised, a
/// new address is refused for longer.
const ADDRESSES_LAST: Duration = Duration::from_secs(5);
/// A host with its port, as `Host` and `Origin` write them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct HostAndPort {
    pub host: HostName,
    /// The port as written.
    pub port: Option<u16>,
}

impl HostAndPort {
    pub fn parse(text: &str) -> Option<Self> {
        // An IPv6 address has its own colons and is in brackets.
        let end = if text.starts_with('[') { text.find(']')? + 1 } else { text.find(':').unwrap_or(text.len()) };
        let (host, port) = text.split_at(end);
        let port = match port.strip_prefix(':') {
            None if port.is_empty() => None,
            Some("") => None,
            Some(digits) if digits.bytes().all(|b| b.is_ascii_digit()) => Some(digits.parse().ok()?),
            _ => return None,
        };
        Some(Self { host: HostName::parse(host)?, port })
    }

    /// Whether both are the same place, with a missing port being the scheme's default.
    pub fn is_at(&self, other: &Self, default_port: u16) -> bool {
        self.host == other.host && self.port.unwrap_or(default_port) == other.port.unwrap_or(default_port)
    }
}

/// The hosts that the server answers for.
#[derive(Debug)]
pub struct AllowedHosts {
    /// Loopback's and the machine's own names.
    names: Vec<String>,
    /// From the config.
    added: Vec<HostName>,
    /// The machine's addresses, and when they were queried.
    own: Mutex<Option<(Instant, Vec<IpAddr>)>>,
}

impl AllowedHosts {
    /// Allows the machine's hosts and these.
    pub fn new(added: &[HostName]) -> Self {
        let mut names: Vec<String> = LOOPBACK_NAMES.map(str::to_owned).into();
        if let Some(HostName::Name(own)) = nix::unistd::gethostname().ok().and_then(|name| HostName::parse(name.to_str()?)) {
            // The full name, its first label, and that label as multicast DNS announces it.
            let first = own.split('.').next().unwrap_or(&own).to_owned();
            names.extend([format!("{first}.local"), first, own]);
        }
        names.dedup();
        Self { names, added: added.to_vec(), own: Mutex::new(None) }
    }

    /// Whether to answer a request for this host that came in at the address `reached`.
    pub(super) fn allows(&self, host: &HostName, reached: IpAddr) -> bool {
        self.added.contains(host)
            || match host {
                HostName::Name(name) => self.names.contains(name),
                HostName::Address(address) => {
                    address.is_loopback() || *address == reached.to_canonical() || self.own_addresses().contains(address)
                }
            }
    }

    /// Returns the machine's addresses, at most a few seconds old.
    fn own_addresses(&self) -> Vec<IpAddr> {
        let mut own = self.own.lock().unwrap_or_else(PoisonError::into_inner);
        match &*own {
            Some((asked, addresses)) if asked.elapsed() < ADDRESSES_LAST => addresses.clone(),
            _ => {
                let addresses = addresses_of_this_machine();
                *own = Some((Instant::now(), addresses.clone()));
                addresses
            }
        }
    }

    /// Lists all allowed hosts, for people.
    pub fn listing(&self) -> String {
        let addresses = self.own_addresses().into_iter().filter(|address| !address.is_loopback()).map(|address| address.to_string());
        let loopback = ["127.0.0.1", "::1"].map(str::to_owned).into_iter();
        let all = self.names.iter().cloned().chain(loopback).chain(addresses).chain(self.added.iter().map(HostName::to_string));
        all.collect::<Vec<_>>().join(", ")
    }
}

/// Returns the address to type into a browser for a server that listens here. If the server listens
/// on all addresses, it returns the one for this machine and the one for others.
pub fn page_address(listen: SocketAddr) -> String {
    page_address_among(listen, &addresses_of_this_machine())
}

fn page_address_among(listen: SocketAddr, own: &[IpAddr]) -> String {
    let at = |address: IpAddr| format!("http://{}/", SocketAddr::new(address, listen.port()));
    if !listen.ip().is_unspecified() {
        return at(listen.ip());
    }
    let here = at(Ipv4Addr::LOCALHOST.into());
    let is_reached = |address: &&IpAddr| address.is_ipv4() && !address.is_loopback();
    own.iter().find(is_reached).map_or(here.clone(), |address| format!("{here}, from other machines {}", at(*address)))
}

/// Returns the system's list of addresses; empty if that fails.
fn addresses_of_this_machine() -> Vec<IpAddr> {
    let Ok(interfaces) = nix::ifaddrs::getifaddrs() else { return Vec::new() };
    let address = |interface: nix::ifaddrs::InterfaceAddress| {
        let address = interface.address?;
        let v4 = address.as_sockaddr_in().map(|a| IpAddr::V4(a.ip()));
        v4.or_else(|| address.as_sockaddr_in6().map(|a| IpAddr::V6(a.ip())))
    };
    interfaces.filter_map(address).collect()
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;

    #[test]
    fn host_headers_parse_in_every_form() {
        let read = |text: &str| HostAndPort::parse(text).map(|h| (h.host.to_string(), h.port));
        for (text, host, port) in [
            ("localhost", "localhost", None),
            ("LocalHost.:8090", "localhost", Some(8090)),
            ("[::1]:80", "::1", Some(80)),
            ("[::ffff:10.0.0.7]", "10.0.0.7", None),
            ("10.0.0.7:", "10.0.0.7", None),
            ("stage_pi-2.example.org:1", "stage_pi-2.example.org", Some(1)),
        ] {
            assert_eq!(read(text), Some((host.to_owned(), port)), "{text}");
        }
        let long = "a".repeat(254);
        let odd = [
            "",
            ":80",
            "::1",
            "[::1",
            "[::1]x",
            "[localhost]",
            "[10.0.0.7]",
            "a:b",
            "a:+1",
            "a:65536",
            "a..b",
            "a b",
            "a/b",
            "u@a",
            "a%2e",
            "ä",
        ];
        for text in odd.into_iter().chain([long.as_str()]) {
            assert_eq!(read(text), None, "{text}");
        }
    }

    #[test]
    fn the_page_address_is_one_a_browser_can_reach() {
        let own = ["127.0.0.1", "fe80::1", "192.0.2.7"].map(|address| address.parse().unwrap());
        let named = |listen: &str| page_address_among(listen.parse().unwrap(), &own);
        assert_eq!(named("127.0.0.1:8090"), "http://127.0.0.1:8090/");
        assert_eq!(named("[::1]:80"), "http://[::1]:80/");
        assert_eq!(named("0.0.0.0:8090"), "http://127.0.0.1:8090/, from other machines http://192.0.2.7:8090/");
        assert_eq!(page_address_among("0.0.0.0:1".parse().unwrap(), &own[..2]), "http://127.0.0.1:1/");
    }

    #[test]
    fn only_this_machine_and_configured_hosts_are_allowed() {
        let hosts = AllowedHosts::new(&["stage.example.org", "192.0.2.7"].map(|h| HostName::parse(h).unwrap()));
        let reached = IpAddr::from([192, 0, 2, 200]);
        let allowed = |text: &str| hosts.allows(&HostName::parse(text).unwrap(), reached);
        let machine = nix::unistd::gethostname().unwrap().into_string().unwrap();
        let first = format!("{}.local", machine.split('.').next().unwrap());
        for host in ["localhost", "127.0.0.1", "127.8.9.1", "[::1]", "192.0.2.7", "192.0.2.200", "STAGE.example.org.", &machine, &first] {
            assert!(allowed(host), "{host}");
        }
        for host in ["evil.example", "localhost.evil.example", "127.1", "0.0.0.0", "192.0.2.8", "example.org", "2130706433"] {
            assert!(!allowed(host), "{host}");
        }
        for address in addresses_of_this_machine() {
            assert!(hosts.allows(&HostName::Address(address.to_canonical()), Ipv4Addr::LOCALHOST.into()), "{address}");
        }
        assert!(hosts.listing().starts_with("localhost, ") && hosts.listing().ends_with("stage.example.org, 192.0.2.7"));
    }
}
