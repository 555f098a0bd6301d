//! The config as it stands in the file: every key of contract C5, every value with its place.
//!
//! These types check TOML's own types only. Ranges, files and what belongs together are checked where a
//! [`Settings`](super::Settings) is made of them. The field names are the only list of known keys there is:
//! the refusal of unknown keys and the search for the nearest known name read them from here.

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Spanned;

pub use super::typed_values::{ControlValue, Count, Exactly, Number, PictureWord, Texts};

/// A whole config file.
#[derive(Debug, Deserialize)]
pub struct Config {
    /// `[camera]`
    pub camera: Option<Spanned<Camera>>,
    /// `[stage]`: its origin, and `[[stage.surface]]`.
    pub stage: Option<Spanned<Stage>>,
    /// `[[object]]`
    #[serde(default)]
    pub object: Vec<Spanned<Object>>,
    /// `[[survey.distance]]` and `[[survey.point]]`
    pub survey: Option<Survey>,
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
pub struct Camera {
    /// Calibration file.
    pub calibration: Option<Spanned<String>>,
    /// Or a guess: degrees across the picture's width,
    pub fov_deg: Option<Spanned<Number>>,
    /// or the focal length as of 35 mm film, millimetres.
    pub focal_35mm_mm: Option<Spanned<Number>>,
    /// Exposure, seconds; 0 = unknown.
    pub exposure_s: Option<Spanned<Number>>,
    /// First row to last, seconds; 0 = unknown.
    pub readout_s: Option<Spanned<Number>>,
    /// `global` or `rolling`.
    pub shutter: Option<Spanned<String>>,
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
pub struct Stage {
    /// Where points of the first surface are, by their names, metres.
    pub origin: Option<Spanned<BTreeMap<String, Spanned<Exactly<Number, 3>>>>>,
    /// `[[stage.surface]]`
    #[serde(default)]
    pub surface: Vec<Spanned<Surface>>,
}

/// `[[object]]`
#[derive(Debug, Deserialize)]
pub struct Object {
    /// Its name in the records.
    pub name: Option<Spanned<String>>,
    /// `[[object.surface]]`
    #[serde(default)]
    pub surface: Vec<Spanned<Surface>>,
}

/// `[[stage.surface]]` and `[[object.surface]]`
#[derive(Debug, Deserialize)]
pub struct Surface {
    /// Flat artwork.
    pub image: Option<Spanned<String>>,
    /// Or a photograph of the surface,
    pub photo: Option<Spanned<String>>,
    /// with the raw pixels of its corners, clockwise from the top left,
    pub corners_px: Option<Spanned<Exactly<Exactly<Number, 2>, 4>>>,
    /// how far each may be off, one sigma, pixels,
    pub corner_sigma_px: Option<Spanned<Number>>,
    /// and the calibration of the camera that took it.
    pub photo_calibration: Option<Spanned<String>>,
    /// How it hangs: a file of `stagepose survey`.
    pub shape: Option<Spanned<String>>,
    /// Width and height, metres.
    pub size_m: Option<Spanned<Exactly<Number, 2>>>,
    /// Centre in the body, metres.
    pub position_m: Option<Spanned<Exactly<Number, 3>>>,
    /// Unit quaternion,
    pub orientation_xyzw: Option<Spanned<Exactly<Number, 4>>>,
    /// or turn, tilt and roll, degrees.
    pub rotation_deg: Option<Spanned<Exactly<Number, 3>>>,
    /// One sigma of its position along each axis, metres,
    pub position_sigma_m: Option<Spanned<Number>>,
    /// and of its direction about each axis, degrees.
    pub rotation_sigma_deg: Option<Spanned<Number>>,
}

/// What was measured on the stage.
#[derive(Debug, Deserialize)]
pub struct Survey {
    /// `[[survey.distance]]`
    #[serde(default)]
    pub distance: Vec<Spanned<SurveyDistance>>,
    /// `[[survey.point]]`
    #[serde(default)]
    pub point: Vec<Spanned<SurveyPoint>>,
}

/// `[[survey.distance]]`: a length between two points of surfaces.
#[derive(Debug, Deserialize)]
pub struct SurveyDistance {
    /// The stage's surfaces that have the points, by their numbers from 1.
    pub surfaces: Option<Spanned<Exactly<Count, 2>>>,
    /// Where the points are on their pictures.
    pub at: Option<Spanned<Exactly<PictureWord, 2>>>,
    /// Metres.
    pub length_m: Option<Spanned<Number>>,
    /// One sigma, metres.
    pub sigma_m: Option<Spanned<Number>>,
}

/// `[[survey.point]]`: where a point of a surface is in the stage.
#[derive(Debug, Deserialize)]
pub struct SurveyPoint {
    /// The stage's surface that has it, by its number from 1.
    pub surface: Option<Spanned<Count>>,
    /// Where it is on its picture.
    pub at: Option<Spanned<PictureWord>>,
    /// Stage frame, metres.
    pub position_m: Option<Spanned<Exactly<Number, 3>>>,
    /// One sigma along each axis, metres.
    pub sigma_m: Option<Spanned<Number>>,
}

/// `[mount]`
#[derive(Debug, Deserialize)]
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
pub struct Recorder {
    /// Where clips go.
    pub folder: Option<Spanned<String>>,
    /// Everything, from the start on.
    pub continuous: Option<bool>,
    /// Seconds kept for saving later; 0 = none.
    pub ring_s: Option<Spanned<Number>>,
}

/// `[filter]`
#[derive(Debug, Deserialize)]
pub struct Filter {
    /// off, one-euro, kalman.
    pub kind: Option<Spanned<String>>,
    /// The pose is predicted for this long after the frame, seconds.
    pub predict_s: Option<Spanned<Number>>,
    /// One-Euro: cutoff at rest, Hz.
    pub min_cutoff_hz: Option<Spanned<Number>>,
    /// One-Euro: how the cutoff rises with speed, Hz per m/s.
    pub beta: Option<Spanned<Number>>,
    /// Kalman: accelerations expected while moving, m/s².
    pub acceleration_m_s2: Option<Spanned<Number>>,
    /// Kalman: angular accelerations expected while moving, degrees/s².
    pub turn_acceleration_deg_s2: Option<Spanned<Number>>,
}

/// `[safety]`
#[derive(Debug, Deserialize)]
pub struct Safety {
    /// Greatest speed, m/s.
    pub max_speed_m_s: Option<Spanned<Number>>,
    /// Greatest turn rate, degrees/s.
    pub max_turn_deg_s: Option<Spanned<Number>>,
    /// Two corners, stage frame.
    pub permitted_box_m: Option<Spanned<Exactly<Exactly<Number, 3>, 2>>>,
    /// Speed of the return after a loss, m/s.
    pub blend_speed_m_s: Option<Spanned<Number>>,
    /// Turn rate of the return after a loss, degrees/s.
    pub blend_turn_deg_s: Option<Spanned<Number>>,
    /// Without a frame for this long outputs say that poses are stale, seconds.
    pub stale_after_s: Option<Spanned<Number>>,
}

/// `[http]`
#[derive(Debug, Deserialize)]
pub struct Http {
    /// Whether the server runs.
    pub enabled: Option<Spanned<bool>>,
    /// IP address and port.
    pub listen: Option<Spanned<String>>,
    /// Hosts that are answered for beside this machine's own.
    pub hosts: Option<Vec<Spanned<String>>>,
}

/// `[[output]]`: what all protocols share, then each one's own.
#[derive(Debug, Deserialize)]
pub struct Output {
    /// freed, opentrackio, psn, osc, json.
    pub kind: Option<Spanned<String>>,
    /// For messages and metrics.
    pub name: Option<Spanned<String>>,
    /// Whether it sends.
    pub enabled: Option<Spanned<bool>>,
    /// One UDP address or several.
    pub to: Option<Spanned<Texts>>,
    /// This machine's address on the multicast network.
    pub interface: Option<Spanned<String>>,
    /// Routers a datagram may cross.
    pub ttl: Option<Spanned<Count>>,
    /// Camera and objects by name.
    pub bodies: Option<Spanned<Texts>>,
    /// Every n-th sample.
    pub rate_divider: Option<Spanned<Count>>,
    /// Ticks of its own per second.
    pub rate_hz: Option<Spanned<Number>>,
    /// How far the ticks' poses lie back, seconds.
    pub delay_s: Option<Spanned<Number>>,
    /// stop, hold, flag.
    pub on_loss: Option<Spanned<String>>,
    /// Whose axes and units: unreal, disguise, touchdesigner, lighting.
    pub receiver: Option<Spanned<String>>,
    /// The stage's origin in the receiver's world, metres.
    pub offset_m: Option<Spanned<Exactly<Number, 3>>>,
    /// The stage's axes in the receiver's world.
    pub rotation_xyzw: Option<Spanned<Exactly<Number, 4>>>,
    /// The same as turn, tilt and roll, degrees.
    pub rotation_deg: Option<Spanned<Exactly<Number, 3>>>,
    /// x, y, z, pan, tilt, roll.
    pub invert: Option<Spanned<Texts>>,
    /// Receiver's units per metre.
    pub scale: Option<Spanned<Number>>,
    /// Whether `[safety]` holds.
    pub safety: Option<Spanned<bool>>,
    /// freed, opentrackio: width of the sensor, mm.
    pub sensor_width_mm: Option<Spanned<Number>>,
    /// freed: camera number.
    pub camera_id: Option<Spanned<Count>>,
    /// freed: quality, frame, sony, zero.
    pub spare: Option<Spanned<String>>,
    /// freed: raw zoom.
    pub zoom: Option<Spanned<Count>>,
    /// freed: raw focus.
    pub focus: Option<Spanned<Count>>,
    /// opentrackio: json, cbor.
    pub encoding: Option<Spanned<String>>,
    /// opentrackio: 1 to 200.
    pub source_number: Option<Spanned<Count>>,
    /// opentrackio: projection, both.
    pub principal_point: Option<Spanned<String>>,
    /// psn: the system's name.
    pub system: Option<Spanned<String>>,
    /// psn: tracker number of the first body.
    pub first_tracker: Option<Spanned<Count>>,
    /// osc: first part of the addresses.
    pub prefix: Option<Spanned<String>>,
    /// osc: pose, quat, status.
    pub messages: Option<Spanned<Texts>>,
    /// osc: `[[output.value]]`.
    #[serde(default)]
    pub value: Vec<Spanned<OutputValue>>,
    /// json: IP address and port for TCP clients.
    pub tcp_listen: Option<Spanned<String>>,
    /// json: a file, or `-`.
    pub file: Option<Spanned<String>>,
}

/// `[[output.value]]`: a single number for an OSC address of the receiver's.
#[derive(Debug, Deserialize)]
pub struct OutputValue {
    /// Address, with `{body}` and `{output}`.
    pub address: Option<Spanned<String>>,
    /// x, y, z, pan, tilt, roll.
    pub quantity: Option<Spanned<String>>,
    /// Factor.
    pub factor: Option<Spanned<Number>>,
    /// Added after the factor.
    pub plus: Option<Spanned<Number>>,
    /// Least and greatest.
    pub clamp: Option<Spanned<Exactly<Number, 2>>>,
    /// Every n-th report.
    pub every: Option<Spanned<Count>>,
}

/// `[log]`
#[derive(Debug, Deserialize)]
pub struct Log {
    /// off, error, warn, info, debug, trace.
    pub level: Option<Spanned<String>>,
    /// text, json.
    pub format: Option<Spanned<String>>,
}
