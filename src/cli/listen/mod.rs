//! `listen`: prints the packets that arrive on a port, decoded.

mod asking;
mod packets;

use std::io::{self, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::path::Path;
use std::time::Duration;

use asking::Asking;

use super::failure::Failure;
use super::interrupt;
use crate::printable::printable;
use crate::publish::{Interface, udp_listener};

/// Print the packets that arrive on a UDP port, decoded.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  stagepose listen freed 40000\n  stagepose listen psn 56565 --group 236.10.10.10 --interface 192.168.1.10\n  \
    stagepose listen otp 5568 --group 239.159.1.1 --interface 192.168.1.10 --ask 239.159.2.1:5568"
)]
pub(super) struct ListenArguments {
    /// The protocol
    protocol: Spoken,
    /// UDP port
    #[arg(value_parser = clap::value_parser!(u16).range(1..))]
    port: u16,
    /// Multicast group to join
    #[arg(long, value_name = "ADDRESS")]
    group: Option<IpAddr>,
    /// The group's network: this machine's address on it, or for an IPv6 group the interface's
    /// name, such as eth0
    #[arg(long, value_name = "NETWORK", requires = "group", value_parser = network)]
    interface: Option<Interface>,
    /// Ask for OTP's transforms at this address, every 10 s: producers send only what is asked for
    #[arg(long, value_name = "ADDRESS:PORT")]
    ask: Option<SocketAddr>,
    /// Stop after this many packets [default: at Ctrl-C]
    #[arg(long, value_name = "N")]
    count: Option<u64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Spoken {
    Freed,
    Psn,
    Otp,
    #[value(name = "opentrackio")]
    OpenTrackIo,
    Osc,
    Json,
}

pub(super) fn run(arguments: &ListenArguments) -> Result<(), Failure> {
    interrupt::watch();
    let port = arguments.port;
    let hint = "end the program that uses the port, or check --group and --interface";
    let socket = open(arguments).map_err(|e| Failure::Publishing(format!("cannot listen on UDP port {port} ({e}); {hint}")))?;
    let mut buffer = vec![0; 65_536];
    let mut received = 0;
    let mut asking = arguments
        .ask
        .map(|to| Asking::new(to, arguments.interface.as_ref()))
        .transpose()
        .map_err(|e| Failure::Publishing(format!("cannot ask ({e}); check --ask and --interface")))?;
    while !interrupt::is_interrupted() && arguments.count.is_none_or(|count| received < count) {
        if let Some(asking) = &mut asking {
            asking.ask_if_due();
        }
        // The timeout lets Ctrl-C through; an error with one packet does not stop listening.
        let Ok((length, from)) = socket.recv_from(&mut buffer) else { continue };
        received += 1;
        print(from, &packets::line(arguments.protocol, &buffer[..length])).map_err(Failure::output(Path::new("stdout")))?;
    }
    Ok(())
}

/// Prints one line per packet, whatever characters it has.
fn print(from: SocketAddr, line: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    // Show an IPv4 sender as IPv4, even on the dual-stack socket.
    writeln!(out, "{} {}", SocketAddr::new(from.ip().to_canonical(), from.port()), printable(line))?;
    out.flush()
}

/// Opens a socket on the group, or for IPv6 and IPv4, or for IPv4 only if this machine has no IPv6.
fn open(arguments: &ListenArguments) -> io::Result<UdpSocket> {
    let at = |address| udp_listener(SocketAddr::new(address, arguments.port), arguments.interface.as_ref());
    let socket = match arguments.group {
        Some(group) => at(group)?,
        None => at(Ipv6Addr::UNSPECIFIED.into()).or_else(|e| match e.kind() {
            io::ErrorKind::AddrInUse => Err(e),
            _ => at(Ipv4Addr::UNSPECIFIED.into()),
        })?,
    };
    socket.set_read_timeout(Some(Duration::from_millis(200)))?;
    Ok(socket.into())
}

fn network(text: &str) -> Result<Interface, String> {
    Interface::parse(text).ok_or_else(|| "give this machine's IPv4 address on that network, or the network's name, such as eth0".to_owned())
}
