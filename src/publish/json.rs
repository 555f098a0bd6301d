//! Lines of JSON: the pose record (contract C3) with ages and times, for scripts and bridges.
//!
//! A line has the record's fields, with `pose` as this output sends it, and after them: `age_ms` (from mid-exposure to the moment of
//! sending), `unix_ns` (mid-exposure in Unix time), `times_ms`, and where they apply `held`, `blended`, `withheld`. A message that is no
//! record begins with `"event"`: `{"event":"stale",…}` where no frame came for too long.

use serde_json::{Value, json};

use super::body_pose::camera_of_body;
use super::encoder::Encoder;
use super::report::{BodyReport, Report, Standing};
use super::settings::StreamSettings;
use crate::record::{ObjectSample, PoseSample, StageTimes, State};

/// How an output writes JSON.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JsonSettings {
    /// Where lines go besides UDP.
    pub stream: StreamSettings,
}

/// Turns reports into lines.
pub(super) struct JsonEncoder;

impl Encoder for JsonEncoder {
    fn encode(&mut self, report: &Report, send: &mut dyn FnMut(&[u8])) {
        let mut line = line(report);
        line.push('\n');
        send(line.as_bytes());
    }
}

/// One line, without its end.
fn line(report: &Report) -> String {
    let main = report.bodies.first();
    if main.is_some_and(|body| body.standing == Standing::Stale) {
        return json!({
            "event": "stale", "sequence": report.sequence, "age_ms": rounded(report.age_ms), "unix_ns": report.unix_ns,
            "pose": main.and_then(|body| body.pose), "held": main.is_some_and(|body| body.is_held),
        })
        .to_string();
    }
    let mut record = record(report);
    for body in &report.bodies {
        set_pose(&mut record, body, report.sample.is_none());
    }
    let mut text = record.to_json_line();
    // The record is an object: what follows goes inside its closing brace.
    text.pop();
    text.push_str(&additions(report, main, record.times));
    text
}

/// The tracker's record, or on a fixed rate one that has nothing but states and poses.
fn record(report: &Report) -> PoseSample {
    if let Some(sample) = &report.sample {
        return PoseSample::clone(sample);
    }
    PoseSample {
        sequence: report.sequence,
        timestamp_ns: report.recorded_ns.unwrap_or(report.monotonic_ns),
        state: State::Searching,
        pose: None,
        measurement: None,
        objects: Vec::new(),
        times: StageTimes::default(),
    }
}

/// Puts a body's pose, as the output sends it, where the record has that body.
fn set_pose(record: &mut PoseSample, body: &BodyReport, is_resampled: bool) {
    if &*body.name == CAMERA {
        if is_resampled || !body.is_untouched {
            record.pose = body.pose.as_ref().map(camera_of_body);
        }
        if is_resampled {
            record.state = state(body.standing);
        }
        return;
    }
    if let Some(object) = record.objects.iter_mut().find(|object| *object.name == *body.name) {
        if !body.is_untouched {
            object.pose = body.pose;
        }
    } else if is_resampled {
        let (name, state) = (body.name.to_string(), state(body.standing));
        record.objects.push(ObjectSample { name, state, pose: body.pose, covariance: None });
    }
}

/// The camera's name among the bodies.
pub(super) const CAMERA: &str = "camera";

fn state(standing: Standing) -> State {
    match standing {
        Standing::Tracking => State::Tracking,
        Standing::Coasting => State::Coasting,
        Standing::Searching => State::Searching,
        Standing::Lost | Standing::Stale | Standing::Withheld(_) => State::Lost,
    }
}

/// What a line has besides the record, from the comma to the closing brace.
fn additions(report: &Report, main: Option<&BodyReport>, times: StageTimes) -> String {
    let mut more = format!(r#","age_ms":{},"unix_ns":{}"#, rounded(report.age_ms), report.unix_ns);
    if report.sample.is_some() {
        let [decode, acquire, align, pose] = [times.decode_ms, times.acquire_ms, times.align_ms, times.pose_ms].map(rounded);
        more += &format!(r#","times_ms":{{"decode":{decode},"acquire":{acquire},"align":{align},"pose":{pose}}}"#);
    }
    let Some(body) = main else { return more + "}" };
    if body.is_held {
        more += r#","held":true"#;
    }
    if body.is_blended {
        more += r#","blended":true"#;
    }
    if let Standing::Withheld(reason) = body.standing {
        more += &format!(r#","withheld":"{}""#, reason.words());
    }
    if report.is_test {
        more += r#","test":true"#;
    }
    more + "}"
}

/// To a microsecond.
fn rounded(ms: f64) -> Value {
    json!((ms * 1e3).round() / 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::publish::golden::{golden_camera, golden_report};
    use crate::publish::report::Withheld;
    use std::sync::Arc;

    fn sample() -> PoseSample {
        PoseSample {
            sequence: 17,
            timestamp_ns: 5,
            state: State::Tracking,
            pose: Some(golden_camera()),
            measurement: None,
            objects: Vec::new(),
            times: StageTimes { decode_ms: 1.5, ..StageTimes::default() },
        }
    }

    fn parsed(report: &Report) -> Value {
        let mut lines = Vec::new();
        JsonEncoder.encode(report, &mut |line| lines.push(String::from_utf8(line.to_vec()).unwrap()));
        assert_eq!((lines.len(), lines[0].matches('\n').count(), lines[0].ends_with('\n')), (1, 1, true));
        serde_json::from_str(&lines[0]).unwrap()
    }

    #[test]
    fn a_line_is_the_record_and_more() {
        let report = Report { sample: Some(Arc::new(sample())), ..golden_report(Standing::Tracking) };
        assert!(line(&report).starts_with(sample().to_json_line().trim_end_matches('}')));
        let value = parsed(&report);
        assert_eq!((&value["age_ms"], &value["times_ms"]["decode"]), (&json!(12.5), &json!(1.5)));
        assert_eq!(value["unix_ns"], json!(1_700_000_000_040_000_000_i64));
        assert_eq!(value["pose"]["position_m"], json!([0.0, -4.0, 0.0]));
    }

    #[test]
    fn a_withheld_pose_is_not_in_the_line() {
        let mut report = Report { sample: Some(Arc::new(sample())), ..golden_report(Standing::Withheld(Withheld::OutsideBox)) };
        (report.bodies[0].pose, report.bodies[0].is_untouched) = (None, false);
        let value = parsed(&report);
        assert_eq!((&value["pose"], &value["withheld"]), (&Value::Null, &json!("outside the permitted box")));
    }

    #[test]
    fn a_stale_marker_is_an_event() {
        let mut report = golden_report(Standing::Stale);
        report.bodies[0].pose = None;
        let value = parsed(&report);
        assert_eq!((&value["event"], &value["pose"], &value["age_ms"]), (&json!("stale"), &Value::Null, &json!(12.5)));
    }

    #[test]
    fn on_a_fixed_rate_there_are_states_and_poses() {
        let mut report = golden_report(Standing::Coasting);
        report.bodies.push(BodyReport { name: Arc::from("cart"), standing: Standing::Tracking, ..report.bodies[0].clone() });
        let value = parsed(&report);
        assert_eq!((&value["state"], &value["measured"]), (&json!("coasting"), &Value::Null));
        assert_eq!(value["pose"]["position_m"], json!([0.0, -4.0, 0.0]));
        assert_eq!((&value["objects"][0]["name"], &value["objects"][0]["state"]), (&json!("cart"), &json!("tracking")));
    }
}
