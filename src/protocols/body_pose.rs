//! Converts from the tracker's frames to those that receivers use: body axes, and pan, tilt and
//! roll.
//!
//! The tracker reports the optical camera frame (x right, y down, z forward). FreeD, OpenTrackIO,
//! PSN and OSC use the camera's BODY (x right, y forward, z up), in a stage whose y points away
//! from the viewer, which is this project's stage frame. A level camera that looks upstage has pan
//! = tilt = roll = 0. An object's own frame is already such a body frame.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::geometry::{Body, Camera, Pose, Stage};

/// Pan, tilt and roll in degrees as defined by OpenTrackIO: intrinsic rotations about z, then x,
/// then y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PanTiltRoll {
    /// About the vertical, + to the left (anticlockwise seen from above), -180 to 180.
    pub pan_deg: f64,
    /// + upwards, -90 to 90.
    pub tilt_deg: f64,
    /// About the line of sight, + clockwise seen from behind the camera, -180 to 180.
    pub roll_deg: f64,
}

/// cos(tilt) below which pan and roll rotate about the same line: about 0.00006 degrees from
/// straight up. Chosen: far above a float's rounding. Raised, roll is frozen around the zenith;
/// lowered, both are noise there.
const GIMBAL: f64 = 1e-6;

impl PanTiltRoll {
    /// Returns the angles of R = Rz(pan) Rx(tilt) Ry(roll).
    ///
    /// Straight up or down, only the sum or difference of pan and roll is determined: there roll
    /// stays at `last_roll_deg`.
    pub fn of_rotation(rotation: &UnitQuaternion<f64>, last_roll_deg: f64) -> Self {
        let r: Matrix3<f64> = rotation.to_rotation_matrix().into_inner();
        let cos_tilt = r[(0, 1)].hypot(r[(1, 1)]);
        // atan2 keeps its precision near 90 degrees, where asin loses half of it.
        let tilt = r[(2, 1)].atan2(cos_tilt);
        if cos_tilt > GIMBAL {
            let (pan, roll) = ((-r[(0, 1)]).atan2(r[(1, 1)]), (-r[(2, 0)]).atan2(r[(2, 2)]));
            return Self::from_radians(pan, tilt, roll);
        }
        // R = Rz(pan ± roll) Rx(±90°).
        let sum = r[(1, 0)].atan2(r[(0, 0)]);
        let roll = last_roll_deg.to_radians();
        let pan = if tilt > 0.0 { sum - roll } else { sum + roll };
        Self::from_radians(pan.sin().atan2(pan.cos()), tilt, roll)
    }

    fn from_radians(pan: f64, tilt: f64, roll: f64) -> Self {
        // `+ 0.0` turns -0 into 0.
        let [pan_deg, tilt_deg, roll_deg] = [pan, tilt, roll].map(|v| v.to_degrees() + 0.0);
        Self { pan_deg, tilt_deg, roll_deg }
    }

    /// Returns R = Rz(pan) Rx(tilt) Ry(roll).
    pub fn rotation(&self) -> UnitQuaternion<f64> {
        let about = |axis, degrees: f64| UnitQuaternion::from_axis_angle(&axis, degrees.to_radians());
        about(Vector3::z_axis(), self.pan_deg) * about(Vector3::x_axis(), self.tilt_deg) * about(Vector3::y_axis(), self.roll_deg)
    }
}

/// Returns the body axes in the optical frame: x right = x, y forward = z, z up = -y, a quarter
/// turn about x.
fn r_camera_body() -> UnitQuaternion<f64> {
    let quarter = Rotation3::from_matrix_unchecked(Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0));
    UnitQuaternion::from_rotation_matrix(&quarter)
}

/// Converts the pose of the camera's optical frame to that of its body.
pub fn to_body_axes(t_stage_camera: &Pose<Stage, Camera>) -> Pose<Stage, Body> {
    Pose::new(t_stage_camera.rotation * r_camera_body(), t_stage_camera.translation)
}

/// Converts the pose of the camera's body to that of its optical frame.
pub fn to_camera_axes(t_stage_body: &Pose<Stage, Body>) -> Pose<Stage, Camera> {
    Pose::new(t_stage_body.rotation * r_camera_body().inverse(), t_stage_body.translation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn golden() -> Pose<Stage, Camera> {
        let s = std::f64::consts::FRAC_1_SQRT_2;
        Pose::new(UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(s, -s, 0.0, 0.0)), Vector3::new(0.0, -4.0, 0.0))
    }

    #[test]
    fn the_golden_pose_has_no_angles() {
        let body = to_body_axes(&golden());
        let angles = PanTiltRoll::of_rotation(&body.rotation, 0.0);
        assert!(angles.pan_deg.abs() < 1e-12 && angles.tilt_deg.abs() < 1e-12 && angles.roll_deg.abs() < 1e-12, "{angles:?}");
        assert_eq!(body.translation, Vector3::new(0.0, -4.0, 0.0));
    }

    #[test]
    fn angle_signs_follow_the_standard() {
        let rotated = |pan_deg, tilt_deg, roll_deg| PanTiltRoll { pan_deg, tilt_deg, roll_deg }.rotation();
        // Pan to the left: forward (y) becomes -x.
        assert!((rotated(90.0, 0.0, 0.0) * Vector3::y() + Vector3::x()).norm() < 1e-12);
        // Tilt up: forward becomes +z.
        assert!((rotated(0.0, 90.0, 0.0) * Vector3::y() - Vector3::z()).norm() < 1e-12);
        // Roll clockwise seen from behind: the top leans to the right.
        assert!((rotated(0.0, 0.0, 90.0) * Vector3::z() - Vector3::x()).norm() < 1e-12);
    }

    proptest! {
        #[test]
        fn rotations_round_trip_through_angles(pan_deg in -180.0..180.0, tilt_deg in -90.0..=90.0, roll_deg in -180.0..180.0) {
            let given = PanTiltRoll { pan_deg, tilt_deg, roll_deg }.rotation();
            let back = PanTiltRoll::of_rotation(&given, 0.0).rotation();
            prop_assert!(given.angle_to(&back) < 3e-6);
        }

        #[test]
        fn roll_is_kept_when_looking_straight_up_or_down(pan_deg in -180.0..180.0, last in -180.0..180.0, up in any::<bool>()) {
            let tilt_deg = if up { 90.0 } else { -90.0 };
            let given = PanTiltRoll { pan_deg, tilt_deg, roll_deg: 20.0 }.rotation();
            let angles = PanTiltRoll::of_rotation(&given, last);
            prop_assert!((angles.roll_deg - last).abs() < 1e-9);
            prop_assert!(given.angle_to(&angles.rotation()) < 3e-6);
        }

        #[test]
        fn optical_frame_poses_round_trip(x in -3.0..3.0, y in -3.0..3.0, z in -3.0..3.0) {
            let pose = Pose::<Stage, Camera>::new(UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z)), Vector3::new(x, y, z));
            prop_assert!(to_camera_axes(&to_body_axes(&pose)).angle_to(&pose) < 1e-7);
        }
    }
}
