//! Poses from the log of another tracker: a TUM trajectory, a pose record (contract C3), or a
//! capture of FreeD or OpenTrackIO packets.
//!
//! The format is recognised by the first bytes. The tracked axes differ between formats (a record's
//! are the camera's optical ones, FreeD's and OpenTrackIO's the body's).

mod capture;
mod record;
mod tum;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use thiserror::Error;

use crate::frame::Timestamp;
use crate::protocols::freed::FreedPacket;

/// How far a quaternion's length may be from 1: digits are cut off in logs. Raised, columns in
/// another order pass for a quaternion.
const LENGTH_TOLERANCE: f64 = 0.02;

/// A pose in a log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoggedPose {
    /// Its stamp, on the log's own clock.
    pub at: Timestamp,
    /// Rotation from the tracked axes to fixed ones.
    pub rotation: UnitQuaternion<f64>,
    /// Position in the fixed axes, metres.
    pub position: Vector3<f64>,
}

/// What a log holds.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseLog {
    /// Poses in the order of the file.
    pub rows: Vec<LoggedPose>,
    /// Whether the stamps are UTC, by the format's definition.
    pub is_utc: bool,
}

/// Why a log cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum LogError {
    /// A line is not what the format says.
    #[error("line {line}: {problem}")]
    Line {
        /// Its number, from 1.
        line: usize,
        /// What is wrong, and what is wanted.
        problem: String,
    },
    /// There are no poses in it.
    #[error(
        "no pose in it; give a TUM trajectory (t tx ty tz qx qy qz qw), a pose record (.jsonl) or a capture of FreeD or OpenTrackIO packets (.pcap)"
    )]
    Empty,
    /// FreeD packets without stamps.
    #[error(
        "FreeD packets without time stamps: the protocol has none, so nothing says when each arrived; capture them with `tcpdump -w \
         freed.pcap udp port PORT`, which stamps every packet"
    )]
    NoStamps,
    /// A capture file that is damaged or of another kind.
    #[error("{0}")]
    Capture(&'static str),
}

/// Reads a log.
///
/// # Errors
/// When a line or packet is damaged, there are no poses, or the packets have no stamps.
pub fn read(bytes: &[u8]) -> Result<PoseLog, LogError> {
    let is_text_of_json = bytes.trim_ascii_start().first() == Some(&b'{');
    let log = match bytes {
        _ if capture::is_capture(bytes) => PoseLog { rows: capture::read(bytes)?, is_utc: true },
        _ if bytes.get(..crate::protocols::freed::LENGTH).is_some_and(|first| FreedPacket::decode(first).is_ok()) => {
            return Err(LogError::NoStamps);
        }
        _ if is_text_of_json => PoseLog { rows: record::read(bytes)?, is_utc: false },
        _ => PoseLog { rows: tum::read(bytes)?, is_utc: false },
    };
    if log.rows.is_empty() { Err(LogError::Empty) } else { Ok(log) }
}

/// Returns the lines of a text with their numbers, from 1, without blank ones.
fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    bytes
        .split(|byte| *byte == b'\n')
        .map(<[u8]>::trim_ascii)
        .zip(1..)
        .filter(|(text, _)| !text.is_empty())
        .map(|(text, line)| (line, text))
}

/// Returns the rotation of a quaternion x, y, z, w, or what is wrong with it.
fn rotation([x, y, z, w]: [f64; 4]) -> Result<UnitQuaternion<f64>, String> {
    let quaternion = Quaternion::new(w, x, y, z);
    let length = quaternion.norm();
    if (length - 1.0).abs() <= LENGTH_TOLERANCE {
        return Ok(UnitQuaternion::from_quaternion(quaternion));
    }
    Err(format!("the quaternion {x} {y} {z} {w} has length {length:.3}, not 1; its order is x y z w"))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn every_format_is_recognised() {
        let tum = "# t tx ty tz qx qy qz qw\n\n1.5 0 0 0 0 0 0 1\r\n2,0,0,0,0.7071,0,0,0.7071\n";
        let read_tum = read(tum.as_bytes()).unwrap();
        assert_eq!(read_tum.rows.iter().map(|row| row.at.ns()).collect::<Vec<_>>(), [1_500_000_000, 2_000_000_000]);
        assert!((read_tum.rows[1].rotation.angle() - std::f64::consts::FRAC_PI_2).abs() < 1e-3 && !read_tum.is_utc);
        let pose = r#"{"position_m":[0,0,0],"orientation_xyzw":[0,0,0,1]}"#;
        let jsonl = format!(
            "{{\"timestamp_ns\":7,\"state\":\"tracking\",\"pose\":null,\"measured\":{pose}}}\n{{\"timestamp_ns\":8,\"state\":\"lost\",\"pose\":null}}\n"
        );
        assert_eq!(read(jsonl.as_bytes()).unwrap().rows.len(), 1);
        let packet = FreedPacket::default().encode().0;
        assert_eq!(read(&packet.repeat(3)), Err(LogError::NoStamps));
        assert_eq!(read(b"# nothing\n"), Err(LogError::Empty));
        assert_eq!(read(b""), Err(LogError::Empty));
    }

    #[test]
    fn mistakes_name_the_line() {
        for (text, part) in [
            ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n", "line 2: 7 numbers, not the 8 of a TUM line"),
            ("1 0 0 0 0 0 0 1\n\n2 0 0 0 0 0 0 x\n", "line 3: \"x\" is not a number"),
            ("1 0 0 0 3 0 0 1\n", "line 1: the quaternion 3 0 0 1 has length 3.162, not 1; its order is x y z w"),
            ("1e300 0 0 0 0 0 0 1\n", "line 1: the stamp 1e300 is not in seconds"),
            ("{\"timestamp_ns\":1}\n", "line 1: not a pose record"),
            ("\u{feff}hello\n", "line 1: 1 numbers"),
        ] {
            let said = read(text.as_bytes()).unwrap_err().to_string();
            assert!(said.contains(part), "{text}: {said}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused_with_a_sentence(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            prop_assert!(read(&bytes).map_err(|e| e.to_string().len()) != Err(0));
        }

        #[test]
        fn a_trajectory_reads_as_it_was_written(rows in proptest::collection::vec((-1e9..1e9_f64, -1.0..1.0_f64, -1.0..1.0_f64), 1..20)) {
            let rotated = |x: f64, y: f64| UnitQuaternion::from_euler_angles(x, y, 0.3);
            let line = |(t, x, y): &(f64, f64, f64)| {
                let q = rotated(*x, *y).coords;
                format!("{t:.9} 1 2 3 {} {} {} {}\n", q.x, q.y, q.z, q.w)
            };
            let read = read(rows.iter().map(line).collect::<String>().as_bytes()).unwrap();
            for (LoggedPose { at, rotation, position }, (t, x, y)) in read.rows.iter().zip(&rows) {
                prop_assert_eq!(*position, Vector3::new(1.0, 2.0, 3.0));
                prop_assert!((at.seconds() - t).abs() < 1e-6 && rotation.angle_to(&rotated(*x, *y)) < 1e-7);
            }
        }
    }
}
