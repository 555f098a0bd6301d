//! An OpenTrackIO output: one sample per report of its body, with the static part every two
//! seconds.

use std::time::{Duration, Instant};

use rand::{RngCore, SeedableRng};
use rand_pcg::Pcg64;
use serde_json::{Map, Value, json};
use uuid::Builder;

use super::clocks::{Clocks, SystemClocks};
use super::complaints::Complaints;
use super::encoder::Encoder;
use super::report::{BodyChoice, BodyReport, Report, ReportedTimecode};
use super::rings::Rings;
use super::system_clock::ClockQuality;
use crate::camera::CameraModel;
use crate::frame::Timestamp;
use crate::protocols::PanTiltRoll;
use crate::protocols::opentrackio::{Encoding, ONE_FRAME, datagram};
use crate::protocols::opentrackio_lens::{PrincipalPoint, lens, sensor};
use crate::record::State;
use crate::timecode::{StampedTimecode, TimecodeState};

/// Interval at which the static part of a sample is sent, for receivers that start later. Chosen,
/// not tuned. Raised, they wait longer for it; lowered, packets are larger.
const STATIC_EVERY: Duration = Duration::from_secs(2);

/// Settings of an OpenTrackIO output.
#[derive(Debug, Clone, PartialEq)]
pub struct OpenTrackIoSettings {
    /// JSON or CBOR.
    pub encoding: Encoding,
    /// 1 to 200; also the last byte of the usual multicast group.
    pub source_number: u8,
    /// Width of the sensor to which the lens's lengths refer, millimetres.
    pub sensor_width_mm: f64,
    /// Which field holds the principal point.
    pub principal_point: PrincipalPoint,
}

