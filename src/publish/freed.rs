//! FreeD D1: 29 bytes a frame that nearly every studio renderer reads.
//!
//! Layout and signs from the Vinten Radamec free-d manual (A.3.2, appendix B): big-endian, angles in 1/32768 degree, positions in
//! 1/64 mm, pan positive to the RIGHT (the opposite of OpenTrackIO), tilt up, roll clockwise from behind. It has no time stamp and
//! no validity; Mo-Sys puts a quality into the spare bytes, Sony a frame number.

use thiserror::Error;

use super::body_pose::PanTiltRoll;
use super::encoder::Encoder;
use super::report::{BodyReport, Report};
use crate::camera::CameraModel;
use crate::geometry::{Body, Pose, Stage};

/// Bytes of a D1 packet.
pub const LENGTH: usize = 29;
const TYPE: u8 = 0xD1;
const PER_DEGREE: f64 = 32768.0;
const PER_MM: f64 = 64.0;
const GREATEST_24: f64 = 8_388_607.0;

/// What the two spare bytes say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spare {
    /// Mo-Sys: the low byte is 1 good, 2 caution, 3 bad.
    Quality,
    /// The low 16 bits of the frame's number.
    Frame,
    /// Sony: the frame's number in the upper 4 bits, the iris (unknown, 0) below.
    Sony,
    /// Always 0.
    Zero,
}

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
    /// 24 bits, the receiver's own scale.
    pub zoom: u32,
    /// 24 bits, the receiver's own scale.
    pub focus: u32,
    /// 16 bits.
    pub spare: u16,
}

/// Why bytes are no D1 packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum FreedError {
    /// Another length.
    #[error("{0} bytes are no FreeD D1 packet; it has 29")]
    Length(usize),
    /// Another message of the protocol, or another protocol.
    #[error("the first byte is {0:#04x}, not 0xd1; set the sender to FreeD D1")]
    Type(u8),
    /// Damaged.
    #[error("the checksum is {found:#04x}, not {wanted:#04x}; the packet is damaged")]
    Checksum {
        /// As received.
        found: u8,
        /// As computed.
        wanted: u8,
    },
}

impl FreedPacket {
    /// The packet of a body's pose, and the roll that its angles have (for the next gimbal case).
    pub fn of_pose(camera_id: u8, pose: &Pose<Stage, Body>, last_roll_deg: f64) -> Self {
        let angles = PanTiltRoll::of_rotation(&pose.rotation, last_roll_deg);
        let p = pose.translation * 1e3;
        let (pan_deg, position_mm) = (-angles.pan_deg + 0.0, [p.x, p.y, p.z]);
        Self { camera_id, pan_deg, tilt_deg: angles.tilt_deg, roll_deg: angles.roll_deg, position_mm, zoom: 0, focus: 0, spare: 0 }
    }

    /// The bytes, and whether a number had to be cut to what 24 bits hold (±256 degrees, ±131.07 m).
    pub fn encode(&self) -> ([u8; LENGTH], bool) {
        let mut bytes = [0; LENGTH];
        (bytes[0], bytes[1]) = (TYPE, self.camera_id);
        let mut is_cut = false;
        let angles = [self.pan_deg, self.tilt_deg, self.roll_deg].map(|v| v * PER_DEGREE);
        let positions = self.position_mm.map(|v| v * PER_MM);
        for (index, value) in angles.into_iter().chain(positions).enumerate() {
            let units = value.round();
            is_cut |= !(-GREATEST_24 - 1.0..=GREATEST_24).contains(&units);
            // A float beyond the range saturates in the cast, NaN becomes 0.
            let units = units.clamp(-GREATEST_24 - 1.0, GREATEST_24) as i32;
            bytes[2 + 3 * index..5 + 3 * index].copy_from_slice(&units.to_be_bytes()[1..]);
        }
        bytes[20..23].copy_from_slice(&self.zoom.min(0xFF_FFFF).to_be_bytes()[1..]);
        bytes[23..26].copy_from_slice(&self.focus.min(0xFF_FFFF).to_be_bytes()[1..]);
        bytes[26..28].copy_from_slice(&self.spare.to_be_bytes());
        bytes[28] = checksum(&bytes[..28]);
        (bytes, is_cut)
    }

    /// Reads the bytes of a packet.
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
        // Shifted up and down again, the sign of bit 23 is carried.
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

/// 0x40 minus the sum of the bytes, modulo 256.
fn checksum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0x40, |sum, b| sum.wrapping_sub(*b))
}

/// How an output speaks FreeD.
#[derive(Debug, Clone, PartialEq)]
pub struct FreedSettings {
    /// Camera number in the packets.
    pub camera_id: u8,
    /// What the spare bytes say.
    pub spare: Spare,
    /// Zoom as sent, 24 bits; by default the calibrated focal length in micrometres on the assumed sensor.
    pub zoom: Option<u32>,
    /// Width of the sensor that the focal length is told for, millimetres.
    pub sensor_width_mm: f64,
    /// Focus as sent: 24 bits.
    pub focus: u32,
}

/// Turns reports into D1 packets.
pub(super) struct FreedEncoder {
    settings: FreedSettings,
    zoom: u32,
    last: Option<FreedPacket>,
}

impl FreedEncoder {
    /// Without a lens that is known the zoom is 0, unless the config gives one.
    pub fn new(settings: FreedSettings, camera: Option<&CameraModel>) -> Self {
        let focal_mm = |camera: &CameraModel| camera.intrinsics().fx * settings.sensor_width_mm / f64::from(camera.width());
        // A float beyond the range saturates in the cast.
        let zoom = settings.zoom.or(camera.map(|camera| (focal_mm(camera) * 1e3).round() as u32)).unwrap_or(0);
        Self { settings, zoom, last: None }
    }

    fn packet(&self, body: &BodyReport) -> Option<FreedPacket> {
        // Nothing is known: the last pose again, marked as bad; never an invented one.
        let Some(pose) = &body.pose else { return self.last };
        let last_roll_deg = self.last.map_or(0.0, |p| p.roll_deg);
        Some(FreedPacket::of_pose(self.settings.camera_id, pose, last_roll_deg))
    }

    fn spare(&self, report: &Report, body: &BodyReport) -> u16 {
        match self.settings.spare {
            Spare::Quality => match body.confidence() {
                c if c >= 1.0 => 1,
                c if c > 0.0 => 2,
                _ => 3,
            },
            // The counters wrap.
            Spare::Frame => report.sequence as u16,
            Spare::Sony => (report.sequence as u16) << 12,
            Spare::Zero => 0,
        }
    }
}

impl Encoder for FreedEncoder {
    fn encode(&mut self, report: &Report, send: &mut dyn FnMut(&[u8])) {
        let Some(body) = report.bodies.first() else { return };
        let Some(mut packet) = self.packet(body) else { return };
        (packet.zoom, packet.focus) = (self.zoom, self.settings.focus);
        packet.spare = self.spare(report, body);
        // A pose that does not fit never comes here.
        let (bytes, _) = packet.encode();
        self.last = Some(packet);
        send(&bytes);
    }

    fn holds(&self, pose: &Pose<Stage, Body>) -> bool {
        !FreedPacket::of_pose(0, pose, 0.0).encode().1
    }

    fn marks_coasting(&self) -> bool {
        self.settings.spare == Spare::Quality
    }

    fn marks_loss(&self) -> bool {
        self.settings.spare == Spare::Quality
    }

    fn announces_loss(&self) -> bool {
        false
    }
}

#[cfg(test)]
#[path = "freed_tests.rs"]
mod tests;
