//! What a packet of FreeD or OpenTrackIO says of the camera it comes from: who sends, its pose, and
//! its lens, in one form for both.

use std::fmt;

use nalgebra::Vector3;
use serde_json::Value;

use super::body_pose::PanTiltRoll;
use super::freed::FreedPacket;
use super::opentrackio;
use crate::geometry::{Body, Pose, Stage};

/// Who sends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CameraSource {
    /// FreeD's camera number.
    Freed(u8),
    /// OpenTrackIO's `sourceId`; `None` if the sample has none.
    OpenTrackIo(Option<String>),
}

impl fmt::Display for CameraSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Freed(id) => write!(f, "FreeD camera {id}"),
            Self::OpenTrackIo(Some(id)) => write!(f, "OpenTrackIO source {id}"),
            Self::OpenTrackIo(None) => f.write_str("an OpenTrackIO source without sourceId"),
        }
    }
}

/// A protocol of cameras, and which of its sources is meant.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Spoken {
    /// FreeD D1, of this camera; `None`: of the first one that is heard.
    Freed(Option<u8>),
    /// OpenTrackIO, of this `sourceId`; `None`: of the first one that is heard.
    OpenTrackIo(Option<String>),
}

impl Spoken {
    /// Returns the word in the config.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Freed(_) => "freed",
            Self::OpenTrackIo(_) => "opentrackio",
        }
    }

    /// Returns the key in the config that selects a source.
    pub fn key(&self) -> &'static str {
        match self {
            Self::Freed(_) => "camera_id",
            Self::OpenTrackIo(_) => "source_id",
        }
    }

    /// Whether a source is the configured one; `None` if none is configured.
    pub fn selects(&self, source: &CameraSource) -> Option<bool> {
        match (self, source) {
            (Self::Freed(wanted), CameraSource::Freed(id)) => wanted.map(|wanted| wanted == *id),
            (Self::OpenTrackIo(wanted), CameraSource::OpenTrackIo(id)) => wanted.as_ref().map(|wanted| Some(wanted) == id.as_ref()),
            _ => Some(false),
        }
    }

    /// Decodes a packet.
    ///
    /// # Errors
    /// Why it is no packet of this protocol.
    pub fn decode(&self, bytes: &[u8]) -> Result<CameraPacket, String> {
        match self {
            Self::Freed(_) => FreedPacket::decode(bytes).map(|packet| CameraPacket::of_freed(&packet)).map_err(|e| e.to_string()),
            Self::OpenTrackIo(_) => {
                opentrackio::decode(bytes).map(|(_, sample)| CameraPacket::of_sample(&sample)).map_err(|e| e.to_string())
            }
        }
    }

    /// Returns the other protocol's word if the bytes are of that one.
    pub fn mistaken_for(&self, bytes: &[u8]) -> Option<&'static str> {
        let other = match self {
            Self::Freed(_) => Self::OpenTrackIo(None),
            Self::OpenTrackIo(_) => Self::Freed(None),
        };
        other.decode(bytes).is_ok().then_some(other.word())
    }

    /// Whether no source is configured.
    pub fn selects_none(&self) -> bool {
        matches!(self, Self::Freed(None) | Self::OpenTrackIo(None))
    }
}

/// Position of a lens ring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ring {
    /// In the encoder's own counts.
    Raw(f64),
    /// From 0 at one end to 1 at the other.
    Normalised(f64),
}

/// A packet.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraPacket {
    /// Who sent it.
    pub source: CameraSource,
    /// The camera's body in the sender's axes; `None` if the sender has no pose.
    pub pose: Option<Pose<Stage, Body>>,
    /// The zoom ring; `None` if the packet has none.
    pub zoom: Option<Ring>,
    /// The focus ring; `None` if the packet has none.
    pub focus: Option<Ring>,
}

impl CameraPacket {
    /// Reads a D1 packet, which always has everything.
    pub fn of_freed(packet: &FreedPacket) -> Self {
        // FreeD's pan is positive to the right.
        let angles = PanTiltRoll { pan_deg: -packet.pan_deg, tilt_deg: packet.tilt_deg, roll_deg: packet.roll_deg };
        Self {
            source: CameraSource::Freed(packet.camera_id),
            pose: Some(Pose::new(angles.rotation(), Vector3::from(packet.position_mm) / 1000.0)),
            zoom: Some(Ring::Raw(f64::from(packet.zoom))),
            focus: Some(Ring::Raw(f64::from(packet.focus))),
        }
    }