/// Turns reports into samples.
pub(super) struct OpenTrackIoEncoder {
    encoding: Encoding,
    source_number: u8,
    source_id: String,
    /// Of the reported camera, if its lens is known.
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
        // The source id is the same at every start, given the machine and output; sample ids never
        // repeat.
        let machine = std::fs::read_to_string("/etc/machine-id").unwrap_or_default();
        let source = fnv_1a(machine.trim().bytes().chain(output.bytes()).chain([settings.source_number]));
        let started = SystemClocks.read().unix.ns() as u64;
        Self {
            encoding: settings.encoding,
            source_number: settings.source_number,
            source_id: uuid_urn(&mut Pcg64::seed_from_u64(source)),
            lens: camera.map(|camera| lens(camera, settings.sensor_width_mm, settings.principal_point)),
            sensor: camera.map(|camera| sensor(camera, settings.sensor_width_mm)),
            ids: Pcg64::seed_from_u64(source ^ started ^ u64::from(std::process::id()) << 32),
            // Not 0: the reference receiver takes 0 for a repetition of its initial state.
            sequence: 1,
            static_sent: None,
            last_roll_deg: 0.0,
            too_long: Complaints::new(output),
        }
    }

    /// Returns the sample as one map.
    fn sample(&mut self, report: &Report, body: &BodyReport) -> Value {
        let mut sample = Map::new();
        let mut put = |key: &str, value: Value| sample.insert(key.to_owned(), value);
        put("protocol", json!({"name": "OpenTrackIO", "version": [1, 0, 1]}));
        put("sampleId", json!(uuid_urn(&mut self.ids)));
        put("sourceId", json!(self.source_id));
        put("sourceNumber", json!(self.source_number));
        put("tracker", tracker(report, body));
        put("timing", timing(report));
        if self.lens.is_some() || report.rings != Rings::default() {
            let mut lens = self.lens.clone().unwrap_or_else(|| json!({}));
            report.rings.add_to_lens(&mut lens);
            put("lens", lens);
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

/// Returns the status in renderers' terms, and in this program's own.
fn tracker(report: &Report, body: &BodyReport) -> Value {
    let mut tracker = json!({"recording": false, "status": status(report, body)});
    let mut notes: Vec<&str> = Vec::new();
    match (body.state, body.withheld) {
        (_, Some(reason)) => notes.extend(["withheld", reason.words()]),
        (State::Tracking, _) if body.is_predicted => notes.push("predicted"),
        (State::Tracking, _) => {}
        (State::Coasting, _) if body.is_blended => notes.push("blended"),
        (state, _) => notes.push(state.word()),
    }
    if body.is_held() {
        notes.push("held");
    }
    match &report.timecode {
        ReportedTimecode::Unknown => notes.push("no timecode"),
        ReportedTimecode::Known(StampedTimecode { state: TimecodeState::FreeWheeling { .. }, .. }) => notes.push("timecode free-wheeling"),
        ReportedTimecode::Known(_) | ReportedTimecode::TimeOfDay => {}
    }
    if !notes.is_empty() {
        tracker["notes"] = json!(notes.join(", "));
    }
    tracker
}

/// Returns Mo-Sys's status words, which renderers know.
fn status(report: &Report, body: &BodyReport) -> &'static str {
    match body.state {
        _ if report.is_test => "Test Signal",
        _ if body.withheld.is_some() => "Optical Unstable",
        State::Tracking => "Optical Good",
        State::Coasting => "Optical Unreliable",
        State::Searching => "Location Searching",
        State::Lost => "Optical Lost",
        State::Stale => "I/O Error",
    }
}

fn timing(report: &Report) -> Value {
    let mut timing = json!({
        "mode": "internal",
        "sampleRate": fraction(report.rate_hz),
        "sampleTimestamp": timestamp(report.unix),
        // The number wraps.
        "sequenceNumber": report.sequence as u32,
    });
    match &report.timecode {
        // Without a timecode, Unreal shows no time at all.
        ReportedTimecode::TimeOfDay => timing["timecode"] = time_of_day(report.unix, report.rate_hz),
        ReportedTimecode::Known(stamped) => timing["timecode"] = timecode(stamped, report.rate_hz),
        ReportedTimecode::Unknown => {}
    }
    if let Some(clock) = report.clock {
        timing["synchronization"] = synchronization(report, clock);
    }
    if let Some(recorded) = report.recorded {
        timing["recordedTimestamp"] = timestamp(recorded);
    }
    timing
}

fn timestamp(at: Timestamp) -> Value {
    let ns = at.ns().max(0);
    json!({"seconds": ns / 1_000_000_000, "nanoseconds": ns % 1_000_000_000})
}

/// Returns frames per second as a fraction, using the broadcast rates where they fit.
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

/// Returns what the stamps' clock follows. The format has no word for a clock that follows nothing:
/// it is not locked. A frequency is stated only if the samples lie on the clock's frames; without
/// one, they are free-running.
fn synchronization(report: &Report, clock: ClockQuality) -> Value {
    // The kernel does not know which service keeps its clock; nearly always it is NTP.
    let mut synchronization = json!({"locked": clock.is_synchronised, "source": "ntp"});
    if report.is_on_clock {
        synchronization["frequency"] = fraction(report.rate_hz);
    }
    synchronization
}

/// Returns the timecode of the production; with a sub-frame, from 0, if several samples share a
/// frame of it.
fn timecode(stamped: &StampedTimecode, rate_hz: f64) -> Value {
    let (code, (num, denom)) = (stamped.code, stamped.rate.fraction());
    let mut timecode = json!({
        "hours": code.hours, "minutes": code.minutes, "seconds": code.seconds, "frames": code.frames,
        "frameRate": {"num": num, "denom": denom}, "dropFrame": code.is_drop,
    });
    let per_frame = (rate_hz / stamped.rate.fps()).round();
    if per_frame >= 2.0 {
        timecode["subFrame"] = json!((stamped.fraction * per_frame).floor() as u32);
    }
    timecode
}

/// Returns the time of day (UTC) as a timecode.
fn time_of_day(unix: Timestamp, rate_hz: f64) -> Value {
    let (num, mut denom) = fraction_of(rate_hz);
    // A timecode counts at most 120 frames per second.
    while num > 120 * denom {
        denom *= 2;
    }
    let of_day = unix.ns().rem_euclid(86_400_000_000_000);
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
