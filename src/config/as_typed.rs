//! The config as it stands in the file: every key of contract C5, every value with its place.
//!
//! These types check TOML's own types only. Ranges, files and what belongs together are checked where a
//! [`Settings`](super::Settings) is made of them. The field names are the only list of known keys there is:
//! the search for the nearest known name reads them from here.

use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;
use std::path::Path;

use serde::Deserialize;
use serde::de::{self, Visitor};
use toml::Spanned;

use super::ConfigError;
use super::origin::Origin;
pub use super::stage_origin::TypedPoints;
pub use super::typed_outputs::{Filter, Http, Output, OutputValue, Safety};
use super::{characters, known_keys};

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

impl Config {
    /// Reads the text of a config file; `file` is used in messages only.
    ///
    /// # Errors
    /// [`ConfigError::Syntax`], [`ConfigError::Unknown`], or [`ConfigError::Value`] with a
    /// [`Problem::Type`](super::Problem::Type).
    pub fn parse(text: &str, file: &Path) -> Result<Self, ConfigError> {
        let origin = Origin::new(file, text);
        let table = toml::de::DeTable::parse(text).map_err(|e| origin.syntax(&e))?;
        characters::refuse_control_characters(table.get_ref(), &origin)?;
        known_keys::refuse_unknown(table.get_ref(), &origin)?;
        toml::from_str(text).map_err(|e| known_keys::place_type_error(table.get_ref(), &origin, &e))
    }
}

/// A finite or infinite number, typed with or without a decimal point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Number(pub f64);

/// A whole number of 0 or more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Count(pub u64);

/// A driver control's value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ControlValue {
    /// A level or a menu entry.
    Integer(i64),
    /// A switch.
    Switch(bool),
}

/// An array of exactly N entries; none may be left over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exactly<T, const N: usize>(pub [T; N]);

/// One text, or several in an array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Texts {
    /// Without brackets.
    One(String),
    /// In brackets.
    Several(Vec<Spanned<String>>),
}

impl Texts {
    /// All of them, each with its place.
    pub fn all(typed: &Spanned<Self>) -> Vec<Spanned<String>> {
        match typed.get_ref() {
            Self::One(text) => vec![Spanned::new(typed.span(), text.clone())],
            Self::Several(texts) => texts.clone(),
        }
    }
}

impl<const N: usize> Exactly<Number, N> {
    /// The bare numbers.
    pub fn values(&self) -> [f64; N] {
        self.0.map(|Number(v)| v)
    }
}

struct NumberVisitor;
impl Visitor<'_> for NumberVisitor {
    type Value = Number;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number")
    }
    fn visit_f64<E: de::Error>(self, v: f64) -> Result<Number, E> {
        Ok(Number(v))
    }
    fn visit_i64<E: de::Error>(self, v: i64) -> Result<Number, E> {
        Ok(Number(v as f64))
    }
    fn visit_u64<E: de::Error>(self, v: u64) -> Result<Number, E> {
        Ok(Number(v as f64))
    }
}

struct CountVisitor;
impl Visitor<'_> for CountVisitor {
    type Value = Count;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a whole number of 0 or more")
    }
    fn visit_i64<E: de::Error>(self, v: i64) -> Result<Count, E> {
        u64::try_from(v).map(Count).map_err(|_| E::invalid_value(de::Unexpected::Signed(v), &self))
    }
    fn visit_u64<E: de::Error>(self, v: u64) -> Result<Count, E> {
        Ok(Count(v))
    }
}

struct ControlVisitor;
impl Visitor<'_> for ControlVisitor {
    type Value = ControlValue;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a whole number, true or false")
    }
    fn visit_i64<E: de::Error>(self, v: i64) -> Result<ControlValue, E> {
        Ok(ControlValue::Integer(v))
    }
    fn visit_bool<E: de::Error>(self, v: bool) -> Result<ControlValue, E> {
        Ok(ControlValue::Switch(v))
    }
}

struct TextsVisitor;
impl<'de> Visitor<'de> for TextsVisitor {
    type Value = Texts;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a text in quotes, or several in an array")
    }
    fn visit_str<E: de::Error>(self, text: &str) -> Result<Texts, E> {
        Ok(Texts::One(text.to_owned()))
    }
    fn visit_seq<A: de::SeqAccess<'de>>(self, mut entries: A) -> Result<Texts, A::Error> {
        let mut read = Vec::new();
        while let Some(entry) = entries.next_element()? {
            read.push(entry);
        }
        Ok(Texts::Several(read))
    }
}

struct ExactlyVisitor<T, const N: usize>(PhantomData<T>);
impl<'de, T: Deserialize<'de>, const N: usize> Visitor<'de> for ExactlyVisitor<T, N> {
    type Value = Exactly<T, N>;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "an array of {N} entries")
    }
    fn visit_seq<A: de::SeqAccess<'de>>(self, mut entries: A) -> Result<Self::Value, A::Error> {
        let mut read = Vec::with_capacity(N);
        while let Some(entry) = entries.next_element()? {
            read.push(entry);
        }
        <[T; N]>::try_from(read).map(Exactly).map_err(|read| de::Error::invalid_length(read.len(), &self))
    }
}

impl<'de, T: Deserialize<'de>, const N: usize> Deserialize<'de> for Exactly<T, N> {
    fn deserialize<D: de::Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        d.deserialize_any(ExactlyVisitor(PhantomData))
    }
}

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: de::Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        d.deserialize_any(NumberVisitor)
    }
}

impl<'de> Deserialize<'de> for Texts {
    fn deserialize<D: de::Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        d.deserialize_any(TextsVisitor)
    }
}

impl<'de> Deserialize<'de> for Count {
    fn deserialize<D: de::Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        d.deserialize_any(CountVisitor)
    }
}

impl<'de> Deserialize<'de> for ControlValue {
    fn deserialize<D: de::Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        d.deserialize_any(ControlVisitor)
    }
}
