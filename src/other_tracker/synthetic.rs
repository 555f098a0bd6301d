//! A camera that moves and turns about all axes, for the tests.

use nalgebra::{UnitQuaternion, Vector3};

use crate::geometry::{Body, Pose, Stage};

/// Where it is at a time, seconds.
pub fn moving(t: f64) -> Pose<Stage, Body> {
    let rotation = UnitQuaternion::from_euler_angles(0.2 * (1.3 * t).sin(), 0.15 * (2.1 * t).cos(), 0.5 * (0.9 * t).sin());
    Pose::new(rotation, Vector3::new(0.8 * (0.7 * t).sin(), -4.0 + 0.4 * (1.1 * t).cos(), 1.6 + 0.2 * (1.7 * t).sin()))
}
