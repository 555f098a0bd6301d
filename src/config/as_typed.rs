//! The config as it stands in the file: every key of contract C5, every value with its place.
//!
//! These types check TOML's own types only. [`Settings`](super::Settings) checks ranges, files and
//! combinations. The field names are the only list of known keys: the refusal of unknown keys and
//! the search for the nearest known name read them from here.

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Spanned;

pub use super::typed_values::{ControlValue, Count, Exactly, Number, PictureWord, Texts};

/// A whole config file.
#[derive(Debug, Deserialize)]
pub struct Config {
    /// `[camera]`.
    pub camera: Option<Spanned<Camera>>,
    /// `[stage]`: its origin, and `[[stage.surface]]`.
    pub stage: Option<Spanned<Stage>>,
    /// `[[object]]`.
    #[serde(default)]
    pub object: Vec<Spanned<Object>>,
    /// `[[survey.distance]]` and `[[survey.point]]`.
    pub survey: Option<Survey>,
    /// `[map]`: `[[map.point]]`, `[[map.distance]]` and the floor.
    pub map: Option<Map>,
    /// `[mount]`.
    pub mount: Option<Spanned<Mount>>,
    /// `[tracker]`.
    pub tracker: Option<Tracker>,
    /// `[recorder]`.
    pub recorder: Option<Recorder>,
    /// `[timecode]`.
    pub timecode: Option<Spanned<Timecode>>,
    /// `[other_tracker]`.
    pub other_tracker: Option<Spanned<OtherTracker>>,
    /// `[filter]`.
    pub filter: Option<Filter>,
    /// `[safety]`.
    pub safety: Option<Safety>,
    /// `[[output]]`.
    #[serde(default)]
    pub output: Vec<Spanned<Output>>,
    /// `[http]`.
    pub http: Option<Http>,
    /// `[log]`.
    pub log: Option<Log>,
}

/// `[camera]`: the calibration, the shutter, and how to open the device.
#[derive(Debug, Default, Deserialize)]
pub struct Camera {
    /// Calibration file.
    pub calibration: Option<Spanned<String>>,
    /// Or a guess: degrees across the picture's width.
    pub fov_deg: Option<Spanned<Number>>,
    /// Or a guess: 35 mm equivalent focal length, millimetres.
    pub focal_35mm_mm: Option<Spanned<Number>>,
    /// Exposure, seconds; 0 = unknown.
    pub exposure_s: Option<Spanned<Number>>,
    /// Time from the first row to the last, seconds; 0 = unknown.
    pub readout_s: Option<Spanned<Number>>,
    /// `global` or `rolling`.
    pub shutter: Option<Spanned<String>>,
    /// How the camera encodes light: `srgb`, `bt709` or `linear`.
    pub transfer: Option<Spanned<String>>,
    /// Picture that is black where the camera's picture is to be ignored.
    pub mask: Option<Spanned<String>>,
    /// Device path or name.
    pub device: Option<Spanned<String>>,
    /// Requested width in pixels.
    pub width: Option<Spanned<Count>>,
    /// Requested height in pixels.
    pub height: Option<Spanned<Count>>,
    /// Requested frames per second.
    pub fps: Option<Spanned<Number>>,
    /// Requested pixel format.
    pub format: Option<Spanned<String>>,
    /// How late its pictures are stamped, seconds.
    pub latency_s: Option<Spanned<Number>>,
    /// Driver controls by name.
    pub controls: Option<BTreeMap<String, Spanned<ControlValue>>>,
    /// `[camera.pose]`.
    pub pose: Option<Spanned<CameraPose>>,
}

/// `[camera.pose]`: where a camera stands still.
#[derive(Debug, Deserialize)]
pub struct CameraPose {
    /// Its place in the stage, metres.
    pub position_m: Option<Spanned<Exactly<Number, 3>>>,
    /// Orientation of its optical frame.
    pub orientation_xyzw: Option<Spanned<Exactly<Number, 4>>>,
    /// The same as pan, tilt and roll, degrees.
    pub rotation_deg: Option<Spanned<Exactly<Number, 3>>>,
    /// One sigma of the place, metres.
    pub position_sigma_m: Option<Spanned<Number>>,
    /// One sigma of the orientation, degrees.
    pub rotation_sigma_deg: Option<Spanned<Number>>,
    /// Or the covariance of both, row by row, m and rad.
    pub covariance: Option<Spanned<Exactly<Number, 36>>>,
}

