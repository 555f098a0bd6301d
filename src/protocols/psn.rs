//! PosiStageNet 2.03: positions of any number of trackers, for lighting desks and scenery
//! automation.
//!
//! Packets consist of little-endian chunks (u32 header: bits 0-15 id, 16-30 length, 31 holds
//! chunks). Data packets come with every frame, info packets with the names once a second. PSN's
//! axes are left-handed (x right, y up, z depth): position is (x, z, y) of the stage, orientation
//! is a rotation vector whose components are the negated (x, z, y) of the stage's. Only known
//! fields are sent: position, speed, orientation, validity, time.

use nalgebra::{UnitQuaternion, Vector3};
use thiserror::Error;

use crate::geometry::{Body, Pose, Stage};

/// PosiStageNet's ids of the packets with poses and with names.
const DATA: u16 = 0x6755;
const INFO: u16 = 0x6756;
/// Maximum bytes of one packet that crosses an Ethernet in one piece (1500, less 20 for IPv4 and 8
/// for UDP); the standard's own limit is 1500.
pub const MAX_PACKET: usize = 1472;

/// The header of both kinds of packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PsnHeader {
    /// Microseconds since the sender started.
    pub timestamp_us: u64,
    /// Frame number, which wraps; the same in all packets of a frame.
    pub frame_id: u8,
    /// Number of packets in this frame.
    pub packets: u8,
}

/// A tracker in a data packet, in PSN's axes, with its known fields only.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PsnTracker {
    /// Tracker number.
    pub id: u16,
    /// Metres: right, up, depth.
    pub position_m: Option<[f32; 3]>,
    /// Metres per second.
    pub speed_m_s: Option<[f32; 3]>,
    /// Rotation vector, radians.
    pub orientation_rad: Option<[f32; 3]>,
    /// 1 = measured, 0 = not reliable.
    pub validity: Option<f32>,
    /// Metres per second squared.
    pub acceleration_m_s2: Option<[f32; 3]>,
    /// Target position, metres.
    pub target_m: Option<[f32; 3]>,
    /// Time of the position, microseconds since the sender started.
    pub timestamp_us: Option<u64>,
}

/// A packet.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum PsnPacket {
    /// Positions.
    Data(PsnHeader, Vec<PsnTracker>),
    /// Names: of the system, and of trackers by number.
    Info(PsnHeader, String, Vec<(u16, String)>),
}

/// Why bytes are not a PSN packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum PsnError {
    /// Another protocol.
    #[error("it is neither a data nor an info packet of PosiStageNet 2; set the sender to PSN 2")]
    Kind,
    /// Longer than a chunk's 15-bit length field can express.
    #[error("the packet is longer than 32767 bytes; split it")]
    TooLong,
    /// A chunk is longer than what contains it, or too short for its content.
    #[error("a chunk does not fit into its packet; the packet is damaged")]
    Length,
}

/// Converts a pose to position and rotation vector in PSN's axes.
pub fn to_psn(pose: &Pose<Stage, Body>) -> ([f32; 3], [f32; 3]) {
    let (p, w) = (pose.translation, pose.rotation.scaled_axis());
    // `+ 0.0` turns -0 into 0.
    ([p.x, p.z, p.y].map(|v| v as f32), [-w.x, -w.z, -w.y].map(|v| (v + 0.0) as f32))
}

/// Converts a velocity in the stage's axes, m/s, to PSN's.
pub fn speed_to_psn(velocity: &Vector3<f64>) -> [f32; 3] {
    [velocity.x, velocity.z, velocity.y].map(|v| (v + 0.0) as f32)
}

/// Converts PSN's position and rotation vector to a pose.
pub fn from_psn(position_m: [f32; 3], orientation_rad: [f32; 3]) -> Pose<Stage, Body> {
    let ([x, y, z], [a, b, c]) = (position_m.map(f64::from), orientation_rad.map(f64::from));
    Pose::new(UnitQuaternion::from_scaled_axis(Vector3::new(-a, -c, -b)), Vector3::new(x, z, y))
}

/// Maximum bytes in a chunk: PosiStageNet's length field has 15 bits.
const MAX_CHUNK: usize = 0x7FFF;

fn chunk(id: u16, holds_chunks: bool, content: &[u8]) -> Vec<u8> {
    let header = u32::from(id) | ((content.len() & MAX_CHUNK) as u32) << 16 | u32::from(holds_chunks) << 31;
    [&header.to_le_bytes()[..], content].concat()
}

fn vector(id: u16, v: Option<[f32; 3]>) -> Vec<u8> {
    v.map_or(Vec::new(), |v| chunk(id, false, &v.map(f32::to_le_bytes).concat()))
}

impl PsnHeader {
    fn encode(self) -> Vec<u8> {
        let version = [2, 3];
        chunk(0, false, &[&self.timestamp_us.to_le_bytes()[..], &version, &[self.frame_id, self.packets]].concat())
    }
}

