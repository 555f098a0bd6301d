//! Lines of JSON: the pose record (contract C3) with ages and times, for scripts and bridges.
//!
//! A line has the record's fields, with only the output's bodies; the camera is null if the output
//! does not include it. `pose` is the pose that this output sends: placed, limited, held. `state`
//! refers to that pose. The measurement is included only if it is the tracker's own of this frame,
//! placed in the same way. After the record's fields come `age_ms` (from mid-exposure to sending),
//! `unix_ns` (mid-exposure in Unix time), `times_ms`, with `[timecode]` the `timecode` of the stamp
//! (null if it is not known), and the marks that apply: the camera's in the line, an object's in
//! its entry. A message that is not a record begins with `"event"`:
//! `{"event":"stale",…}` if no frame came for too long.

use nalgebra::{Matrix3, Matrix6};
use serde::Serialize;
use serde_json::{Value, json};

use super::encoder::Encoder;
use super::mounted::Mount;
use super::placement::Placement;
use super::report::{BodyChoice, BodyReport, Report, ReportedTimecode, Withheld};
use super::transport::StreamSettings;
use crate::geometry::{Body, Pose, Stage};
use crate::protocols::{to_body_axes, to_camera_axes};
use crate::record::{Measurement, PoseSample, StageTimes, State};

/// Settings of a JSON output.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JsonSettings {
    /// Destinations of lines besides UDP.
    pub stream: StreamSettings,
}

/// Turns reports into lines.
pub(super) struct JsonEncoder {
    placement: Placement,
    mount: Option<Mount>,
}

impl JsonEncoder {
    /// Creates an encoder; `placement` has already been applied to the poses, and is applied to the
    /// measurements here.
    pub fn new(placement: Placement, mount: Option<Mount>) -> Self {
        Self { placement, mount }
    }

