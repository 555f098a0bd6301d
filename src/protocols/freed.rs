//! FreeD D1: 29 bytes per frame, read by nearly every studio renderer.
//!
//! Layout and signs follow the Vinten Radamec free-d manual (A.3.2, appendix B): big-endian, angles
//! in 1/32768 degree, positions in 1/64 mm, pan positive to the RIGHT (the opposite of
//! OpenTrackIO), tilt up, roll clockwise from behind. It has no time stamp and no validity; Mo-Sys
//! puts a quality into the spare bytes, Sony a frame number.

use thiserror::Error;

use super::body_pose::PanTiltRoll;
use crate::geometry::{Body, Pose, Stage};

/// Bytes of a D1 packet in the Free-D protocol.
pub const LENGTH: usize = 29;
/// Free-D's constants: a D1 packet's first byte, units per degree (15 fractional bits) and per
/// millimetre (6 bits), the maximum of a signed 24-bit number.
const TYPE: u8 = 0xD1;
const PER_DEGREE: f64 = 32768.0;
const PER_MM: f64 = 64.0;
const GREATEST_24: f64 = 8_388_607.0;

/// A D1 packet in physical units.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FreedPacket {
    /// 0 to 255.
    pub camera_id: u8,
    /// Degrees, + to the right.
    pub pan_deg: f64,
    /// Degrees, + up.
    pub tilt_deg: f64,
    /// Degrees, + clockwise from behind.
    pub roll_deg: f64,
    /// Right, forward, up: millimetres.
    pub position_mm: [f64; 3],
    /// 24 bits, in the receiver's own scale.
    pub zoom: u32,
    /// 24 bits, in the receiver's own scale.
    pub focus: u32,
    /// 16 bits.
    pub spare: u16,
}

/// Why bytes are not a D1 packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum FreedError {
    /// The length is not 29.
    #[error("{0} bytes are not a FreeD D1 packet; it has 29")]
    Length(usize),
    /// Another message of the protocol, or another protocol.
    #[error("the first byte is {0:#04x}, not 0xd1; set the sender to FreeD D1")]
    Type(u8),
    /// The checksum does not match.
    #[error("the checksum is {found:#04x}, not {wanted:#04x}; the packet is damaged")]
    Checksum {
        /// As received.
        found: u8,
        /// As computed.
        wanted: u8,
    },
}

impl FreedPacket {
    /// Creates the packet of a body's pose. Pass the packet's roll as `last_roll_deg` of the next
    /// one, for gimbal lock.
    pub fn of_pose(camera_id: u8, pose: &Pose<Stage, Body>, last_roll_deg: f64) -> Self {
        let angles = PanTiltRoll::of_rotation(&pose.rotation, last_roll_deg);
        let p = pose.translation * 1e3;
        let (pan_deg, position_mm) = (-angles.pan_deg + 0.0, [p.x, p.y, p.z]);
        Self { camera_id, pan_deg, tilt_deg: angles.tilt_deg, roll_deg: angles.roll_deg, position_mm, zoom: 0, focus: 0, spare: 0 }
    }

    /// Returns the bytes, and whether a number was clamped to what 24 bits hold (±256 degrees,
    /// ±131.07 m).
    pub fn encode(&self) -> ([u8; LENGTH], bool) {
        let mut bytes = [0; LENGTH];
        (bytes[0], bytes[1]) = (TYPE, self.camera_id);
        let mut is_cut = false;
        let angles = [self.pan_deg, self.tilt_deg, self.roll_deg].map(|v| v * PER_DEGREE);
        let positions = self.position_mm.map(|v| v * PER_MM);
        for (index, value) in angles.into_iter().chain(positions).enumerate() {
            let units = value.round();
            is_cut |= !(-GREATEST_24 - 1.0..=GREATEST_24).contains(&units);
            // The cast turns NaN into 0.
            let units = units.clamp(-GREATEST_24 - 1.0, GREATEST_24) as i32;
            bytes[2 + 3 * index..5 + 3 * index].copy_from_slice(&units.to_be_bytes()[1..]);
        }
        bytes[20..23].copy_from_slice(&self.zoom.min(0xFF_FFFF).to_be_bytes()[1..]);
        bytes[23..26].copy_from_slice(&self.focus.min(0xFF_FFFF).to_be_bytes()[1..]);
        bytes[26..28].copy_from_slice(&self.spare.to_be_bytes());
        bytes[28] = checksum(&bytes[..28]);
        (bytes, is_cut)
    }

    /// Decodes the bytes of a packet.
    ///
    /// # Errors
    /// Another length or type, or a wrong checksum.
    pub fn decode(bytes: &[u8]) -> Result<Self, FreedError> {
        let bytes: &[u8; LENGTH] = bytes.try_into().map_err(|_| FreedError::Length(bytes.len()))?;
        if bytes[0] != TYPE {
            return Err(FreedError::Type(bytes[0]));
        }
        let wanted = checksum(&bytes[..28]);
        if bytes[28] != wanted {
            return Err(FreedError::Checksum { found: bytes[28], wanted });
        }
        let unsigned = |at: usize| u32::from_be_bytes([0, bytes[at], bytes[at + 1], bytes[at + 2]]);
        // Shifting left and back right extends the sign of bit 23.
        let signed = |at: usize| f64::from((unsigned(at) << 8) as i32 >> 8);
        Ok(Self {
            camera_id: bytes[1],
            pan_deg: signed(2) / PER_DEGREE,
            tilt_deg: signed(5) / PER_DEGREE,
            roll_deg: signed(8) / PER_DEGREE,
            position_mm: [signed(11), signed(14), signed(17)].map(|v| v / PER_MM),
            zoom: unsigned(20),
            focus: unsigned(23),
            spare: u16::from_be_bytes([bytes[26], bytes[27]]),
        })
    }
}

/// Returns 0x40 minus the sum of the bytes, modulo 256.
fn checksum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0x40, |sum, b| sum.wrapping_sub(*b))
}

#[cfg(test)]
#[path = "freed_tests.rs"]
mod tests;
