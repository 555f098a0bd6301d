//! A FreeD output: every report of its single body becomes a D1 packet, with the quality in its
//! spare bytes.

use super::encoder::Encoder;
use super::report::{BodyReport, Report};
use super::rings::Rings;
use crate::camera::CameraModel;
use crate::geometry::{Body, Pose, Stage};
use crate::protocols::camera_packet::Ring;
use crate::protocols::freed::FreedPacket;

/// The content of the two spare bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spare {
    /// Mo-Sys: the low byte is 1 good, 2 caution, 3 bad.
    Quality,
    /// The low 16 bits of the frame number.
    Frame,
    /// Sony: the frame number in the upper 4 bits, the iris (unknown, 0) below.
    Sony,
    /// Always 0.
    Zero,
}

/// Settings of a FreeD output.
#[derive(Debug, Clone, PartialEq)]
pub struct FreedSettings {
    /// Camera number in the packets.
    pub camera_id: u8,
    /// Content of the spare bytes.
    pub spare: Spare,
    /// Zoom to send, 24 bits; defaults to the calibrated focal length in micrometres on the assumed
    /// sensor.
    pub zoom: Option<u32>,
    /// Width of the assumed sensor, millimetres.
    pub sensor_width_mm: f64,
    /// Focus to send, 24 bits.
    pub focus: u32,
}

/// Turns reports into D1 packets.
pub(super) struct FreedEncoder {
    settings: FreedSettings,
    zoom: u32,
    last: Option<FreedPacket>,
}

impl FreedEncoder {
    /// Creates an encoder. Without a known lens the zoom is 0, unless configured.
    pub fn new(settings: FreedSettings, camera: Option<&CameraModel>) -> Self {
        let focal_mm = |camera: &CameraModel| camera.intrinsics().fx * settings.sensor_width_mm / f64::from(camera.width());
        // The cast saturates.
        let zoom = settings.zoom.or(camera.map(|camera| (focal_mm(camera) * 1e3).round() as u32)).unwrap_or(0);
        Self { settings, zoom, last: None }
    }

    fn packet(&self, body: &BodyReport) -> Option<FreedPacket> {
        // No pose is known: repeat the last one, marked as bad; never invent one.
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
        let raw = |ring: Option<Ring>, usual| ring.map_or(usual, Rings::freed);
        (packet.zoom, packet.focus) = (raw(report.rings.zoom, self.zoom), raw(report.rings.focus, self.settings.focus));
        packet.spare = self.spare(report, body);
        // A pose that does not fit never gets here.
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
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::publish::golden::golden_report;
    use crate::record::State;

    #[test]
    fn the_encoder_accepts_only_the_24_bit_range() {
        let settings = FreedSettings { camera_id: 1, spare: Spare::Quality, zoom: None, sensor_width_mm: 4.8, focus: 0 };
        let encoder = FreedEncoder::new(settings, Some(&CameraModel::pinhole(640, 480, 600.0, 600.0, 319.5, 239.5).unwrap()));
        let at = |x| Pose::new(UnitQuaternion::identity(), Vector3::new(0.0, x, 0.0));
        assert_eq!([131.0, -131.072, 131.0721, -131.1, 1e6].map(|x| encoder.holds(&at(x))), [true, true, false, false, false]);
    }

    #[test]
    fn zoom_and_focus_of_another_device_replace_the_configured_ones() {
        let settings = FreedSettings { camera_id: 1, spare: Spare::Zero, zoom: Some(5), sensor_width_mm: 4.8, focus: 6 };
        let mut encoder = FreedEncoder::new(settings, None);
        let mut sent = |rings: Rings| {
            let mut found = None;
            let report = Report { rings, ..golden_report(State::Tracking) };
            encoder.encode(&report, &mut |bytes| found = FreedPacket::decode(bytes).ok());
            found.map(|packet| (packet.zoom, packet.focus))
        };
        assert_eq!(sent(Rings::default()), Some((5, 6)));
        assert_eq!(sent(Rings { zoom: Some(Ring::Raw(40_000.0)), focus: None }), Some((40_000, 6)));
        assert_eq!(sent(Rings { zoom: Some(Ring::Raw(1.0)), focus: Some(Ring::Normalised(1.0)) }), Some((1, 65_535)));
    }
}
