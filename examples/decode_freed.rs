//! Decodes FreeD D1 packets from a UDP port, or a golden packet of the tests if no port is given.
//!
//! The codecs use no sockets: bytes in, numbers out. They need only the feature `protocols`.
//!
//! ```sh
//! # The golden packet:
//! cargo run --example decode_freed --no-default-features --features protocols
//! # Listens on a port until Ctrl-C:
//! cargo run --example decode_freed --no-default-features --features protocols -- 40000
//! ```
//!
//! To send such packets, run `stagepose send-test --config config/unreal-freed.toml` with this
//! machine's address in the config.

use std::error::Error;
use std::net::{Ipv4Addr, UdpSocket};
use std::process::ExitCode;

use stagepose::protocols::freed::FreedPacket;

/// A packet from src/protocols/freed_tests.rs.
const GOLDEN: [u8; 29] = [
    0xd1, 0x07, 0xf9, 0xd3, 0xc1, 0x01, 0xa0, 0x00, 0xff, 0xc0, 0x00, 0x01, 0x34, 0xa0, 0xfd, 0xb5, 0xb0, 0x01, 0x90, 0x30, 0x00, 0x03,
    0xe8, 0x00, 0x07, 0xd0, 0x12, 0x34, 0x7b,
];

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("{e}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let Some(port) = std::env::args().nth(1) else {
        print(&FreedPacket::decode(&GOLDEN)?);
        return Ok(());
    };
    let port: u16 = port.parse().map_err(|_| format!("`{port}` is no UDP port; give a number such as 40000"))?;
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, port))?;
    // Longer than a packet, so that an oversized datagram is refused instead of truncated.
    let mut bytes = [0; 1500];
    loop {
        let (length, sender) = socket.recv_from(&mut bytes)?;
        match FreedPacket::decode(&bytes[..length]) {
            Ok(packet) => print(&packet),
            Err(e) => eprintln!("from {sender}: {e}"),
        }
    }
}

fn print(packet: &FreedPacket) {
    let [x, y, z] = packet.position_mm;
    println!("camera {}", packet.camera_id);
    println!("  pan {:.6}, tilt {:.6}, roll {:.6} degrees", packet.pan_deg, packet.tilt_deg, packet.roll_deg);
    println!("  right {x:.3}, forward {y:.3}, up {z:.3} mm");
    println!("  zoom {}, focus {}, spare {:#06x}", packet.zoom, packet.focus, packet.spare);
}
