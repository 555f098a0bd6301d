//! OSC: one bundle per frame with the capture instant as its time tag, for scenery controllers,
//! show control and media servers.
//!
//! There is no standard address for a pose. Below `/<prefix>/<body>` this sends `/pose ,ffffff` (x
//! y z in metres, pan tilt roll in degrees, signs as in OpenTrackIO), `/quat ,ffff` (x y z w of the
//! body) and `/status ,sfi` (state, confidence, frame number). Single values can be sent to the
//! receiver's own addresses, scaled and clamped. Only the types i, f and s are used, since some
//! receivers know no others.

use rosc::{OscBundle, OscMessage, OscPacket, OscTime, OscType, encoder};

use super::complaints::Complaints;
use super::encoder::Encoder;
use super::report::{BodyReport, Report};
use crate::frame::Timestamp;
use crate::protocols::PanTiltRoll;

/// Settings of an OSC output.
#[derive(Debug, Clone, PartialEq)]
pub struct OscSettings {
    /// First part of the addresses, such as "/stagepose".
    pub prefix: String,
    /// Which of the standard messages are sent.
    pub messages: Vec<OscMessageKind>,
    /// Single values sent to the receiver's own addresses.
    pub values: Vec<OscValue>,
}

/// A message with one of this program's addresses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OscMessageKind {
    /// x y z pan tilt roll.
    Pose,
    /// x y z w.
    Quaternion,
    /// State, confidence, frame.
    Status,
}

/// A single value for one of the receiver's own addresses.
#[derive(Debug, Clone, PartialEq)]
pub struct OscValue {
    /// Its address, with `{body}` and `{output}` filled in.
    pub address: AddressTemplate,
    /// Which value.
    pub quantity: Quantity,
    /// The value sent is scale * value + offset.
    pub scale: f64,
    /// In the receiver's unit.
    pub offset: f64,
    /// Minimum and maximum of the value sent.
    pub clamp: Option<[f64; 2]>,
    /// Sent with every n-th report.
    pub every: u32,
}

/// One value of a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Metres to the right.
    X,
    /// Metres upstage.
    Y,
    /// Metres up.
    Z,
    /// Degrees, + left.
    Pan,
    /// Degrees, + up.
    Tilt,
    /// Degrees, + clockwise from behind.
    Roll,
}

impl Quantity {
    /// Their names in the config.
    pub const WORDS: [(&'static str, Quantity); 6] =
        [("x", Self::X), ("y", Self::Y), ("z", Self::Z), ("pan", Self::Pan), ("tilt", Self::Tilt), ("roll", Self::Roll)];
}

/// An OSC address with placeholders.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AddressTemplate(String);

/// Why a text is not an address template.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TemplateError {
    /// Not an address.
    #[error("`{0}` is not an OSC address; begin it with / and use neither spaces nor # * , ? [ ]")]
    Address(String),
    /// An unknown placeholder.
    #[error("the template's field {{{0}}} is unknown; use {{body}} or {{output}}")]
    Field(String),
}

impl AddressTemplate {
    /// Parses and checks a template.
    ///
    /// # Errors
    /// If it is not an OSC address once its placeholders are filled in, or has unknown
    /// placeholders.
    pub fn parse(text: &str) -> Result<Self, TemplateError> {
        let address = || TemplateError::Address(text.to_owned());
        let mut rest = text;
        while let Some((_, after)) = rest.split_once('{') {
            let (field, after) = after.split_once('}').ok_or_else(address)?;
            if !["body", "output"].contains(&field) {
                return Err(TemplateError::Field(field.to_owned()));
            }
            rest = after;
        }
        let filled = Self(text.to_owned()).fill("b", "o");
        let is_address = filled.starts_with('/') && filled.len() > 1 && is_plain(&filled);
        if is_address { Ok(Self(text.to_owned())) } else { Err(address()) }
    }

    /// Returns the address for a body on an output; invalid characters in their names are replaced.
    pub fn fill(&self, body: &str, output: &str) -> String {
        self.0.replace("{body}", &fit(body)).replace("{output}", &fit(output))
    }
}

/// Whether a text has only characters that an OSC address may have outside patterns.
fn is_plain(text: &str) -> bool {
    text.chars().all(|c| c.is_ascii_graphic() && !"#*,?[]{}".contains(c))
}

/// Makes a name valid as a part of an address.
fn fit(name: &str) -> String {
    name.chars().map(|c| if is_plain(c.encode_utf8(&mut [0; 4])) && c != '/' { c } else { '_' }).collect()
}

/// Turns reports into bundles.
pub(super) struct OscEncoder {
    settings: OscSettings,
    output: String,
    reports: u64,
    /// The last roll of each body, in the order of the reports.
    last_rolls_deg: Vec<f64>,
    trouble: Complaints,
}

impl OscEncoder {
    pub fn new(settings: &OscSettings, output: &str) -> Self {
        Self {
            settings: settings.clone(),
            output: output.to_owned(),
            reports: 0,
            last_rolls_deg: Vec::new(),
            trouble: Complaints::new(output),
        }
    }

