//! Destinations of packets: UDP to any number of addresses; lines to TCP clients, a file or
//! standard output.
//!
//! Nothing here waits for a receiver: a datagram that the system does not accept at once is dropped
//! and counted, and a TCP client that does not read is disconnected. Trouble is logged once a
//! minute.

use std::io::{self, BufWriter, ErrorKind, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::path::{Path, PathBuf};

use socket2::Domain;

use super::complaints::Complaints;
use super::ear::Ear;
use super::network::{Interface, needs_interface, udp_sender};
use crate::safe_file;

/// UDP destinations.
#[derive(Debug, Clone, PartialEq)]
pub struct UdpSettings {
    /// Unicast, broadcast and multicast addresses; empty without UDP.
    pub to: Vec<SocketAddr>,
    /// The interface for multicasts and for link-local IPv6 addresses.
    pub interface: Option<Interface>,
    /// Number of hops that a datagram may take; 1 = stays on the local network.
    pub ttl: u8,
}

impl Default for UdpSettings {
    fn default() -> Self {
        Self { to: Vec::new(), interface: None, ttl: 1 }
    }
}

/// Destinations of JSON lines besides UDP.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StreamSettings {
    /// Address on which clients may connect.
    pub tcp_listen: Option<SocketAddr>,
    /// File to write, overwriting it; `-` is standard output.
    pub file: Option<PathBuf>,
}

/// All destinations of one output.
pub(super) struct Transport {
    udp: Option<UdpSender>,
    clients: Option<TcpClients>,
    file: Option<LineFile>,
    ear: Option<Ear>,
}

/// Why an output's destinations cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum TransportError {
    /// The socket cannot be created or configured.
    #[error("cannot send by UDP ({0}); give a network of this machine as `interface`, or leave it out")]
    Udp(io::Error),
    /// The port is taken, or the address is not this machine's.
    #[error("cannot wait for clients on {address} ({source}); give a free port on an address of this machine")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The system's error.
        source: io::Error,
    },
    /// The port is taken, or there is no such network.
    #[error("cannot hear receivers on {address} ({source}); end the program that has the port, or give a network of this machine")]
    Hear {
        /// The address.
        address: SocketAddr,
        /// The system's error.
        source: io::Error,
    },
    /// The file cannot be created.
    #[error("{file}: cannot be written ({source}); give a writable path with free space")]
    File {
        /// The file.
        file: String,
        /// The system's error.
        source: io::Error,
    },
}

impl Transport {
    /// Opens all destinations, and where receivers ask.
    pub fn open(name: &str, udp: &UdpSettings, stream: Option<&StreamSettings>, hear: Option<SocketAddr>) -> Result<Self, TransportError> {
        let listen = stream.and_then(|s| s.tcp_listen);
        let ear = |address| Ear::open(address, udp.interface.as_ref()).map_err(|source| TransportError::Hear { address, source });
        let file = stream.and_then(|s| s.file.as_deref());
        Ok(Self {
            udp: if udp.to.is_empty() { None } else { Some(UdpSender::open(name, udp).map_err(TransportError::Udp)?) },
            clients: listen.map(|address| TcpClients::listen(name, address)).transpose()?,
            file: file.map(|file| LineFile::create(name, file)).transpose()?,
            ear: hear.map(ear).transpose()?,
        })
    }

    /// Checks whether [`open`](Self::open) would succeed once the addresses for which `is_held` is
    /// true are free; creates or truncates no file.
    pub fn rehearse(
        name: &str,
        udp: &UdpSettings,
        stream: Option<&StreamSettings>,
        hear: Option<SocketAddr>,
        is_held: &dyn Fn(SocketAddr) -> bool,
    ) -> Result<(), TransportError> {
        let free = |stream: &StreamSettings| stream.tcp_listen.filter(|address| !is_held(*address));
        let without_file = stream.map(|stream| StreamSettings { file: None, tcp_listen: free(stream) });
        let hear = hear.filter(|address| !is_held(*address));
        Self::open(name, udp, without_file.as_ref(), hear)?;
        let file = stream.and_then(|stream| stream.file.as_deref()).filter(|file| *file != Path::new("-"));
        file.map_or(Ok(()), |file| {
            safe_file::may_write(file).map_err(|source| TransportError::File { file: file.display().to_string(), source })
        })
    }

