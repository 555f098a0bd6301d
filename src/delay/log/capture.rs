//! FreeD or OpenTrackIO packets in a capture file of libpcap, which stamps each packet with the
//! time of its arrival in UTC.
//!
//! The file's format is that of `pcap-savefile(5)`: a header of 24 bytes, whose magic number tells
//! the byte order and the unit of fractions, then packets, each with a header of 16 bytes. A FreeD
//! packet is the last 29 bytes of a network packet, whatever the link layer before it is; an
//! OpenTrackIO packet begins with its identifier. Checksums tell both from others.

use super::{LogError, LoggedPose};
use crate::frame::Timestamp;
use crate::geometry::{Body, Pose, Stage};
use crate::protocols::camera_packet::{CameraPacket, CameraSource};
use crate::protocols::freed::{FreedPacket, LENGTH};
use crate::protocols::opentrackio;

/// The format's magic numbers, with microseconds and with nanoseconds, and that of `pcapng`, which
/// is another format.
const MICROSECONDS: u32 = 0xA1B2_C3D4;
const NANOSECONDS: u32 = 0xA1B2_3C4D;
const NEXT_GENERATION: u32 = 0x0A0D_0D0A;
/// Lengths of the file's header and of each packet's, bytes: the format's.
const FILE_HEADER: usize = 24;
const PACKET_HEADER: usize = 16;

/// How a file's numbers are written.
struct Form {
    is_big_endian: bool,
    ns_per_unit: i64,
}

impl Form {
    fn of(bytes: &[u8]) -> Option<Self> {
        let magic: [u8; 4] = bytes.get(..4)?.try_into().ok()?;
        [false, true].into_iter().find_map(|is_big_endian| {
            let number = if is_big_endian { u32::from_be_bytes(magic) } else { u32::from_le_bytes(magic) };
            let ns_per_unit = match number {
                MICROSECONDS => 1000,
                NANOSECONDS => 1,
                _ => return None,
            };
            Some(Self { is_big_endian, ns_per_unit })
        })
    }

    /// Reads the 32-bit number at a place.
    fn number(&self, bytes: &[u8], at: usize) -> Option<u32> {
        let four: [u8; 4] = bytes.get(at..at.checked_add(4)?)?.try_into().ok()?;
        Some(if self.is_big_endian { u32::from_be_bytes(four) } else { u32::from_le_bytes(four) })
    }
}

/// Whether the bytes begin like a capture file, of either format.
pub(super) fn is_capture(bytes: &[u8]) -> bool {
    Form::of(bytes).is_some() || bytes.get(..4) == Some(&NEXT_GENERATION.to_be_bytes())
}

/// Reads the packets of the sender that comes first; other packets are skipped.
pub(super) fn read(bytes: &[u8]) -> Result<Vec<LoggedPose>, LogError> {
    let pcapng = "a pcapng capture, which is not read; save it as pcap (`tcpdump -w` does, or Wireshark's \"Save As\")";
    let form = Form::of(bytes).ok_or(LogError::Capture(pcapng))?;
    let mut rest = bytes.get(FILE_HEADER..).unwrap_or_default();
    let (mut rows, mut first) = (Vec::new(), None);
    // The last packet may be cut off when a capture is stopped.
    while let (Some(seconds), Some(fraction), Some(length)) = (form.number(rest, 0), form.number(rest, 4), form.number(rest, 8)) {
        let Some(packet) = rest.get(PACKET_HEADER..).and_then(|rest| rest.get(..length as usize)) else { break };
        rest = &rest[PACKET_HEADER + packet.len()..];
        let Some((source, pose)) = camera(packet) else { continue };
        if *first.get_or_insert(source.clone()) != source {
            continue;
        }
        let at = Timestamp::from_ns(i64::from(seconds) * 1_000_000_000 + i64::from(fraction) * form.ns_per_unit);
        rows.push(LoggedPose { at, rotation: pose.rotation, position: pose.translation });
    }
    Ok(rows)
}

