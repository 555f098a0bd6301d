use std::sync::Arc;
use std::time::Duration;

use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::frame::Timestamp;
use crate::protocols::golden::golden_camera;
use crate::publish::golden::{golden_body, golden_report};
use crate::publish::report::Withheld;
use crate::record::{ObjectSample, TwoViewModel};
use crate::timecode::{StampedTimecode, TimecodeRate, TimecodeState};

fn covariance() -> Matrix6<f64> {
    Matrix6::from_fn(|r, c| if r == c { 1.0 + r as f64 } else { 0.01 * (r + c) as f64 })
}

fn sample() -> PoseSample {
    let measurement = Measurement {
        pose: golden_camera(),
        covariance: covariance(),
        common: Matrix6::zeros(),
        model: Some(TwoViewModel::Homography),
        homography: None,
        essential: None,
        inliers: Some(7),
        rms_px: Some(0.25),
    };
    let cart = |name: &str, x| ObjectSample {
        name: name.to_owned(),
        state: State::Tracking,
        pose: Some(Pose::new(UnitQuaternion::identity(), Vector3::new(x, 0.0, 0.0))),
        covariance: Some(covariance()),
        common: None,
    };
    PoseSample {
        sequence: 17,
        timestamp: Timestamp::from_ns(5),
        state: State::Tracking,
        pose: Some(golden_camera()),
        measurement: Some(measurement),
        objects: vec![cart("cart", 9.0), cart("lamp", 3.0)],
        reason: None,
        learnt: Default::default(),
        times: StageTimes { decode_ms: 1.5, ..StageTimes::default() },
    }
}

/// The camera in this state, and the two objects of the sample, tracked.
fn report(state: State) -> Report {
    let mut report = Report { sample: Some(Arc::new(sample())), ..golden_report(state) };
    for (index, object) in sample().objects.into_iter().enumerate() {
        let (name, choice) = (object.name.into(), BodyChoice::Object(index));
        report.bodies.push(BodyReport { name, choice, pose: object.pose, ..golden_body(State::Tracking) });
    }
    report
}

fn line(placement: Placement, report: &Report) -> String {
    let mut lines = Vec::new();
    JsonEncoder::new(placement, None).encode(report, &mut |line| lines.push(String::from_utf8(line.to_vec()).unwrap()));
    assert_eq!((lines.len(), lines[0].matches('\n').count(), lines[0].ends_with('\n')), (1, 1, true));
    lines.remove(0)
}

fn parsed(report: &Report) -> Value {
    serde_json::from_str(&line(Placement::default(), report)).unwrap()
}

#[test]
fn a_json_line_is_the_record_plus_output_fields() {
    let line = line(Placement::default(), &report(State::Tracking));
    assert!(line.starts_with(sample().to_json_line().trim_end_matches('}')), "{line}");
    let value: Value = serde_json::from_str(&line).unwrap();
    assert_eq!((&value["age_ms"], &value["times_ms"]["decode"]), (&json!(12.5), &json!(1.5)));
    assert_eq!(value["unix_ns"], json!(1_700_000_000_040_000_000_i64));
}

#[test]
fn a_json_line_has_only_the_chosen_bodies() {
    let mut chosen = report(State::Tracking);
    // The lamp, which is the second object.
    chosen.bodies = vec![chosen.bodies[2].clone()];
    let value = parsed(&chosen);
    assert_eq!(value["objects"].as_array().unwrap().len(), 1);
    assert_eq!((&value["objects"][0]["name"], &value["objects"][0]["covariance"][1]), (&json!("lamp"), &json!(0.01)));
    for key in ["state", "pose", "measured", "covariance", "model", "homography", "essential", "inliers", "rms_px"] {
        assert_eq!(value.get(key), Some(&Value::Null), "{key}");
    }
    chosen.bodies = vec![golden_body(State::Tracking)];
    assert_eq!(parsed(&chosen)["objects"], json!([]));
}

#[test]
fn withheld_poses_appear_nowhere_in_the_json_line() {
    let mut report = report(State::Lost);
    for (body, reason) in report.bodies.iter_mut().zip([Withheld::OutsideBox, Withheld::TooFast]) {
        (body.state, body.withheld, body.pose, body.is_passed) = (State::Lost, Some(reason), None, false);
    }
    let value = parsed(&report);
    assert_eq!((&value["state"], &value["pose"], &value["measured"]), (&json!("lost"), &Value::Null, &Value::Null));
    assert_eq!((&value["covariance"], &value["withheld"]), (&Value::Null, &json!("outside the permitted box")));
    let cart = json!({"name": "cart", "state": "lost", "pose": null, "covariance": null, "withheld": "faster than permitted"});
    assert_eq!(value["objects"][0], cart);
    assert_eq!(value["objects"][1].get("withheld"), None);
}