    fn messages(&mut self, report: &Report, index: usize, body: &BodyReport, content: &mut Vec<OscPacket>) {
        let mut put = |addr: String, args: Vec<OscType>| content.push(OscPacket::Message(OscMessage { addr, args }));
        let at = |kind: &str| format!("{}/{}/{kind}", self.settings.prefix, fit(&body.name));
        if self.settings.messages.contains(&OscMessageKind::Status) {
            // The frame number wraps to stay within i32.
            let frame = (report.sequence & 0x7FFF_FFFF) as i32;
            let state = body.word().to_owned();
            put(at("status"), vec![OscType::String(state), OscType::Float(body.confidence()), OscType::Int(frame)]);
        }
        let Some(pose) = &body.pose else { return };
        let angles = PanTiltRoll::of_rotation(&pose.rotation, self.last_rolls_deg[index]);
        self.last_rolls_deg[index] = angles.roll_deg;
        let p = pose.translation;
        let numbers = [p.x, p.y, p.z, angles.pan_deg, angles.tilt_deg, angles.roll_deg];
        if self.settings.messages.contains(&OscMessageKind::Pose) {
            put(at("pose"), floats(&numbers));
        }
        if self.settings.messages.contains(&OscMessageKind::Quaternion) {
            put(at("quat"), floats(&pose.orientation_xyzw()));
        }
        for value in self.settings.values.iter().filter(|v| self.reports.is_multiple_of(u64::from(v.every.max(1)))) {
            put(value.address.fill(&body.name, &self.output), floats(&[value.of(&numbers)]));
        }
    }
}

fn floats(numbers: &[f64]) -> Vec<OscType> {
    // Values beyond 32-bit floats become the largest finite one, never infinite.
    let (least, greatest) = (f64::from(f32::MIN), f64::from(f32::MAX));
    numbers.iter().map(|v| OscType::Float(v.clamp(least, greatest) as f32)).collect()
}

impl OscValue {
    /// Returns the value in the receiver's scale.
    fn of(&self, numbers: &[f64; 6]) -> f64 {
        let value = self.scale * numbers[self.quantity as usize] + self.offset;
        self.clamp.map_or(value, |[least, greatest]| value.clamp(least, greatest))
    }
}

/// Seconds from NTP's epoch, which OSC's time tags use, to Unix's (RFC 868): 70 years with 17 leap
/// days.
pub const FROM_1900_TO_1970_S: u32 = 2_208_988_800;

/// Converts Unix time to OSC's: seconds since 1900, and a binary fraction.
fn time_tag(unix: Timestamp) -> OscTime {
    let (seconds, ns) = (unix.ns().div_euclid(1_000_000_000), unix.ns().rem_euclid(1_000_000_000));
    // As in NTP, the era ends in 2036 and restarts at 0.
    let seconds = (seconds + i64::from(FROM_1900_TO_1970_S)) as u32;
    OscTime { seconds, fractional: (((ns as u64) << 32) / 1_000_000_000) as u32 }
}

impl Encoder for OscEncoder {
    fn encode(&mut self, report: &Report, send: &mut dyn FnMut(&[u8])) {
        let mut content = Vec::new();
        self.last_rolls_deg.resize(report.bodies.len(), 0.0);
        for (index, body) in report.bodies.iter().enumerate() {
            self.messages(report, index, body, &mut content);
        }
        self.reports += 1;
        if content.is_empty() {
            return;
        }
        let bundle = OscPacket::Bundle(OscBundle { timetag: time_tag(report.unix), content });
        match encoder::encode(&bundle) {
            Ok(bytes) => send(&bytes),
            Err(error) => drop(self.trouble.say(|| format!("a bundle cannot be encoded ({error:?}); please report this"))),
        }
    }

    fn marks_coasting(&self) -> bool {
        self.settings.messages.contains(&OscMessageKind::Status)
    }

    fn marks_loss(&self) -> bool {
        self.marks_coasting()
    }

    fn announces_loss(&self) -> bool {
        self.marks_coasting()
    }
}

#[cfg(test)]
#[path = "osc_tests.rs"]
mod tests;