impl PsnTracker {
    fn encode(&self) -> Vec<u8> {
        let fields = [
            vector(0, self.position_m),
            vector(1, self.speed_m_s),
            vector(2, self.orientation_rad),
            self.validity.map_or(Vec::new(), |v| chunk(3, false, &v.to_le_bytes())),
            vector(4, self.acceleration_m_s2),
            vector(5, self.target_m),
            self.timestamp_us.map_or(Vec::new(), |t| chunk(6, false, &t.to_le_bytes())),
        ];
        chunk(self.id, true, &fields.concat())
    }
}

impl PsnPacket {
    /// Encodes the packet.
    ///
    /// # Errors
    /// Trackers or names that do not fit into one packet.
    pub fn encode(&self) -> Result<Vec<u8>, PsnError> {
        let (kind, content) = match self {
            Self::Data(header, trackers) => {
                let trackers: Vec<u8> = trackers.iter().flat_map(PsnTracker::encode).collect();
                (DATA, [header.encode(), chunk(1, true, &trackers)].concat())
            }
            Self::Info(header, system, names) => {
                let name = |(id, name): &(u16, String)| chunk(*id, true, &chunk(0, false, name.as_bytes()));
                let names: Vec<u8> = names.iter().flat_map(name).collect();
                (INFO, [header.encode(), chunk(1, false, system.as_bytes()), chunk(2, true, &names)].concat())
            }
        };
        // The outermost chunk is the longest.
        if content.len() > MAX_CHUNK { Err(PsnError::TooLong) } else { Ok(chunk(kind, true, &content)) }
    }

    /// Decodes the bytes of a packet; ignores unknown chunks.
    ///
    /// # Errors
    /// Another protocol, or chunks that do not fit into each other.
    pub fn decode(bytes: &[u8]) -> Result<Self, PsnError> {
        let chunks = chunks(bytes).map_err(|_| PsnError::Kind)?;
        let Some((kind, content)) = chunks.first().copied().filter(|(id, _)| [DATA, INFO].contains(id)) else {
            return Err(PsnError::Kind);
        };
        let (mut header, mut system, mut trackers, mut names) = (PsnHeader::default(), String::new(), Vec::new(), Vec::new());
        for (id, content) in self::chunks(content)? {
            match (kind, id) {
                (_, 0) => header = decode_header(content)?,
                (DATA, 1) => trackers = self::chunks(content)?.into_iter().map(decode_tracker).collect::<Result<_, _>>()?,
                (INFO, 1) => system = String::from_utf8_lossy(content).into_owned(),
                (INFO, 2) => names = self::chunks(content)?.into_iter().map(decode_name).collect::<Result<_, _>>()?,
                _ => {}
            }
        }
        Ok(if kind == DATA { Self::Data(header, trackers) } else { Self::Info(header, system, names) })
    }
}

/// Returns consecutive chunks: id and content.
fn chunks(mut bytes: &[u8]) -> Result<Vec<(u16, &[u8])>, PsnError> {
    let mut found = Vec::new();
    while !bytes.is_empty() {
        let (header, rest) = bytes.split_first_chunk::<4>().ok_or(PsnError::Length)?;
        let header = u32::from_le_bytes(*header);
        let (content, rest) = rest.split_at_checked((header >> 16 & 0x7FFF) as usize).ok_or(PsnError::Length)?;
        found.push(((header & 0xFFFF) as u16, content));
        bytes = rest;
    }
    Ok(found)
}

fn array<const N: usize>(bytes: &[u8]) -> Result<[u8; N], PsnError> {
    bytes.first_chunk::<N>().copied().ok_or(PsnError::Length)
}

fn decode_header(content: &[u8]) -> Result<PsnHeader, PsnError> {
    let bytes = array::<12>(content)?;
    Ok(PsnHeader { timestamp_us: u64::from_le_bytes(array(content)?), frame_id: bytes[10], packets: bytes[11] })
}

fn decode_name((id, content): (u16, &[u8])) -> Result<(u16, String), PsnError> {
    let name =
        chunks(content)?.into_iter().find(|(id, _)| *id == 0).map_or(String::new(), |(_, n)| String::from_utf8_lossy(n).into_owned());
    Ok((id, name))
}

fn decode_tracker((id, content): (u16, &[u8])) -> Result<PsnTracker, PsnError> {
    let mut tracker = PsnTracker { id, ..PsnTracker::default() };
    let float = |bytes: &[u8]| array(bytes).map(f32::from_le_bytes);
    let vector = |bytes: &[u8]| -> Result<Option<[f32; 3]>, PsnError> {
        let bytes = array::<12>(bytes)?;
        Ok(Some([float(&bytes)?, float(&bytes[4..])?, float(&bytes[8..])?]))
    };
    for (field, content) in chunks(content)? {
        match field {
            0 => tracker.position_m = vector(content)?,
            1 => tracker.speed_m_s = vector(content)?,
            2 => tracker.orientation_rad = vector(content)?,
            3 => tracker.validity = Some(float(content)?),
            4 => tracker.acceleration_m_s2 = vector(content)?,
            5 => tracker.target_m = vector(content)?,
            6 => tracker.timestamp_us = Some(u64::from_le_bytes(array(content)?)),
            _ => {}
        }
    }
    Ok(tracker)
}

#[cfg(test)]
#[path = "psn_tests.rs"]
mod tests;
