//! OpenTrackIO 1.0.1: pose, lens, timing and status in one datagram, as JSON or CBOR behind a 16-byte header.
//!
//! Fields and frames from SMPTE's ris-osvp-metadata-camdkit; angles are intrinsic z, x, y with pan positive to the left. A sample is
//! never split: the reference receiver and Unreal disagree on how parts are numbered. The `static` part comes with the first sample and
//! every two seconds.

use std::time::{Duration, Instant};

use rand::{RngCore, SeedableRng};
use rand_pcg::Pcg64;
use serde_json::{Map, Value, json};
use thiserror::Error;
use uuid::Builder;

use super::body_pose::PanTiltRoll;
use super::clocks::{Clocks, SystemClocks};
use super::complaints::Complaints;
use super::encoder::Encoder;
use super::opentrackio_lens::{PrincipalPoint, lens, sensor};
use super::report::{BodyReport, Report, Standing};
use super::settings::BodyChoice;
use crate::camera::CameraModel;

/// Bytes before the payload.
pub const HEADER: usize = 16;
/// A datagram up to here crosses an Ethernet in one piece.
const ONE_FRAME: usize = 1472;
/// The length field has 15 bits.
const LONGEST_PAYLOAD: usize = 0x7FFF;
const STATIC_EVERY: Duration = Duration::from_secs(2);

/// How a payload is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Text, read by every receiver.
    Json,
    /// The same, in binary.
    Cbor,
}

impl Encoding {
    fn code(self) -> u8 {
        match self {
            Self::Json => 1,
            Self::Cbor => 2,
        }
    }
}

/// How an output speaks OpenTrackIO.
#[derive(Debug, Clone, PartialEq)]
pub struct OpenTrackIoSettings {
    /// JSON or CBOR.
    pub encoding: Encoding,
    /// 1 to 200; also the last byte of the usual multicast group.
    pub source_number: u8,
    /// Width of the sensor that lengths of the lens are told for, millimetres.
    pub sensor_width_mm: f64,
    /// Where the principal point goes.
    pub principal_point: PrincipalPoint,
}

/// Why a datagram is no OpenTrackIO sample.
#[derive(Debug, Error)]
pub enum OpenTrackIoError {
    /// Too short, or other first bytes.
    #[error("it does not begin with OTrk; set the sender to OpenTrackIO 1.0.1")]
    Identifier,
    /// A vendor's own encoding.
    #[error("encoding {0:#04x} is neither JSON (1) nor CBOR (2)")]
    Encoding(u8),
    /// A part of a sample.
    #[error("it is one part of a longer sample; set the sender to one datagram a sample")]
    Segment,
    /// Another length than announced.
    #[error("the payload has {found} bytes, the header says {announced}")]
    Length {
        /// As received.
        found: usize,
        /// As announced.
        announced: usize,
    },
    /// Damaged.
    #[error("the checksum is {found:#06x}, not {wanted:#06x}; the datagram is damaged, or of version 1.0.0")]
    Checksum {
        /// As received.
        found: u16,
        /// As computed.
        wanted: u16,
    },
    /// The payload is not what its encoding says.
    #[error("the payload cannot be read ({0})")]
    Payload(String),
}

/// Fletcher's checksum with sums modulo 256, over several pieces.
fn fletcher_16(pieces: &[&[u8]]) -> u16 {
    let (mut first, mut second) = (0_u8, 0_u8);
    for byte in pieces.iter().copied().flatten() {
        first = first.wrapping_add(*byte);
        second = second.wrapping_add(first);
    }
    u16::from_be_bytes([second, first])
}

/// The datagram of a payload; `None` where it is longer than a datagram can say.
pub fn datagram(encoding: Encoding, sequence: u16, payload: &[u8]) -> Option<Vec<u8>> {
    let length = u16::try_from(payload.len()).ok().filter(|_| payload.len() <= LONGEST_PAYLOAD)?;
    let mut bytes = Vec::with_capacity(HEADER + payload.len());
    bytes.extend_from_slice(b"OTrk");
    bytes.extend_from_slice(&[0, encoding.code()]);
    bytes.extend_from_slice(&sequence.to_be_bytes());
    bytes.extend_from_slice(&0_u32.to_be_bytes());
    // The upper bit: this is the last part.
    bytes.extend_from_slice(&(length | 0x8000).to_be_bytes());
    let sum = fletcher_16(&[&bytes, payload]);
    bytes.extend_from_slice(&sum.to_be_bytes());
    bytes.extend_from_slice(payload);
    Some(bytes)
}

