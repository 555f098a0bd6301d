//! What the tests of all protocols share: the golden pose and packets written as hexadecimal digits.

use std::sync::Arc;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::body_pose::body_of_camera;
use super::report::{BodyReport, Report, Standing};
use super::settings::BodyChoice;
use crate::geometry::{Camera, Pose, Stage};

/// DESIGN section 2: level, 4 m in front of the origin, looking upstage; all zeros but for the distance.
pub(crate) fn golden_camera() -> Pose<Stage, Camera> {
    let s = std::f64::consts::FRAC_1_SQRT_2;
    Pose::new(UnitQuaternion::from_quaternion(Quaternion::new(s, -s, 0.0, 0.0)), Vector3::new(0.0, -4.0, 0.0))
}

/// The camera at the golden pose.
pub(crate) fn golden_body(standing: Standing) -> BodyReport {
    BodyReport {
        name: Arc::from("camera"),
        choice: BodyChoice::Camera,
        standing,
        pose: Some(body_of_camera(&golden_camera())),
        held_ns: None,
        is_blended: false,
        is_predicted: false,
        is_passed: true,
    }
}

/// A report of the golden pose.
pub(crate) fn golden_report(standing: Standing) -> Report {
    Report {
        sequence: 17,
        unix_ns: 1_700_000_000_040_000_000,
        monotonic_ns: 5_040_000_000,
        sent_monotonic_ns: 5_052_500_000,
        recorded_ns: None,
        rate_hz: 30.0,
        bodies: vec![golden_body(standing)],
        sample: None,
        age_ms: 12.5,
        is_test: false,
    }
}

pub(crate) fn bytes_of(hex: &str) -> Vec<u8> {
    hex.as_bytes().chunks(2).map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}