/// `[stage]`.
#[derive(Debug, Deserialize)]
pub struct Stage {
    /// Positions of the first surface's points, by name, metres.
    pub origin: Option<Spanned<BTreeMap<String, Spanned<Exactly<Number, 3>>>>>,
    /// `[[stage.surface]]`.
    #[serde(default)]
    pub surface: Vec<Spanned<Surface>>,
    /// `[stage.map]`.
    pub map: Option<Spanned<MapOfStage>>,
}

/// `[stage.map]`.
#[derive(Debug, Deserialize)]
pub struct MapOfStage {
    /// Map file from `stagepose map`.
    pub file: Option<Spanned<String>>,
}

/// `[[object]]`.
#[derive(Debug, Deserialize)]
pub struct Object {
    /// Its name in the records.
    pub name: Option<Spanned<String>>,
    /// `[[object.surface]]`.
    #[serde(default)]
    pub surface: Vec<Spanned<Surface>>,
}

/// `[[stage.surface]]` and `[[object.surface]]`.
#[derive(Debug, Deserialize)]
pub struct Surface {
    /// Flat artwork.
    pub image: Option<Spanned<String>>,
    /// Or a photograph of the surface.
    pub photo: Option<Spanned<String>>,
    /// Raw pixels of the surface's corners in the photograph, clockwise from the top left.
    pub corners_px: Option<Spanned<Exactly<Exactly<Number, 2>, 4>>>,
    /// Uncertainty of each corner, one sigma, pixels.
    pub corner_sigma_px: Option<Spanned<Number>>,
    /// How the picture encodes light: `srgb`, `bt709` or `linear`.
    pub transfer: Option<Spanned<String>>,
    /// Calibration of the camera that took the photograph.
    pub photo_calibration: Option<Spanned<String>>,
    /// Shape file from `stagepose survey`.
    pub shape: Option<Spanned<String>>,
    /// Width and height, metres.
    pub size_m: Option<Spanned<Exactly<Number, 2>>>,
    /// Its centre in the body frame, metres.
    pub position_m: Option<Spanned<Exactly<Number, 3>>>,
    /// Orientation as a unit quaternion.
    pub orientation_xyzw: Option<Spanned<Exactly<Number, 4>>>,
    /// Or as turn, tilt and roll, degrees.
    pub rotation_deg: Option<Spanned<Exactly<Number, 3>>>,
    /// One sigma of its position along each axis, metres.
    pub position_sigma_m: Option<Spanned<Number>>,
    /// One sigma of its direction about each axis, degrees.
    pub rotation_sigma_deg: Option<Spanned<Number>>,
}

/// Measurements on the stage.
#[derive(Debug, Deserialize)]
pub struct Survey {
    /// `[[survey.distance]]`.
    #[serde(default)]
    pub distance: Vec<Spanned<SurveyDistance>>,
    /// `[[survey.point]]`.
    #[serde(default)]
    pub point: Vec<Spanned<SurveyPoint>>,
}

/// `[[survey.distance]]`: a length between two points of surfaces.
#[derive(Debug, Deserialize)]
pub struct SurveyDistance {
    /// The points' surfaces, by their numbers from 1.
    pub surfaces: Option<Spanned<Exactly<Count, 2>>>,
    /// The points' places on their pictures.
    pub at: Option<Spanned<Exactly<PictureWord, 2>>>,
    /// The length, metres.
    pub length_m: Option<Spanned<Number>>,
    /// One sigma, metres.
    pub sigma_m: Option<Spanned<Number>>,
}

/// `[[survey.point]]`: the stage position of a point of a surface.
#[derive(Debug, Deserialize)]
pub struct SurveyPoint {
    /// The point's surface, by its number from 1.
    pub surface: Option<Spanned<Count>>,
    /// The point's place on its picture.
    pub at: Option<Spanned<PictureWord>>,
    /// Its position in the stage frame, metres.
    pub position_m: Option<Spanned<Exactly<Number, 3>>>,
    /// One sigma along each axis, metres.
    pub sigma_m: Option<Spanned<Number>>,
}