/// Reads a datagram: its sequence number and the sample.
///
/// # Errors
/// Anything but one whole, undamaged sample in JSON or CBOR.
pub fn decode(bytes: &[u8]) -> Result<(u16, Value), OpenTrackIoError> {
    let Some((header, payload)) = bytes.split_at_checked(HEADER).filter(|(header, _)| header.starts_with(b"OTrk")) else {
        return Err(OpenTrackIoError::Identifier);
    };
    let word = |at: usize| u16::from_be_bytes([header[at], header[at + 1]]);
    let announced = usize::from(word(12) & 0x7FFF);
    if header[8..12] != [0; 4] || word(12) & 0x8000 == 0 {
        return Err(OpenTrackIoError::Segment);
    }
    if announced != payload.len() {
        return Err(OpenTrackIoError::Length { found: payload.len(), announced });
    }
    let (found, wanted) = (word(14), fletcher_16(&[&header[..14], payload]));
    if found != wanted {
        return Err(OpenTrackIoError::Checksum { found, wanted });
    }
    let sample = match header[5] {
        1 => serde_json::from_slice(payload).map_err(|e| OpenTrackIoError::Payload(e.to_string()))?,
        2 => ciborium::from_reader(payload).map_err(|e| OpenTrackIoError::Payload(e.to_string()))?,
        other => return Err(OpenTrackIoError::Encoding(other)),
    };
    Ok((word(6), sample))
}

/// Turns reports into samples.
pub(super) struct OpenTrackIoEncoder {
    encoding: Encoding,
    source_number: u8,
    source_id: String,
    /// Of the camera that is spoken of, where its lens is known.
    lens: Option<Value>,
    sensor: Option<Value>,
    ids: Pcg64,
    sequence: u16,
    static_sent: Option<Instant>,
    last_roll_deg: f64,
    too_long: Complaints,
}

impl OpenTrackIoEncoder {
    pub fn new(settings: &OpenTrackIoSettings, camera: Option<&CameraModel>, output: &str) -> Self {
        // The same machine and output have the same source id from start to start; sample ids never repeat.
        let machine = std::fs::read_to_string("/etc/machine-id").unwrap_or_default();
        let source = fnv_1a(machine.trim().bytes().chain(output.bytes()).chain([settings.source_number]));
        let started = SystemClocks.read().unix_ns as u64;
        Self {
            encoding: settings.encoding,
            source_number: settings.source_number,
            source_id: uuid_urn(&mut Pcg64::seed_from_u64(source)),
            lens: camera.map(|camera| lens(camera, settings.sensor_width_mm, settings.principal_point)),
            sensor: camera.map(|camera| sensor(camera, settings.sensor_width_mm)),
            ids: Pcg64::seed_from_u64(source ^ started ^ u64::from(std::process::id()) << 32),
            // Not 0: the reference receiver takes that for a repetition of what it had before the first one.
            sequence: 1,
            static_sent: None,
            last_roll_deg: 0.0,
            too_long: Complaints::new(output),
        }
    }

    /// The sample as one map.
    fn sample(&mut self, report: &Report, body: &BodyReport) -> Value {
        let mut sample = Map::new();
        let mut put = |key: &str, value: Value| sample.insert(key.to_owned(), value);
        put("protocol", json!({"name": "OpenTrackIO", "version": [1, 0, 1]}));
        put("sampleId", json!(uuid_urn(&mut self.ids)));
        put("sourceId", json!(self.source_id));
        put("sourceNumber", json!(self.source_number));
        put("tracker", tracker(report, body));
        put("timing", timing(report));
        if let Some(lens) = &self.lens {
            put("lens", lens.clone());
        }
        if let Some(pose) = &body.pose {
            let angles = PanTiltRoll::of_rotation(&pose.rotation, self.last_roll_deg);
            self.last_roll_deg = angles.roll_deg;
            let p = pose.translation;
            let id = if matches!(body.choice, BodyChoice::Object(_)) { &*body.name } else { "Camera" };
            put(
                "transforms",
                json!([{
                    "id": id,
                    "translation": {"x": p.x, "y": p.y, "z": p.z},
                    "rotation": {"pan": angles.pan_deg, "tilt": angles.tilt_deg, "roll": angles.roll_deg},
                }]),
            );
        }
        if self.static_sent.is_none_or(|sent| sent.elapsed() >= STATIC_EVERY) {
            self.static_sent = Some(Instant::now());
            put("static", self.fixed(report));
        }
        Value::Object(sample)
    }

    fn fixed(&self, report: &Report) -> Value {
        let mut camera = self.sensor.clone().unwrap_or_else(|| json!({}));
        camera["captureFrameRate"] = fraction(report.rate_hz);
        camera["make"] = json!("stagepose");
        camera["model"] = json!(report.bodies.first().map_or("camera", |body| &body.name));
        let tracker = json!({"make": "stagepose", "model": "stagepose", "firmwareVersion": env!("CARGO_PKG_VERSION")});
        json!({"camera": camera, "tracker": tracker})
    }
}

