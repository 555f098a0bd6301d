//! Prior of an object's motion in the camera before it was seen to move.
//!
//! The camera's own motion is known once the stage is found. The rest is the object's: it
//! translates, and rotates about itself, not about the camera. So a body that moves through the
//! picture is first assumed to translate with constant tilt, where a prior for the camera alone
//! would assume that the camera rotates.

use nalgebra::{Matrix3, Matrix6};

use super::estimate::{MotionEstimate, UNSEEN_DISTANCE_M};
use super::state::Motion;
use crate::geometry::{Body, Camera, Pose, skew};

/// Prior of an object's own motion in the stage, one sigma: speed in m/s at `UNSEEN_DISTANCE_M`,
/// angular velocity in rad/s, and both accelerations in m/s² at that distance and rad/s². Chosen:
/// at this speed an object crosses the picture as fast as if the camera rotated at 1 rad/s. Raised,
/// first poses are less certain; lowered, fast objects are lost in the second frame.
const OWN: [f64; 4] = [4.0, 1.0, 10.0, 30.0];

impl MotionEstimate {
    /// Creates the estimate for an object whose motion is unobserved. `camera`: the camera's motion
    /// in the stage. `shift` and `rotation`: one sigma of the pose, metres and radians.
    pub fn unseen_object(pose: Pose<Body, Camera>, distance_m: f64, [shift, rotation]: [f64; 2], camera: &Self) -> Self {
        let mut found = Self::unseen(pose, distance_m, shift, rotation);
        let object_stage = pose.rotation * camera.motion.pose.rotation.inverse();
        found.motion =
            Motion { velocity: object_stage * camera.motion.velocity, angular_velocity: camera.motion.angular_velocity, ..found.motion };
        let mut rotated = Matrix6::identity();
        rotated.fixed_view_mut::<3, 3>(0, 0).copy_from(object_stage.to_rotation_matrix().matrix());
        // An object's velocity moves the camera the opposite way in the object's axes; when the
        // object rotates, the camera circles around it.
        let mut by_own = -Matrix6::identity();
        by_own.fixed_view_mut::<3, 3>(0, 3).copy_from(&skew(&pose.translation));
        by_own.fixed_view_mut::<3, 3>(3, 3).copy_from(&-pose.rotation_matrix().transpose());
        let d = distance_m / UNSEEN_DISTANCE_M;
        for (first, speed, rate) in [(6, OWN[0] * d, OWN[1]), (12, OWN[2] * d, OWN[3])] {
            let mut own = Matrix6::zeros();
            own.fixed_view_mut::<3, 3>(0, 0).copy_from(&(Matrix3::identity() * (speed * speed)));
            own.fixed_view_mut::<3, 3>(3, 3).copy_from(&(Matrix3::identity() * (rate * rate)));
            let of_camera = camera.covariance.fixed_view::<6, 6>(first, first);
            let block = rotated * of_camera * rotated.transpose() + by_own * own * by_own.transpose();
            found.covariance.fixed_view_mut::<6, 6>(first, first).copy_from(&((block + block.transpose()) * 0.5));
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::super::state::MotionMatrix;
    use super::super::state::tests::moving;
    use super::*;
    use crate::geometry::Stage;

    /// The object's pose in the stage.
    fn object_in_stage() -> Pose<Stage, Body> {
        Pose::new(UnitQuaternion::from_euler_angles(0.3, -0.5, 0.2), Vector3::new(0.7, -1.1, 0.4))
    }

    /// The camera's motion in the stage, known almost exactly.
    fn camera() -> MotionEstimate {
        MotionEstimate { motion: moving(), covariance: MotionMatrix::identity() * 1e-12 }
    }

    /// The camera's pose in an object that moved by this within `dt_s`: shift in the stage,
    /// rotation about itself in its own axes.
    fn camera_in_object(dt_s: f64, shift_m: Vector3<f64>, rotation_rad: Vector3<f64>) -> Pose<Body, Camera> {
        let object = object_in_stage().moved(&shift_m, &rotation_rad);
        let camera = camera().motion.after(dt_s).pose;
        let rotation = object.rotation.inverse() * camera.rotation;
        Pose::new(rotation, object.rotation.inverse() * (camera.translation - object.translation))
    }

    #[test]
    fn an_object_at_rest_has_the_cameras_relative_motion() {
        let still = |dt_s: f64| camera_in_object(dt_s, Vector3::zeros(), Vector3::zeros());
        let found = MotionEstimate::unseen_object(still(0.0), 4.0, [0.01, 0.003], &camera()).motion;
        let dt_s = 1e-6;
        let [way, rotation] = still(-dt_s).step_to(&still(dt_s)).map(|step| step / (2.0 * dt_s));
        assert!(
            (found.velocity - way).norm() < 1e-5 && (found.angular_velocity - rotation).norm() < 1e-5,
            "{} {way} {} {rotation}",
            found.velocity,
            found.angular_velocity
        );
    }

    #[test]
    fn the_prior_covers_the_objects_own_motion_only() {
        let start = camera_in_object(0.0, Vector3::zeros(), Vector3::zeros());
        let found = MotionEstimate::unseen_object(start, UNSEEN_DISTANCE_M, [0.01, 0.003], &camera());
        // Its own motion along each axis, by finite differences.
        let small = 1e-6;
        let mut should = Matrix6::zeros();
        for k in 0..6 {
            let along = Vector3::ith(k % 3, if k < 3 { OWN[0] } else { OWN[1] } * small);
            let zero = Vector3::zeros();
            let [shift, rotation] =
                start.step_to(&if k < 3 { camera_in_object(0.0, along, zero) } else { camera_in_object(0.0, zero, along) });
            let column = nalgebra::Vector6::from_fn(|row, _| if row < 3 { shift[row] } else { rotation[row - 3] } / small);
            should += column * column.transpose();
        }
        let is = found.covariance.fixed_view::<6, 6>(6, 6);
        assert!((is - should).norm() < 1e-4 * should.norm(), "{is} {should}");
        assert!(found.covariance.cholesky().is_some());
    }
}