/// `[map]`: what gives a map its frame and scale beside surfaces.
#[derive(Debug, Deserialize)]
pub struct Map {
    /// Names of three points of the floor: the origin, one along x, one beside.
    pub floor: Option<Spanned<Vec<String>>>,
    /// `[[map.point]]`.
    #[serde(default)]
    pub point: Vec<Spanned<MapPoint>>,
    /// `[[map.distance]]`.
    #[serde(default)]
    pub distance: Vec<Spanned<MapDistance>>,
}

/// `[[map.point]]`: a point of the set, clicked in frames of the walk.
#[derive(Debug, Deserialize)]
pub struct MapPoint {
    /// Its name.
    pub name: Option<Spanned<String>>,
    /// Where frames show it.
    #[serde(default)]
    pub seen: Vec<Spanned<MapClick>>,
    /// Its position in the stage frame, metres.
    pub position_m: Option<Spanned<Exactly<Number, 3>>>,
    /// One sigma along each axis, metres.
    pub sigma_m: Option<Spanned<Number>>,
}

/// An entry of `seen`.
#[derive(Debug, Deserialize)]
pub struct MapClick {
    /// The clip's name.
    pub clip: Option<Spanned<String>>,
    /// The row in the clip, from 0.
    pub sequence: Option<Spanned<Count>>,
    /// The raw pixel.
    pub px: Option<Spanned<Exactly<Number, 2>>>,
}

/// `[[map.distance]]`: a measured length between two named points.
#[derive(Debug, Deserialize)]
pub struct MapDistance {
    /// The points' names.
    pub between: Option<Spanned<Vec<String>>>,
    /// The length, metres.
    pub length_m: Option<Spanned<Number>>,
    /// One sigma, metres.
    pub sigma_m: Option<Spanned<Number>>,
}

/// `[mount]`.
#[derive(Debug, Deserialize)]
pub struct Mount {
    /// Its name in `bodies` and for the receivers.
    pub name: Option<Spanned<String>>,
    /// "camera", or an object's name.
    pub on: Option<Spanned<String>>,
    /// Offset to the carrier's right, forward and up, metres.
    pub offset_m: Option<Spanned<Exactly<Number, 3>>>,
    /// Pan, tilt and roll relative to the carrier, degrees.
    pub rotation_deg: Option<Spanned<Exactly<Number, 3>>>,
    /// Or a unit quaternion.
    pub orientation_xyzw: Option<Spanned<Exactly<Number, 4>>>,
    /// One sigma of the offset along the carrier's axes, metres.
    pub offset_sigma_m: Option<Spanned<Exactly<Number, 3>>>,
    /// One sigma of pan, tilt and roll, degrees.
    pub rotation_sigma_deg: Option<Spanned<Exactly<Number, 3>>>,
    /// The filming camera's own calibration.
    pub calibration: Option<Spanned<String>>,
    /// How much later its picture arrives, seconds.
    pub delay_s: Option<Spanned<Number>>,
}

/// `[tracker]`.
#[derive(Debug, Deserialize)]
pub struct Tracker {
    /// Worker threads.
    pub threads: Option<Spanned<Count>>,
    /// Corners to detect in a frame.
    pub features: Option<Spanned<Count>>,
    /// Maximum duration of a prediction, seconds.
    pub coast_s: Option<Spanned<Number>>,
    /// Number of frames that must agree.
    pub confirm_frames: Option<Spanned<Count>>,
    /// Seed of the robust estimators.
    pub seed: Option<Spanned<Count>>,
}

/// `[recorder]`.
#[derive(Debug, Deserialize)]
pub struct Recorder {
    /// Folder for clips.
    pub folder: Option<Spanned<String>>,
    /// Record everything from the start.
    pub continuous: Option<bool>,
    /// Seconds kept for saving later; 0 = none.
    pub ring_s: Option<Spanned<Number>>,
}