impl Encoder for OpenTrackIoEncoder {
    fn encode(&mut self, report: &Report, send: &mut dyn FnMut(&[u8])) {
        let Some(body) = report.bodies.first() else { return };
        let sample = self.sample(report, body);
        let mut payload = Vec::with_capacity(ONE_FRAME);
        let is_written = match self.encoding {
            Encoding::Json => serde_json::to_writer(&mut payload, &sample).is_ok(),
            Encoding::Cbor => ciborium::into_writer(&sample, &mut payload).is_ok(),
        };
        let Some(bytes) = datagram(self.encoding, self.sequence, &payload).filter(|_| is_written) else {
            self.too_long
                .say(|| format!("a sample of {} bytes does not fit into a datagram; give the object a shorter name", payload.len()));
            return;
        };
        self.sequence = self.sequence.wrapping_add(1);
        send(&bytes);
    }
}

/// The status that renderers know, and what it is by this program's own words.
fn tracker(report: &Report, body: &BodyReport) -> Value {
    let mut tracker = json!({"recording": false, "status": status(report, body)});
    let mut notes: Vec<&str> = Vec::new();
    match body.standing {
        Standing::Tracking if body.is_predicted => notes.push("predicted"),
        Standing::Tracking => {}
        Standing::Coasting if body.is_blended => notes.push("blended"),
        Standing::Withheld(reason) => notes.extend(["withheld", reason.words()]),
        standing => notes.push(standing.word()),
    }
    if body.is_held() {
        notes.push("held");
    }
    if !notes.is_empty() {
        tracker["notes"] = json!(notes.join(", "));
    }
    tracker
}

/// Mo-Sys' words, which renderers know.
fn status(report: &Report, body: &BodyReport) -> &'static str {
    match body.standing {
        _ if report.is_test => "Test Signal",
        Standing::Tracking => "Optical Good",
        Standing::Coasting => "Optical Unreliable",
        Standing::Searching => "Location Searching",
        Standing::Lost => "Optical Lost",
        Standing::Withheld(_) => "Optical Unstable",
        Standing::Stale => "I/O Error",
    }
}

fn timing(report: &Report) -> Value {
    let mut timing = json!({
        "mode": "internal",
        "sampleRate": fraction(report.rate_hz),
        "sampleTimestamp": timestamp(report.unix_ns),
        // The number wraps.
        "sequenceNumber": report.sequence as u32,
        "timecode": timecode(report.unix_ns, report.rate_hz),
    });
    if let Some(recorded_ns) = report.recorded_ns {
        timing["recordedTimestamp"] = timestamp(recorded_ns);
    }
    timing
}

fn timestamp(ns: i64) -> Value {
    let ns = ns.max(0);
    json!({"seconds": ns / 1_000_000_000, "nanoseconds": ns % 1_000_000_000})
}

/// Frames per second as a fraction, with television's own where they fit.
fn fraction(hz: f64) -> Value {
    let (num, denom) = fraction_of(hz);
    json!({"num": num, "denom": denom})
}

fn fraction_of(hz: f64) -> (u32, u32) {
    let hz = hz.clamp(0.001, 1e6);
    let near = [(24_000, 1001), (30_000, 1001), (60_000, 1001), (120_000, 1001)];
    let found = near.into_iter().find(|(num, denom)| (f64::from(*num) / f64::from(*denom) - hz).abs() < 0.005);
    let in_thousandths = (hz * 1e3).round() as u32;
    found.unwrap_or(if in_thousandths.is_multiple_of(1000) { (in_thousandths / 1000, 1) } else { (in_thousandths, 1000) })
}

/// The time of day (UTC) as a timecode: Unreal shows no time at all without one.
fn timecode(unix_ns: i64, rate_hz: f64) -> Value {
    let (num, mut denom) = fraction_of(rate_hz);
    // A timecode counts at most 120 frames a second.
    while num > 120 * denom {
        denom *= 2;
    }
    let of_day = unix_ns.rem_euclid(86_400_000_000_000);
    let (seconds, ns) = (of_day / 1_000_000_000, of_day % 1_000_000_000);
    let frame = (ns as f64 * 1e-9 * f64::from(num) / f64::from(denom)).floor().min(119.0);
    json!({
        "hours": seconds / 3600, "minutes": seconds / 60 % 60, "seconds": seconds % 60, "frames": frame as u32,
        "frameRate": {"num": num, "denom": denom}, "dropFrame": false,
    })
}

fn uuid_urn(random: &mut Pcg64) -> String {
    let mut bytes = [0; 16];
    random.fill_bytes(&mut bytes);
    Builder::from_random_bytes(bytes).into_uuid().urn().to_string()
}

fn fnv_1a(bytes: impl Iterator<Item = u8>) -> u64 {
    bytes.fold(0xCBF2_9CE4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3))
}

#[cfg(test)]
#[path = "opentrackio_tests.rs"]
mod tests;
