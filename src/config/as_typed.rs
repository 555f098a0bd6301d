//! The config as it stands in the file: every key of contract C5, every value with its place.
//!
//! These types check TOML's own types only. Ranges, files and what belongs together are checked where a
//! [`Settings`](super::Settings) is made of them. The field names are the only list of known keys there is:
//! the search for the nearest known name reads them from here.

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Spanned;

pub use super::stage_origin::TypedPoints;
pub use super::typed_outputs::{Filter, Http, Output, OutputValue, Safety};
pub use super::typed_values::{ControlValue, Count, Exactly, Number, Texts};

/// A whole config file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// `[camera]`
    pub camera: Option<Spanned<Camera>>,
    /// `[stage]`: its origin, and `[[stage.surface]]`.
    pub stage: Option<Spanned<Stage>>,
    /// `[[object]]`
    #[serde(default)]
    pub object: Vec<Spanned<Object>>,
    /// `[mount]`
    pub mount: Option<Spanned<Mount>>,
    /// `[tracker]`
    pub tracker: Option<Tracker>,
    /// `[recorder]`
    pub recorder: Option<Recorder>,
    /// `[filter]`
    pub filter: Option<Filter>,
    /// `[safety]`
    pub safety: Option<Safety>,
    /// `[[output]]`
    #[serde(default)]
    pub output: Vec<Spanned<Output>>,
    /// `[http]`
    pub http: Option<Http>,
    /// `[log]`
    pub log: Option<Log>,
}

/// `[camera]`: the calibration, the shutter, and how to open the device.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Calibration file.
    pub calibration: Option<Spanned<String>>,
    /// Or a guess: degrees across the picture's width,
    pub fov_deg: Option<Spanned<Number>>,
    /// or the focal length as of 35 mm film, millimetres.
    pub focal_35mm_mm: Option<Spanned<Number>>,
    /// Exposure, seconds; 0 = unknown.
    pub exposure_s: Option<Spanned<Number>>,
    /// First row to last, seconds; 0 = global or unknown.
    pub readout_s: Option<Spanned<Number>>,
    /// Picture that is black where the camera's picture is to be ignored.
    pub mask: Option<Spanned<String>>,
    /// Device path or name.
    pub device: Option<Spanned<String>>,
    /// Wanted width in pixels.
    pub width: Option<Spanned<Count>>,
    /// Wanted height in pixels.
    pub height: Option<Spanned<Count>>,
    /// Wanted frames per second.
    pub fps: Option<Spanned<Number>>,
    /// Wanted pixel format.
    pub format: Option<Spanned<String>>,
    /// Driver controls by name.
    pub controls: Option<BTreeMap<String, Spanned<ControlValue>>>,
}

/// `[stage]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Where points of the first surface are, by their names, metres.
    pub origin: Option<Spanned<TypedPoints>>,
    /// `[[stage.surface]]`
    #[serde(default)]
    pub surface: Vec<Spanned<Surface>>,
}

/// `[[object]]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Object {
    /// Its name in the records.
    pub name: Option<Spanned<String>>,
    /// `[[object.surface]]`
    #[serde(default)]
    pub surface: Vec<Spanned<Surface>>,
}

/// `[[stage.surface]]` and `[[object.surface]]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Surface {
    /// Flat artwork.
    pub image: Option<Spanned<String>>,
    /// Or a photograph of the surface,
    pub photo: Option<Spanned<String>>,
    /// with the raw pixels of its corners, clockwise from the top left,
    pub corners_px: Option<Spanned<Exactly<Exactly<Number, 2>, 4>>>,
    /// and the calibration of the camera that took it.
    pub photo_calibration: Option<Spanned<String>>,
    /// Width and height, metres.
    pub size_m: Option<Spanned<Exactly<Number, 2>>>,
    /// Centre in the body, metres.
    pub position_m: Option<Spanned<Exactly<Number, 3>>>,
    /// Unit quaternion,
    pub orientation_xyzw: Option<Spanned<Exactly<Number, 4>>>,
    /// or turn, tilt and roll, degrees.
    pub rotation_deg: Option<Spanned<Exactly<Number, 3>>>,
}

/// `[mount]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mount {
    /// For `bodies` and the receivers.
    pub name: Option<Spanned<String>>,
    /// "camera", or an object's name.
    pub on: Option<Spanned<String>>,
    /// Right, forward, up of the carrier, metres.
    pub offset_m: Option<Spanned<Exactly<Number, 3>>>,
    /// Pan, tilt and roll against the carrier, degrees,
    pub rotation_deg: Option<Spanned<Exactly<Number, 3>>>,
    /// or a unit quaternion.
    pub orientation_xyzw: Option<Spanned<Exactly<Number, 4>>>,
    /// One sigma of the offset along the carrier's axes, metres.
    pub offset_sigma_m: Option<Spanned<Exactly<Number, 3>>>,
    /// One sigma of pan, tilt and roll, degrees.
    pub rotation_sigma_deg: Option<Spanned<Exactly<Number, 3>>>,
    /// The filming camera's own calibration.
    pub calibration: Option<Spanned<String>>,
    /// How much later its picture comes, seconds.
    pub delay_s: Option<Spanned<Number>>,
}

/// `[tracker]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tracker {
    /// Worker threads.
    pub threads: Option<Spanned<Count>>,
    /// Corners looked for in a frame.
    pub features: Option<Spanned<Count>>,
    /// Longest prediction, seconds.
    pub coast_s: Option<Spanned<Number>>,
    /// Frames that must agree.
    pub confirm_frames: Option<Spanned<Count>>,
    /// Seed of the robust estimators.
    pub seed: Option<Spanned<Count>>,
}

/// `[recorder]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recorder {
    /// Where clips go.
    pub folder: Option<Spanned<String>>,
    /// Everything, from the start on.
    pub continuous: Option<bool>,
    /// Seconds kept for saving later; 0 = none.
    pub ring_s: Option<Spanned<Number>>,
}

/// `[log]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Log {
    /// off, error, warn, info, debug, trace.
    pub level: Option<Spanned<String>>,
    /// text, json.
    pub format: Option<Spanned<String>>,
}