/// `[timecode]`.
#[derive(Debug, Deserialize)]
pub struct Timecode {
    /// A WAV file, a pipe, or `-` for standard input.
    pub file: Option<Spanned<String>>,
    /// Or a sound card, by its ALSA name.
    pub device: Option<Spanned<String>>,
    /// The channel with the timecode, from 1.
    pub channel: Option<Spanned<Count>>,
    /// 23.976, 24, 25, 29.97, 29.97df or 30.
    pub rate: Option<Spanned<String>>,
    /// Of raw samples: samples per second.
    pub sample_rate_hz: Option<Spanned<Count>>,
    /// Of raw samples: number of channels.
    pub channels: Option<Spanned<Count>>,
    /// How long it counts on without timecode, seconds.
    pub free_wheel_s: Option<Spanned<Number>>,
    /// How much later the sound arrives than it was made, seconds.
    pub latency_s: Option<Spanned<Number>>,
    /// When a clip's sound begins, seconds after its first frame.
    pub begins_s: Option<Spanned<Number>>,
}

/// `[other_tracker]`.
#[derive(Debug, Deserialize)]
pub struct OtherTracker {
    /// freed or opentrackio.
    pub protocol: Option<Spanned<String>>,
    /// Address and port where its packets arrive.
    pub listen: Option<Spanned<String>>,
    /// The network of a multicast group.
    pub interface: Option<Spanned<String>>,
    /// FreeD: the camera's number.
    pub camera_id: Option<Spanned<Count>>,
    /// OpenTrackIO: the source's `sourceId`.
    pub source_id: Option<Spanned<String>>,
    /// Raw zoom at the wide and at the long end.
    pub zoom_range: Option<Spanned<Exactly<Number, 2>>>,
}

/// `[filter]`.
#[derive(Debug, Deserialize)]
pub struct Filter {
    /// off, one-euro, kalman.
    pub kind: Option<Spanned<String>>,
    /// Predict the pose this long after the frame, seconds.
    pub predict_s: Option<Spanned<Number>>,
    /// One-Euro: cutoff at rest, Hz.
    pub min_cutoff_hz: Option<Spanned<Number>>,
    /// One-Euro: rise of the cutoff with speed, Hz per m/s.
    pub beta: Option<Spanned<Number>>,
    /// Kalman: expected accelerations while moving, m/s².
    pub acceleration_m_s2: Option<Spanned<Number>>,
    /// Kalman: expected angular accelerations while moving, degrees/s².
    pub turn_acceleration_deg_s2: Option<Spanned<Number>>,
}

/// `[safety]`.
#[derive(Debug, Deserialize)]
pub struct Safety {
    /// Maximum speed, m/s.
    pub max_speed_m_s: Option<Spanned<Number>>,
    /// Maximum angular velocity, degrees/s.
    pub max_turn_deg_s: Option<Spanned<Number>>,
    /// Two opposite corners, stage frame.
    pub permitted_box_m: Option<Spanned<Exactly<Exactly<Number, 3>, 2>>>,
    /// Speed of the return after a loss, m/s.
    pub blend_speed_m_s: Option<Spanned<Number>>,
    /// Angular velocity of the return after a loss, degrees/s.
    pub blend_turn_deg_s: Option<Spanned<Number>>,
    /// Time without a frame after which outputs report stale poses, seconds.
    pub stale_after_s: Option<Spanned<Number>>,
}

/// `[http]`.
#[derive(Debug, Deserialize)]
pub struct Http {
    /// Whether the server runs.
    pub enabled: Option<Spanned<bool>>,
    /// IP address and port.
    pub listen: Option<Spanned<String>>,
    /// Hosts that are answered in addition to this machine's own.
    pub hosts: Option<Vec<Spanned<String>>>,
}