    /// Reads a decoded sample. Its transforms apply in order, the last one to the camera.
    pub fn of_sample(sample: &Value) -> Self {
        let transforms = sample.get("transforms").and_then(Value::as_array).filter(|all| !all.is_empty());
        let chained = |whole: Option<Pose<Stage, Body>>, next: &Value| {
            let next = transform(next)?;
            whole.map(|whole| Pose::new(whole.rotation * next.rotation, whole.translation + whole.rotation * next.translation))
        };
        Self {
            source: CameraSource::OpenTrackIo(sample.get("sourceId").and_then(Value::as_str).map(str::to_owned)),
            pose: transforms.and_then(|all| all.iter().fold(Some(Pose::identity()), chained)),
            zoom: ring(sample, "zoom"),
            focus: ring(sample, "focus"),
        }
    }
}

fn transform(transform: &Value) -> Option<Pose<Stage, Body>> {
    let number = |of: &str, key: &str| transform.get(of)?.get(key)?.as_f64().filter(|v| v.is_finite());
    let position = Vector3::new(number("translation", "x")?, number("translation", "y")?, number("translation", "z")?);
    let angles =
        PanTiltRoll { pan_deg: number("rotation", "pan")?, tilt_deg: number("rotation", "tilt")?, roll_deg: number("rotation", "roll")? };
    Some(Pose::new(angles.rotation(), position))
}

/// Returns a ring of the sample's lens, normalised if it is there in both forms.
fn ring(sample: &Value, name: &str) -> Option<Ring> {
    let lens = sample.get("lens")?;
    let number = |of: &str| lens.get(of)?.get(name)?.as_f64().filter(|v| v.is_finite());
    number("encoders").map(Ring::Normalised).or_else(|| number("rawEncoders").map(Ring::Raw))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn both_protocols_say_the_same_of_one_camera() {
        let freed = FreedPacket {
            camera_id: 3,
            pan_deg: -30.0,
            tilt_deg: -5.0,
            roll_deg: 1.0,
            position_mm: [1000.0, -4000.0, 1500.0],
            zoom: 5,
            focus: 6,
            spare: 0,
        };
        let of_freed = CameraPacket::of_freed(&freed);
        let at = json!({"translation": {"x": 1, "y": -4, "z": 1.5}, "rotation": {"pan": 30, "tilt": -5, "roll": 1}});
        let of_sample = CameraPacket::of_sample(&json!({
            "sourceId": "a", "transforms": [at], "lens": {"encoders": {"zoom": 0.25}, "rawEncoders": {"zoom": 7, "focus": 9}}}));
        let (a, b) = (of_freed.pose.unwrap(), of_sample.pose.unwrap());
        assert!(a.angle_to(&b) < 1e-12 && (a.translation - b.translation).norm() < 1e-12);
        assert_eq!(
            (of_freed.source.to_string(), of_freed.zoom, of_freed.focus),
            ("FreeD camera 3".to_owned(), Some(Ring::Raw(5.0)), Some(Ring::Raw(6.0)))
        );
        assert_eq!(of_sample.source.to_string(), "OpenTrackIO source a");
        assert_eq!((of_sample.zoom, of_sample.focus), (Some(Ring::Normalised(0.25)), Some(Ring::Raw(9.0))));
        // A dolly, and a head on it that looks to the left.
        let dolly = json!({"translation": {"x": 0, "y": 2, "z": 0}, "rotation": {"pan": 90, "tilt": 0, "roll": 0}});
        let head = json!({"translation": {"x": 1, "y": 0, "z": 0}, "rotation": {"pan": 0, "tilt": 0, "roll": 0}});
        let chained = CameraPacket::of_sample(&json!({"transforms": [dolly, head]})).pose.unwrap();
        assert!((chained.translation - Vector3::new(0.0, 3.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn a_sample_without_a_whole_pose_has_none() {
        let part = json!({"translation": {"x": 1, "y": 2}, "rotation": {"pan": 0, "tilt": 0, "roll": 0}});
        for sample in [json!({}), json!({"transforms": []}), json!({"transforms": [part]}), json!([1]), json!({"lens": 3, "sourceId": 4})] {
            let read = CameraPacket::of_sample(&sample);
            assert_eq!((read.pose, read.zoom, read.source), (None, None, CameraSource::OpenTrackIo(None)), "{sample}");
        }
    }
}