    /// Returns one line, without its newline.
    fn line(&self, report: &Report) -> String {
        let camera = report.bodies.iter().find(|body| body.choice == BodyChoice::Camera);
        let objects: Vec<ObjectLine> =
            report.bodies.iter().filter(|b| matches!(b.choice, BodyChoice::Object(_))).map(|body| self.object(report, body)).collect();
        // Objects serialise to maps with string keys, which cannot fail.
        let objects = serde_json::to_string(&objects).unwrap_or_default();
        let mount = report.bodies.iter().find(|body| body.choice == BodyChoice::Mount).map(|body| self.mounted(report, body));
        let marks = camera.map(marks).unwrap_or_default() + &mount.unwrap_or_default();
        // All bodies become stale together, as no frame came.
        if report.bodies.first().is_some_and(|body| body.state == State::Stale) {
            let pose = camera.and_then(|body| body.pose.as_ref()).map(to_camera_axes);
            let event = json!({
                "event": "stale", "state": "stale", "sequence": report.sequence, "age_ms": rounded(report.age_ms), "unix_ns": report.unix,
                "pose": pose,
            });
            return format!(r#"{},"objects":{objects}{marks}{}}}"#, opened(event.to_string()), test_mark(report));
        }
        let times = report.sample.as_ref().map(|sample| sample.times);
        let (record, ages) = (self.record(report, camera), ages(report, times));
        format!("{record}{objects}{ages}{}{marks}{}}}", timecode(&report.timecode), test_mark(report))
    }

    /// Returns the record's fields up to the objects.
    fn record(&self, report: &Report, camera: Option<&BodyReport>) -> String {
        let (sequence, tick) = (report.sequence, report.recorded.unwrap_or(report.monotonic));
        let timestamp = report.sample.as_ref().map_or(tick, |sample| sample.timestamp);
        let Some(camera) = camera else {
            let nulls = ["state", "pose", "measured", "covariance", "model", "homography", "essential", "inliers", "rms_px"];
            let nulls: String = nulls.map(|key| format!(r#""{key}":null,"#)).concat();
            return format!(r#"{{"sequence":{sequence},"timestamp_ns":{timestamp},{nulls}"objects":"#);
        };
        let own = report.sample.as_ref().filter(|_| camera.is_passed);
        let placed = || camera.pose.as_ref().map(to_camera_axes);
        // An unplaced pose is sent with all its digits.
        let pose = own.filter(|_| self.placement.is_identity()).map_or_else(placed, |sample| sample.pose);
        let measurement = own.and_then(|sample| sample.measurement).and_then(|m| self.placed(m));
        let (state, times) = (camera.state, StageTimes::default());
        let record = PoseSample {
            sequence,
            timestamp,
            state,
            pose,
            measurement,
            objects: Vec::new(),
            reason: None,
            learnt: Default::default(),
            times,
        };
        // Its last field is the empty list of objects.
        let text = record.to_json_line();
        text.strip_suffix("[]}").map_or(text.clone(), str::to_owned)
    }

    /// Places a measurement like the pose. With inverted angles no covariance can be given, so
    /// nothing is returned.
    fn placed(&self, measurement: Measurement) -> Option<Measurement> {
        if self.placement.is_identity() {
            return Some(measurement);
        }
        let pose = to_camera_axes(&self.placement.apply(&to_body_axes(&measurement.pose)));
        let [covariance, common] = [&measurement.covariance, &measurement.common].map(|part| self.placed_covariance(part));
        Some(Measurement { pose, covariance: covariance?, common: common?, ..measurement })
    }

    fn placed_covariance(&self, covariance: &Matrix6<f64>) -> Option<Matrix6<f64>> {
        if self.placement.is_identity() {
            return Some(*covariance);
        }
        if self.placement.angle_signs != [1.0; 3] {
            return None;
        }
        let rotation: Matrix3<f64> = self.placement.rotation.to_rotation_matrix().into_inner();
        let signs = Matrix3::from_diagonal(&self.placement.position_signs.into());
        let mut by = Matrix6::zeros();
        by.fixed_view_mut::<3, 3>(0, 0).copy_from(&(signs * rotation * self.placement.scale));
        by.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        Some(by * covariance * by.transpose())
    }

    fn object(&self, report: &Report, body: &BodyReport) -> ObjectLine {
        let BodyChoice::Object(index) = body.choice else { return ObjectLine::of(body, None) };
        let own = report.sample.as_ref().filter(|_| body.is_passed).and_then(|sample| sample.objects.get(index));
        let covariance = own.and_then(|object| object.covariance.as_ref()).and_then(|c| self.placed_covariance(c));
        ObjectLine::of(body, covariance)
    }

    /// Returns the filming camera's part, from the comma on; its pose is that of the optical frame.
    fn mounted(&self, report: &Report, body: &BodyReport) -> String {
        let pose = body.pose.as_ref().map(|pose| to_camera_axes(pose).renamed());
        let line = ObjectLine { pose, ..ObjectLine::of(body, self.mounted_covariance(report, body)) };
        // A map with string keys cannot fail.
        format!(r#","mount":{}"#, serde_json::to_string(&line).unwrap_or_default())
    }

    fn mounted_covariance(&self, report: &Report, body: &BodyReport) -> Option<Matrix6<f64>> {
        let (mount, sample) = (self.mount?, report.sample.as_ref().filter(|_| body.is_passed)?);
        let (carrier, covariance) = match mount.carrier {
            BodyChoice::Object(index) => {
                let object = sample.objects.get(index)?;
                (object.pose?, object.covariance?)
            }
            _ => {
                let measured = sample.measurement?;
                (to_body_axes(&measured.pose), measured.covariance)
            }
        };
        self.placed_covariance(&mount.carried_covariance(&carrier, &covariance))
    }
}

impl Encoder for JsonEncoder {
    fn encode(&mut self, report: &Report, send: &mut dyn FnMut(&[u8])) {
        let mut line = self.line(report);
        line.push('\n');
        send(line.as_bytes());
    }
}

/// An object in a line: as in the record, with its marks.
#[derive(Serialize)]
struct ObjectLine {
    name: String,
    state: State,
    pose: Option<Pose<Stage, Body>>,
    covariance: Option<Vec<f64>>,
    #[serde(flatten)]
    marks: Marks,
}

impl ObjectLine {
    fn of(body: &BodyReport, covariance: Option<Matrix6<f64>>) -> Self {
        let covariance = covariance.map(|c| c.transpose().as_slice().to_vec());
        Self { name: body.name.to_string(), state: body.state, pose: body.pose, covariance, marks: Marks::of(body) }
    }
}

/// The marks of a pose besides its state.
#[derive(Serialize)]
struct Marks {
    /// Extrapolated from the newest frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    predicted: Option<bool>,
    /// The last pose is repeated.
    #[serde(skip_serializing_if = "Option::is_none")]
    held: Option<bool>,
    /// Age of the repeated pose, milliseconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    held_ms: Option<Value>,
    /// On its way back to the tracker's pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    blended: Option<bool>,
    /// Why the pose is withheld.
    #[serde(skip_serializing_if = "Option::is_none")]
    withheld: Option<&'static str>,
}

impl Marks {
    fn of(body: &BodyReport) -> Self {
        Self {
            predicted: body.is_predicted.then_some(true),
            held: body.is_held().then_some(true),
            held_ms: body.held.map(|held| rounded(held.as_nanos() as f64 * 1e-6)),
            blended: body.is_blended.then_some(true),
            withheld: body.withheld.map(Withheld::words),
        }
    }
}

/// Returns the camera's marks, from the comma on.
fn marks(body: &BodyReport) -> String {
    // A map with string keys cannot fail.
    let text = serde_json::to_string(&Marks::of(body)).unwrap_or_default();
    match text.trim_start_matches('{').trim_end_matches('}') {
        "" => String::new(),
        marks => format!(",{marks}"),
    }
}

fn test_mark(report: &Report) -> &'static str {
    if report.is_test { r#","test":true"# } else { "" }
}

/// Removes an object's closing brace.
fn opened(mut object: String) -> String {
    object.pop();
    object
}

/// Returns ages and times, from the comma on.
fn ages(report: &Report, times: Option<StageTimes>) -> String {
    let more = format!(r#","age_ms":{},"unix_ns":{}"#, rounded(report.age_ms), report.unix);
    let Some(times) = times else { return more };
    let [decode, acquire, align, pose] = [times.decode_ms, times.acquire_ms, times.align_ms, times.pose_ms].map(rounded);
    more + &format!(r#","times_ms":{{"decode":{decode},"acquire":{acquire},"align":{align},"pose":{pose}}}"#)
}

/// Returns the timecode, from the comma on; nothing without `[timecode]`.
fn timecode(timecode: &ReportedTimecode) -> String {
    match timecode {
        ReportedTimecode::TimeOfDay => String::new(),
        ReportedTimecode::Unknown => r#","timecode":null"#.to_owned(),
        ReportedTimecode::Known(stamped) => format!(r#","timecode":{}"#, stamped.to_json()),
    }
}

/// Rounds to a microsecond.
fn rounded(ms: f64) -> Value {
    json!((ms * 1e3).round() / 1e3)
}

#[cfg(test)]
#[path = "json_tests.rs"]
mod tests;
