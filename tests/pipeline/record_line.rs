//! Invariants of every line of the pose record, whatever the frame showed.

use std::collections::BTreeSet;

use nalgebra::Matrix6;
use serde_json::Value;
use stagepose::PoseSample;

/// All keys of a line.
const KEYS: [&str; 12] = [
    "sequence",
    "timestamp_ns",
    "state",
    "pose",
    "measured",
    "covariance",
    "model",
    "homography",
    "essential",
    "inliers",
    "rms_px",
    "objects",
];
const MEASURED_ONLY: [&str; 7] = ["measured", "covariance", "model", "homography", "essential", "inliers", "rms_px"];

/// Parses the sample's line and checks it against contract C3.
pub fn assert_record_holds(sample: &PoseSample) {
    let text = sample.to_json_line();
    assert!(!text.contains('\n') && !text.contains("NaN") && !text.contains("inf"), "{text}");
    let line: Value = serde_json::from_str(&text).unwrap();
    let keys: BTreeSet<&str> = line.as_object().unwrap().keys().map(String::as_str).collect();
    assert_eq!(keys, BTreeSet::from(KEYS));
    assert_eq!(line["sequence"], sample.sequence);
    assert_eq!(line["timestamp_ns"], sample.timestamp.ns());
    let state = line["state"].as_str().unwrap();
    assert_eq!(!line["pose"].is_null(), matches!(state, "tracking" | "coasting"), "{text}");
    for key in MEASURED_ONLY {
        let value = line.get(key).unwrap_or_else(|| panic!("{key} is missing: {text}"));
        let may_be_null = state != "tracking" || matches!(key, "homography" | "essential");
        assert!(value.is_null() || state == "tracking", "{key} while {state}: {text}");
        assert!(!value.is_null() || may_be_null, "no {key}: {text}");
    }
    if state == "tracking" {
        assert_eq!(line["pose"], line["measured"], "without a filter");
        assert_covariance(&line["covariance"]);
        assert!(matches!(line["model"].as_str(), Some("homography" | "essential")));
        assert!(line["inliers"].as_u64().unwrap() > 0 && line["rms_px"].as_f64().unwrap() > 0.0);
        if !line["homography"].is_null() {
            let h = numbers(&line["homography"], 9);
            assert_eq!(h[8], 1.0);
        }
        if !line["essential"].is_null() {
            assert_unit(&numbers(&line["essential"]["rotation_xyzw"], 4));
            assert!(numbers(&line["essential"]["rotation_xyzw"], 4)[3] >= 0.0);
            assert_unit(&numbers(&line["essential"]["translation_direction"], 3));
            assert!(line["essential"]["inliers"].as_u64().is_some());
        }
    }
    assert_pose(&line["pose"]);
    for object in line["objects"].as_array().unwrap() {
        assert_object(object, state);
    }
}

fn assert_object(object: &Value, stage: &str) {
    let state = object["state"].as_str().unwrap();
    assert!(object["name"].is_string());
    assert!(state != "tracking" || stage == "tracking", "an object tracks while the stage is {stage}");
    assert_eq!(!object["pose"].is_null(), matches!(state, "tracking" | "coasting"), "{object}");
    assert_eq!(!object["covariance"].is_null(), state == "tracking", "{object}");
    assert_pose(&object["pose"]);
    if state == "tracking" {
        assert_covariance(&object["covariance"]);
    }
}

fn numbers(value: &Value, count: usize) -> Vec<f64> {
    let all: Vec<f64> = value.as_array().unwrap().iter().map(|v| v.as_f64().expect("a number")).collect();
    assert_eq!(all.len(), count);
    assert!(all.iter().all(|v| v.is_finite()));
    all
}

fn assert_unit(v: &[f64]) {
    assert!((v.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < 1e-9, "{v:?}");
}

fn assert_pose(pose: &Value) {
    if pose.is_null() {
        return;
    }
    numbers(&pose["position_m"], 3);
    let q = numbers(&pose["orientation_xyzw"], 4);
    assert_unit(&q);
    assert!(q[3] >= 0.0);
}

fn assert_covariance(covariance: &Value) {
    let m = Matrix6::from_row_slice(&numbers(covariance, 36));
    assert_eq!(m, m.transpose());
    assert!(m.cholesky().is_some(), "not positive definite: {m}");
}
