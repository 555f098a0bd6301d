//! The golden pose, and packets as hexadecimal digits, shared by the tests of all codecs.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::geometry::{Camera, Pose, Stage};

/// DESIGN section 2: level, 4 m in front of the origin, looking upstage; everything but the
/// distance is zero.
pub(crate) fn golden_camera() -> Pose<Stage, Camera> {
    let s = std::f64::consts::FRAC_1_SQRT_2;
    Pose::new(UnitQuaternion::from_quaternion(Quaternion::new(s, -s, 0.0, 0.0)), Vector3::new(0.0, -4.0, 0.0))
}

pub(crate) fn bytes_of(hex: &str) -> Vec<u8> {
    hex.as_bytes().chunks(2).map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}