/// `[[output]]`: first the keys common to all protocols, then the keys of each.
#[derive(Debug, Deserialize)]
pub struct Output {
    /// The protocol: freed, opentrackio, psn, otp, osc, json.
    pub kind: Option<Spanned<String>>,
    /// Its name in messages and metrics.
    pub name: Option<Spanned<String>>,
    /// Whether it sends.
    pub enabled: Option<Spanned<bool>>,
    /// One UDP address or several.
    pub to: Option<Spanned<Texts>>,
    /// This machine's address on the multicast network.
    pub interface: Option<Spanned<String>>,
    /// Maximum number of routers a datagram may cross.
    pub ttl: Option<Spanned<Count>>,
    /// Camera and objects, by name.
    pub bodies: Option<Spanned<Texts>>,
    /// Send every n-th sample.
    pub rate_divider: Option<Spanned<Count>>,
    /// Send at its own fixed rate, ticks per second.
    pub rate_hz: Option<Spanned<Number>>,
    /// Where the ticks lie: free-running, clock.
    pub ticks: Option<Spanned<String>>,
    /// How far the ticks' poses lag, seconds.
    pub delay_s: Option<Spanned<Number>>,
    /// Behaviour on loss: stop, hold, flag.
    pub on_loss: Option<Spanned<String>>,
    /// The receiver whose axes and units to use: unreal, disguise, touchdesigner, lighting.
    pub receiver: Option<Spanned<String>>,
    /// The stage's origin in the receiver's world, metres.
    pub offset_m: Option<Spanned<Exactly<Number, 3>>>,
    /// The stage's axes in the receiver's world.
    pub rotation_xyzw: Option<Spanned<Exactly<Number, 4>>>,
    /// The same as turn, tilt and roll, degrees.
    pub rotation_deg: Option<Spanned<Exactly<Number, 3>>>,
    /// Inverted components: x, y, z, pan, tilt, roll.
    pub invert: Option<Spanned<Texts>>,
    /// Receiver's units per metre.
    pub scale: Option<Spanned<Number>>,
    /// Whether `[safety]` applies.
    pub safety: Option<Spanned<bool>>,
    /// freed, opentrackio: sensor width, mm.
    pub sensor_width_mm: Option<Spanned<Number>>,
    /// freed: camera number.
    pub camera_id: Option<Spanned<Count>>,
    /// freed: content of the spare field: quality, frame, sony, zero.
    pub spare: Option<Spanned<String>>,
    /// freed: raw zoom value.
    pub zoom: Option<Spanned<Count>>,
    /// freed, opentrackio: whose zoom and focus are sent.
    pub rings: Option<Spanned<String>>,
    /// freed: raw focus value.
    pub focus: Option<Spanned<Count>>,
    /// opentrackio: json, cbor.
    pub encoding: Option<Spanned<String>>,
    /// opentrackio: 1 to 200.
    pub source_number: Option<Spanned<Count>>,
    /// opentrackio: projection, both.
    pub principal_point: Option<Spanned<String>>,
    /// psn, otp: the system's name.
    pub system: Option<Spanned<String>>,
    /// psn: tracker number of the first body.
    pub first_tracker: Option<Spanned<Count>>,
    /// otp: system, 1 to 200.
    pub system_number: Option<Spanned<Count>>,
    /// otp: group of all bodies.
    pub group_number: Option<Spanned<Count>>,
    /// otp: point number of the first body.
    pub first_point: Option<Spanned<Count>>,
    /// otp: 0 to 200.
    pub priority: Option<Spanned<Count>>,
    /// otp: system, group and point in whose frame the stage is.
    pub reference_point: Option<Spanned<Exactly<Count, 3>>>,
    /// otp: where receivers' advertisements arrive.
    pub listen: Option<Spanned<String>>,
    /// osc: first part of the addresses.
    pub prefix: Option<Spanned<String>>,
    /// osc: pose, quat, status.
    pub messages: Option<Spanned<Texts>>,
    /// osc: `[[output.value]]`.
    #[serde(default)]
    pub value: Vec<Spanned<OutputValue>>,
    /// json: IP address and port for TCP clients.
    pub tcp_listen: Option<Spanned<String>>,
    /// json: a file, or `-` for standard output.
    pub file: Option<Spanned<String>>,
}

/// `[[output.value]]`: a single number for an OSC address of the receiver's choice.
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
    /// Minimum and maximum.
    pub clamp: Option<Spanned<Exactly<Number, 2>>>,
    /// Send every n-th report.
    pub every: Option<Spanned<Count>>,
}

/// `[log]`.
#[derive(Debug, Deserialize)]
pub struct Log {
    /// off, error, warn, info, debug, trace.
    pub level: Option<Spanned<String>>,
    /// text, json.
    pub format: Option<Spanned<String>>,
}
