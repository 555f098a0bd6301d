//! The fixture: poses match the exact ground truth, and the bytes are the same for any number of
//! threads.

use std::path::{Path, PathBuf};

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::replayed::{Record, median, records, replay};

/// Errors above which a pose is wrong: fraction of the camera's distance, and degrees.
const WRONG: (f64, f64) = (0.01, 0.3);

fn fixture() -> PathBuf {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/dolly")).to_owned()
}

/// Returns the camera's position and orientation in the stage, one row per frame.
fn truth() -> Vec<(Vector3<f64>, UnitQuaternion<f64>)> {
    let text = std::fs::read_to_string(fixture().join("groundtruth.txt")).unwrap();
    let row = |line: &str| {
        let v: Vec<f64> = line.split_whitespace().map(|v| v.parse().unwrap()).collect();
        (Vector3::new(v[1], v[2], v[3]), UnitQuaternion::from_quaternion(Quaternion::new(v[7], v[4], v[5], v[6])))
    };
    text.lines().filter(|line| !line.starts_with('#')).map(row).collect()
}

fn track(threads: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    replay(&fixture(), &fixture().join("stage.toml"), folder.path(), &["--threads", threads])
}

#[test]
fn one_thread_and_two_give_the_same_bytes() {
    assert_eq!(track("1"), track("2"));
}

#[test]
fn the_poses_are_the_true_ones() {
    let (records, truth) = (records(&track("1")), truth());
    assert_eq!(records.len(), truth.len());
    let tracked: Vec<&Record> = records.iter().filter(|record| record.is_tracking()).collect();
    assert!(tracked.len() * 20 >= records.len() * 19, "only {} of {} frames are tracked", tracked.len(), records.len());
    let mut errors_m = Vec::new();
    for record in tracked {
        let (position, orientation) = &truth[record.sequence];
        let measured = record.measured.as_ref().unwrap();
        let error_m = (measured.position() - position).norm();
        let error_deg = measured.orientation().angle_to(orientation).to_degrees();
        let is_wrong = error_m > WRONG.0 * position.norm() || error_deg > WRONG.1;
        assert!(!is_wrong, "frame {}: {error_m:.4} m and {error_deg:.3} degrees off", record.sequence);
        errors_m.push(error_m);
    }
    let median_mm = 1e3 * median(errors_m);
    eprintln!("fixture: median position error {median_mm:.3} mm");
    assert!(median_mm < 1.0, "median position error {median_mm:.3} mm");
}