    /// Sends one packet to all destinations; returns how many accepted it and how many did not.
    pub fn send(&mut self, packet: &[u8]) -> (u64, u64) {
        let mut tally = self.udp.as_mut().map_or((0, 0), |udp| udp.send(packet));
        for took in [self.clients.as_mut().and_then(|c| c.send(packet)), self.file.as_mut().and_then(|f| f.write(packet))] {
            match took {
                Some(true) => tally.0 += 1,
                Some(false) => tally.1 += 1,
                None => {}
            }
        }
        tally
    }

    /// Accepts new TCP clients, even while there is nothing to send.
    pub fn attend(&mut self) {
        if let Some(clients) = &mut self.clients {
            clients.accept();
        }
    }

    /// Returns what receivers have asked since the last call, and their addresses.
    pub fn heard(&self) -> Vec<(SocketAddr, Vec<u8>)> {
        self.ear.as_ref().map_or_else(Vec::new, Ear::heard)
    }

    /// Sends an answer to a receiver that asked; returns how many were accepted and how many not.
    pub fn answer(&self, to: SocketAddr, packet: &[u8]) -> (u64, u64) {
        match self.ear.as_ref().map(|ear| ear.answer(to, packet)) {
            Some(true) => (1, 0),
            Some(false) => (0, 1),
            None => (0, 0),
        }
    }
}

/// One socket for IPv4 and one for IPv6, if needed, so that the source port is the same for every
/// packet.
struct UdpSender {
    v4: Option<UdpSocket>,
    v6: Option<UdpSocket>,
    targets: Vec<(SocketAddr, Complaints)>,
}

/// Creates an IPv4 socket.
fn socket_v4(settings: &UdpSettings) -> io::Result<UdpSocket> {
    let socket = udp_sender(Domain::IPV4, settings.interface.as_ref())?;
    socket.set_nonblocking(true)?;
    socket.set_broadcast(true)?;
    socket.set_ttl_v4(u32::from(settings.ttl))?;
    socket.set_multicast_ttl_v4(u32::from(settings.ttl))?;
    Ok(socket.into())
}

/// Creates an IPv6 socket.
fn socket_v6(settings: &UdpSettings) -> io::Result<UdpSocket> {
    let socket = udp_sender(Domain::IPV6, settings.interface.as_ref())?;
    socket.set_nonblocking(true)?;
    socket.set_unicast_hops_v6(u32::from(settings.ttl))?;
    socket.set_multicast_hops_v6(u32::from(settings.ttl))?;
    Ok(socket.into())
}

impl UdpSender {
    fn open(name: &str, settings: &UdpSettings) -> io::Result<Self> {
        let index = settings.interface.as_ref().map_or(Ok(0), Interface::index)?;
        let v4 = settings.to.iter().any(SocketAddr::is_ipv4).then(|| socket_v4(settings)).transpose()?;
        let v6 = settings.to.iter().any(SocketAddr::is_ipv6).then(|| socket_v6(settings)).transpose()?;
        let scoped = |mut to: SocketAddr| {
            if let (true, SocketAddr::V6(v6)) = (needs_interface(&to), &mut to) {
                v6.set_scope_id(index);
            }
            to
        };
        let targets = settings.to.iter().map(|to| (scoped(*to), Complaints::new(name))).collect();
        Ok(Self { v4, v6, targets })
    }

    fn send(&mut self, packet: &[u8]) -> (u64, u64) {
        let mut tally = (0, 0);
        for (to, complaints) in &mut self.targets {
            let socket = if to.is_ipv4() { &self.v4 } else { &self.v6 };
            // `open` made a socket for each kind of target.
            let Some(socket) = socket else { continue };
            match socket.send_to(packet, *to) {
                Ok(_) => tally.0 += 1,
                Err(error) => {
                    tally.1 += 1;
                    complaints.say(|| format!("{to} cannot be reached ({error}); check the cable, the address and the firewall"));
                }
            }
        }
        tally
    }
}