/// Decodes the FreeD packet at the end of a network packet, or the OpenTrackIO sample in it; one
/// without a pose is skipped.
fn camera(packet: &[u8]) -> Option<(CameraSource, Pose<Stage, Body>)> {
    let freed = || FreedPacket::decode(packet.get(packet.len().checked_sub(LENGTH)?..)?).ok();
    let sample = || {
        let at = packet.windows(4).position(|four| four == b"OTrk")?;
        Some(CameraPacket::of_sample(&opentrackio::decode(&packet[at..]).ok()?.1))
    };
    let read = freed().map(|freed| CameraPacket::of_freed(&freed)).or_else(sample)?;
    Some((read.source, read.pose?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocols::PanTiltRoll;

    /// A capture of packets with their stamps, behind 42 bytes of Ethernet, IP and UDP.
    fn capture(is_big_endian: bool, packets: &[(u32, u32, FreedPacket)]) -> Vec<u8> {
        let number = |n: u32| if is_big_endian { n.to_be_bytes() } else { n.to_le_bytes() };
        let mut bytes = [number(NANOSECONDS).as_slice(), &[0; 20]].concat();
        for (seconds, fraction, packet) in packets {
            let length = (42 + LENGTH) as u32;
            [*seconds, *fraction, length, length].iter().for_each(|n| bytes.extend(number(*n)));
            bytes.extend([7; 42]);
            bytes.extend(packet.encode().0);
        }
        bytes
    }

    #[test]
    fn packets_of_one_camera_are_read_in_either_byte_order() {
        let packet = |camera_id, pan_deg| FreedPacket { camera_id, pan_deg, ..FreedPacket::default() };
        for is_big_endian in [false, true] {
            let bytes = capture(is_big_endian, &[(5, 40, packet(1, 10.0)), (5, 60, packet(2, 50.0)), (6, 1, packet(1, 12.0))]);
            let rows = read(&bytes).unwrap();
            assert_eq!(rows.iter().map(|row| row.at.ns()).collect::<Vec<_>>(), [5_000_000_040, 6_000_000_001]);
            assert!((rows[0].rotation.angle_to(&rows[1].rotation).to_degrees() - 2.0).abs() < 1e-4);
            // To the right is clockwise from above.
            assert!((rows[0].rotation.scaled_axis().z.to_degrees() + 10.0).abs() < 1e-4);
            // A capture that was cut off, anywhere.
            for length in 0..bytes.len() {
                assert!(read(&bytes[..length]).is_ok_and(|rows| rows.len() < 2) || length < 4, "{length}");
            }
        }
    }

    #[test]
    fn samples_of_one_opentrackio_source_are_read() {
        let sample = |source: &str, x: f64| {
            let text = format!(
                r#"{{"sourceId":"{source}","transforms":[{{"translation":{{"x":{x},"y":-4,"z":1.5}},"rotation":{{"pan":30,"tilt":-5,"roll":1}}}}]}}"#
            );
            opentrackio::datagram(opentrackio::Encoding::Json, 1, text.as_bytes()).unwrap()
        };
        let lost =
            opentrackio::datagram(opentrackio::Encoding::Json, 2, br#"{"sourceId":"a","tracker":{"status":"Optical Lost"}}"#).unwrap();
        let mut bytes = [NANOSECONDS.to_le_bytes().as_slice(), &[0; 20]].concat();
        for (second, packet) in [sample("a", 1.0), sample("b", 9.0), lost, sample("a", 2.0)].iter().enumerate() {
            let length = (42 + packet.len()) as u32;
            [second as u32, 0, length, length].iter().for_each(|n| bytes.extend(n.to_le_bytes()));
            bytes.extend([7; 42]);
            bytes.extend(packet);
        }
        let rows = read(&bytes).unwrap();
        let found: Vec<_> = rows.iter().map(|row| (row.at.ns(), row.position.x)).collect();
        assert_eq!(found, [(0, 1.0), (3_000_000_000, 2.0)]);
        let angles = PanTiltRoll { pan_deg: 30.0, tilt_deg: -5.0, roll_deg: 1.0 };
        assert!(rows[0].rotation.angle_to(&angles.rotation()) < 1e-12);
    }

    #[test]
    fn the_other_capture_format_is_named() {
        assert!(is_capture(&NEXT_GENERATION.to_be_bytes()));
        assert!(read(&NEXT_GENERATION.to_be_bytes()).unwrap_err().to_string().contains("save it as pcap"));
    }
}
