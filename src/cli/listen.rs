//! `listen`: prints the packets of a protocol that arrive on a port, decoded.

use std::io::{self, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::path::Path;
use std::time::Duration;

use rosc::{OscPacket, OscType, decoder};
use socket2::{Domain, Protocol, Socket, Type};

use super::failure::Failure;
use super::interrupt;
use crate::publish::Interface;
use crate::publish::freed::FreedPacket;
use crate::publish::opentrackio;
use crate::publish::psn::{PsnPacket, PsnTracker};

/// Print what arrives on a UDP port, decoded.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  stagepose listen freed 40000\n  stagepose listen psn 56565 --group 236.10.10.10 --interface 192.168.1.10"
)]
pub(super) struct ListenArguments {
    /// What is spoken
    protocol: Spoken,
    /// UDP port
    #[arg(value_parser = clap::value_parser!(u16).range(1..))]
    port: u16,
    /// Multicast group to join
    #[arg(long, value_name = "ADDRESS")]
    group: Option<IpAddr>,
    /// The network of the group: this machine's address on it, or for an IPv6 group its name, such as eth0
    #[arg(long, value_name = "NETWORK", requires = "group", value_parser = network)]
    interface: Option<Interface>,
    /// End after this many packets [default: at Ctrl-C]
    #[arg(long, value_name = "N")]
    count: Option<u64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Spoken {
    Freed,
    Psn,
    #[value(name = "opentrackio")]
    OpenTrackIo,
    Osc,
}

pub(super) fn run(arguments: &ListenArguments) -> Result<(), Failure> {
    interrupt::watch();
    let port = arguments.port;
    let mend = "end the program that has the port, or check --group and --interface";
    let socket = open(arguments).map_err(|e| Failure::Publishing(format!("cannot listen on UDP port {port} ({e}); {mend}")))?;
    let mut buffer = vec![0; 65_536];
    let mut heard = 0;
    while !interrupt::is_interrupted() && arguments.count.is_none_or(|count| heard < count) {
        // The time limit lets Ctrl-C through; other errors of one packet do not end the listening.
        let Ok((length, from)) = socket.recv_from(&mut buffer) else { continue };
        heard += 1;
        let line = line(arguments.protocol, &buffer[..length]);
        print(from, &line).map_err(Failure::output(Path::new("stdout")))?;
    }
    Ok(())
}

fn print(from: SocketAddr, line: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    // An IPv4 sender is shown as such, also where IPv6 listens for both.
    writeln!(out, "{} {line}", SocketAddr::new(from.ip().to_canonical(), from.port()))?;
    out.flush()
}

/// A socket for IPv6 and IPv4, or for IPv4 alone where the group is of it or this machine has no IPv6.
fn open(arguments: &ListenArguments) -> io::Result<UdpSocket> {
    let v6 = || bound(arguments, Domain::IPV6, Ipv6Addr::UNSPECIFIED.into());
    let v4 = || bound(arguments, Domain::IPV4, Ipv4Addr::UNSPECIFIED.into());
    let socket = match arguments.group {
        Some(IpAddr::V4(group)) => {
            let socket = v4()?;
            let address = match &arguments.interface {
                None => Ipv4Addr::UNSPECIFIED,
                Some(Interface::Address(address)) => *address,
                Some(Interface::Name(_)) => return Err(io::Error::other("an IPv4 group needs this machine's address as --interface")),
            };
            socket.join_multicast_v4(&group, &address)?;
            socket
        }
        Some(IpAddr::V6(group)) => {
            let socket = v6()?;
            socket.join_multicast_v6(&group, arguments.interface.as_ref().map_or(Ok(0), Interface::index)?)?;
            socket
        }
        None => v6().or_else(|e| if e.kind() == io::ErrorKind::AddrInUse { Err(e) } else { v4() })?,
    };
    socket.set_read_timeout(Some(Duration::from_millis(200)))?;
    Ok(socket.into())
}

fn bound(arguments: &ListenArguments, domain: Domain, address: IpAddr) -> io::Result<Socket> {
    let socket = Socket::new(domain, Type::DGRAM, Some(Protocol::UDP))?;
    // Others may listen to the same multicast.
    socket.set_reuse_address(arguments.group.is_some())?;
    if domain == Domain::IPV6 {
        socket.set_only_v6(false)?;
    }
    socket.bind(&SocketAddr::from((address, arguments.port)).into())?;
    Ok(socket)
}

fn network(text: &str) -> Result<Interface, String> {
    Interface::parse(text).ok_or_else(|| "give this machine's IPv4 address on that network, or the network's name, such as eth0".to_owned())
}

/// One packet as a line.
fn line(protocol: Spoken, bytes: &[u8]) -> String {
    let decoded = match protocol {
        Spoken::Freed => FreedPacket::decode(bytes).map(|p| freed(&p)).map_err(|e| e.to_string()),
        Spoken::Psn => PsnPacket::decode(bytes).map(|p| psn(&p)).map_err(|e| e.to_string()),
        Spoken::OpenTrackIo => {
            opentrackio::decode(bytes).map(|(sequence, sample)| format!("#{sequence} {sample}")).map_err(|e| e.to_string())
        }
        Spoken::Osc => {
            decoder::decode_udp(bytes).map(|(_, p)| osc(&p)).map_err(|_| "it is no OSC packet; check the sender's port".to_owned())
        }
    };
    decoded.unwrap_or_else(|reason| format!("{} bytes: {reason}", bytes.len()))
}

fn freed(p: &FreedPacket) -> String {
    let [x, y, z] = p.position_mm;
    format!(
        "camera {} pan {:.4} tilt {:.4} roll {:.4} deg, x {x:.2} y {y:.2} z {z:.2} mm, zoom {} focus {} spare {:#06x}",
        p.camera_id, p.pan_deg, p.tilt_deg, p.roll_deg, p.zoom, p.focus, p.spare
    )
}

fn psn(packet: &PsnPacket) -> String {
    match packet {
        PsnPacket::Info(header, system, names) => {
            let names: Vec<String> = names.iter().map(|(id, name)| format!("{id} {name}")).collect();
            format!("info frame {}: {system}: {}", header.frame_id, names.join(", "))
        }
        PsnPacket::Data(header, trackers) => {
            let trackers: Vec<String> = trackers.iter().map(psn_tracker).collect();
            format!("data frame {}: {}", header.frame_id, trackers.join("; "))
        }
    }
}

fn psn_tracker(tracker: &PsnTracker) -> String {
    let mut text = format!("tracker {}", tracker.id);
    for (what, vector, unit) in [("position", tracker.position_m, "m"), ("orientation", tracker.orientation_rad, "rad")] {
        if let Some([a, b, c]) = vector {
            text += &format!(" {what} {a:.4} {b:.4} {c:.4} {unit}");
        }
    }
    text + &tracker.validity.map_or(String::new(), |v| format!(" validity {v}"))
}

fn osc(packet: &OscPacket) -> String {
    match packet {
        OscPacket::Message(message) => {
            let arguments: Vec<String> = message.args.iter().map(osc_argument).collect();
            format!("{} {}", message.addr, arguments.join(" "))
        }
        OscPacket::Bundle(bundle) => bundle.content.iter().map(osc).collect::<Vec<_>>().join(" | "),
    }
}

fn osc_argument(argument: &OscType) -> String {
    match argument {
        OscType::Int(v) => v.to_string(),
        OscType::Float(v) => format!("{v:.4}"),
        OscType::String(v) => v.clone(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::publish::psn::PsnHeader;

    #[test]
    fn packets_become_lines() {
        let packet = FreedPacket {
            camera_id: 7,
            pan_deg: -12.5,
            tilt_deg: 3.25,
            roll_deg: 0.0,
            position_mm: [1.0, -2.5, 1600.0],
            zoom: 4800,
            focus: 0,
            spare: 1,
        };
        let wanted = "camera 7 pan -12.5000 tilt 3.2500 roll 0.0000 deg, x 1.00 y -2.50 z 1600.00 mm, zoom 4800 focus 0 spare 0x0001";
        assert_eq!(line(Spoken::Freed, &packet.encode().0), wanted);
        let info = PsnPacket::Info(PsnHeader::default(), "s".to_owned(), vec![(1, "camera".to_owned())]);
        assert_eq!(line(Spoken::Psn, &info.encode()), "info frame 0: s: 1 camera");
        let sample = opentrackio::datagram(opentrackio::Encoding::Json, 4, br#"{"a":1}"#).unwrap();
        assert_eq!(line(Spoken::OpenTrackIo, &sample), r##"#4 {"a":1}"##);
        assert!(line(Spoken::Freed, b"hello").starts_with("5 bytes: 5 bytes are no FreeD"));
        assert!(line(Spoken::Osc, b"hello").contains("no OSC packet"));
    }
}