/// The connected TCP clients.
struct TcpClients {
    listener: TcpListener,
    clients: Vec<Client>,
    complaints: Complaints,
}

struct Client {
    stream: TcpStream,
    peer: SocketAddr,
    /// Bytes that the system has not accepted yet.
    waiting: Vec<u8>,
}

/// Maximum backlog of a client, bytes, before it is disconnected (chosen: some seconds of lines).
/// Raised, a slow client gets older poses and takes more memory.
const MAX_WAITING: usize = 256 * 1024;
/// Maximum number of clients; further ones are turned away. A round figure above what a stage has.
/// Raised, more file descriptors and memory may be used.
const MAX_CLIENTS: usize = 64;

impl TcpClients {
    fn listen(name: &str, address: SocketAddr) -> Result<Self, TransportError> {
        let open = || -> io::Result<TcpListener> {
            let listener = TcpListener::bind(address)?;
            listener.set_nonblocking(true)?;
            Ok(listener)
        };
        let listener = open().map_err(|source| TransportError::Listen { address, source })?;
        Ok(Self { listener, clients: Vec::new(), complaints: Complaints::new(name) })
    }

    fn accept(&mut self) {
        while let Ok((stream, peer)) = self.listener.accept() {
            let is_set = stream.set_nonblocking(true).is_ok() && stream.set_nodelay(true).is_ok();
            if is_set && self.clients.len() < MAX_CLIENTS {
                self.clients.push(Client { stream, peer, waiting: Vec::new() });
            } else {
                self.complaints.say(|| format!("{peer} is refused; {MAX_CLIENTS} clients are connected"));
            }
        }
    }

    fn send(&mut self, packet: &[u8]) -> Option<bool> {
        self.accept();
        let before = self.clients.len();
        let complaints = &mut self.complaints;
        self.clients.retain_mut(|client| {
            let outcome = client.send(packet);
            if let Err(reason) = &outcome {
                complaints.say(|| format!("client {} is disconnected: {reason}", client.peer));
            }
            outcome.is_ok()
        });
        (before > 0).then_some(self.clients.len() == before)
    }
}

impl Client {
    fn send(&mut self, packet: &[u8]) -> Result<(), String> {
        if self.waiting.len() + packet.len() > MAX_WAITING {
            return Err(format!("it is {} kB behind; it must read faster", self.waiting.len() / 1024));
        }
        self.waiting.extend_from_slice(packet);
        while !self.waiting.is_empty() {
            match self.stream.write(&self.waiting) {
                Ok(0) => return Err("it closed the connection".to_owned()),
                Ok(taken) => drop(self.waiting.drain(..taken)),
                Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(e.to_string()),
            }
        }
        Ok(())
    }
}

/// A file or standard output.
struct LineFile {
    writer: BufWriter<Box<dyn Write + Send>>,
    name: String,
    complaints: Complaints,
}

impl LineFile {
    fn create(output: &str, file: &Path) -> Result<Self, TransportError> {
        let name = file.display().to_string();
        let sink: Box<dyn Write + Send> = if file == Path::new("-") {
            Box::new(io::stdout())
        } else {
            // A named pipe without a reader is refused instead of waited for; one that is full
            // loses the newest lines.
            let begun =
                safe_file::open_output(file).and_then(|to| if to.metadata()?.is_file() { to.set_len(0).map(|()| to) } else { Ok(to) });
            Box::new(begun.map_err(|source| TransportError::File { file: name.clone(), source })?)
        };
        Ok(Self { writer: BufWriter::new(sink), name, complaints: Complaints::new(output) })
    }

    fn write(&mut self, packet: &[u8]) -> Option<bool> {
        let outcome = self.writer.write_all(packet).and_then(|()| self.writer.flush());
        if let Err(error) = &outcome {
            let name = &self.name;
            self.complaints.say(|| format!("{name} cannot be written ({error}); make room"));
        }
        Some(outcome.is_ok())
    }
}

#[cfg(test)]
#[path = "transport_tests.rs"]
mod tests;
