//! Runs `stagepose replay` and reads its records back.

use std::path::Path;
use std::process::Command;

use nalgebra::{Matrix3, Point2, Quaternion, UnitQuaternion, Vector3};
use serde::Deserialize;

/// The parts of a pose record (C3) that the clips are scored on.
#[derive(Deserialize)]
pub struct Record {
    pub sequence: usize,
    pub state: String,
    pub measured: Option<MeasuredPose>,
    /// Row-major.
    pub homography: Option<[f64; 9]>,
}

#[derive(Deserialize)]
pub struct MeasuredPose {
    position_m: [f64; 3],
    orientation_xyzw: [f64; 4],
}

impl Record {
    pub fn is_tracking(&self) -> bool {
        self.state == "tracking"
    }

    /// Maps a point of the reference through the homography, to undistorted frame pixels.
    pub fn place(&self, reference: Point2<f64>) -> Option<Point2<f64>> {
        let homography = Matrix3::from_row_slice(self.homography.as_ref()?);
        Point2::from_homogeneous(homography * reference.to_homogeneous())
    }
}

impl MeasuredPose {
    pub fn position(&self) -> Vector3<f64> {
        self.position_m.into()
    }

    pub fn orientation(&self) -> UnitQuaternion<f64> {
        let [x, y, z, w] = self.orientation_xyzw;
        UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
    }
}

/// Replays a clip and returns the text of `--poses`, one record per line. Outputs go to `folder`.
pub fn replay(clip: &Path, config: &Path, folder: &Path, more: &[&str]) -> String {
    let poses = folder.join("poses.jsonl");
    let mut command = Command::new(env!("CARGO_BIN_EXE_stagepose"));
    command.arg("replay").arg(clip).arg("--config").arg(config).arg("--poses").arg(&poses).args(more);
    let run = command.env_remove("RUST_LOG").output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    std::fs::read_to_string(poses).unwrap()
}

pub fn records(lines: &str) -> Vec<Record> {
    let records: Vec<Record> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(records.iter().enumerate().all(|(row, record)| record.sequence == row));
    records
}

/// Returns the median, or the upper of the two middle values for an even count.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