#[test]
fn what_is_held_or_blended_is_not_tracking() {
    let mut report = report(State::Coasting);
    (report.bodies[0].is_blended, report.bodies[0].is_passed) = (true, false);
    (report.bodies[1].state, report.bodies[1].held, report.bodies[1].is_passed) = (State::Lost, Some(Duration::from_micros(2_500)), false);
    let value = parsed(&report);
    assert_eq!((&value["state"], &value["blended"], &value["measured"]), (&json!("coasting"), &json!(true), &Value::Null));
    assert_eq!(value["pose"]["position_m"], json!([0.0, -4.0, 0.0]));
    let cart = &value["objects"][0];
    assert_eq!((&cart["state"], &cart["held"], &cart["held_ms"]), (&json!("lost"), &json!(true), &json!(2.5)));
    assert_eq!(cart["covariance"], Value::Null);
}

#[test]
fn measured_poses_get_the_same_placement_as_the_pose() {
    let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    let placement = Placement { rotation: quarter, scale: 10.0, position_signs: [-1.0, 1.0, 1.0], ..Placement::default() };
    let mut report = report(State::Tracking);
    report.bodies.iter_mut().for_each(|body| body.pose = body.pose.map(|pose| placement.apply(&pose)));
    let value: Value = serde_json::from_str(&line(placement, &report)).unwrap();
    // 4 m in front becomes 4 m to the right, 40 units, with the opposite sign.
    let x = value["measured"]["position_m"][0].as_f64().unwrap();
    assert!((x + 40.0).abs() < 1e-9 && value["pose"] == value["measured"], "{value}");
    // The variances of x and y swap, in units squared; those of the rotation have no unit.
    let variance = |k: usize| value["covariance"][7 * k].as_f64().unwrap();
    let wanted = [200.0, 100.0, 300.0, 5.0, 4.0, 6.0];
    assert!((0..6).all(|k| (variance(k) - wanted[k]).abs() < 1e-9), "{value}");
    let inverted = Placement { angle_signs: [-1.0, 1.0, 1.0], ..placement };
    let value: Value = serde_json::from_str(&line(inverted, &report)).unwrap();
    assert_eq!((&value["measured"], &value["objects"][0]["covariance"]), (&Value::Null, &Value::Null));
}

#[test]
fn a_stale_marker_is_an_event_with_optical_axes() {
    let mut stale = golden_report(State::Stale);
    stale.bodies[0].pose = None;
    let value = parsed(&stale);
    assert_eq!((&value["event"], &value["state"], &value["pose"]), (&json!("stale"), &json!("stale"), &Value::Null));
    assert_eq!((&value["age_ms"], value.get("held")), (&json!(12.5), None));
    let mut held = report(State::Stale);
    held.bodies.iter_mut().for_each(|body| (body.state, body.held, body.is_passed) = (State::Stale, Some(Duration::from_millis(3)), false));
    let value = parsed(&held);
    let rotation = value["pose"]["orientation_xyzw"].as_array().unwrap();
    assert!(rotation.iter().zip(golden_camera().orientation_xyzw()).all(|(sent, wanted)| (sent.as_f64().unwrap() - wanted).abs() < 1e-12));
    assert_eq!((&value["held"], &value["objects"][1]["held_ms"]), (&json!(true), &json!(3.0)));
}

#[test]
fn fixed_rate_lines_contain_states_and_poses() {
    let mut report = golden_report(State::Tracking);
    report.bodies[0].is_predicted = true;
    let (name, choice) = (Arc::from("cart"), BodyChoice::Object(0));
    report.bodies.push(BodyReport { name, choice, ..golden_body(State::Coasting) });
    let value = parsed(&report);
    assert_eq!((&value["state"], &value["predicted"], &value["measured"]), (&json!("tracking"), &json!(true), &Value::Null));
    assert_eq!(value["pose"]["position_m"], json!([0.0, -4.0, 0.0]));
    assert_eq!((&value["objects"][0]["name"], &value["objects"][0]["state"]), (&json!("cart"), &json!("coasting")));
}

#[test]
fn the_timecode_follows_the_ages() {
    let stamped = StampedTimecode {
        code: "23:59:59:24".parse().unwrap(),
        fraction: 0.25,
        rate: TimecodeRate::Fps25,
        state: TimecodeState::FreeWheeling { for_s: 1.5 },
    };
    let of = |timecode| -> serde_json::Value {
        serde_json::from_str(&line(Placement::default(), &Report { timecode, ..report(State::Tracking) })).unwrap()
    };
    let wanted = json!({"timecode": "23:59:59:24", "fraction": 0.25, "rate": "25", "state": "free-wheeling", "without_s": 1.5});
    assert_eq!(of(ReportedTimecode::Known(stamped))["timecode"], wanted);
    assert!(of(ReportedTimecode::Unknown).as_object().unwrap().get("timecode").is_some_and(serde_json::Value::is_null));
    assert!(of(ReportedTimecode::TimeOfDay).get("timecode").is_none());
}
