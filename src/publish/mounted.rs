//! The filming camera: a camera bolted to the tracking camera or to a tracked object.
//!
//! The tracker reports its own camera's pose, but a renderer needs the pose of the camera whose
//! picture it draws on. If both are on one rig, the filming camera's pose is the carrier's times a
//! fixed one. Its covariance is the carrier's, propagated over that lever arm: an error of one
//! degree in the carrier moves a camera half a metre away by 9 mm.

use std::time::Duration;

use nalgebra::{Matrix3, Matrix6};

use super::report::BodyChoice;
use crate::camera::CameraModel;
use crate::geometry::{Body, Pose, Stage, skew};

/// Settings of `[mount]`.
#[derive(Debug, Clone, PartialEq)]
pub struct MountSettings {
    /// The name by which outputs refer to it.
    pub name: String,
    /// Its pose on the carrier.
    pub mount: Mount,
    /// Its lens, if calibrated.
    pub camera: Option<CameraModel>,
    /// Delay of the outputs that include it: they send the poses of this long ago.
    pub delay: Duration,
}

/// The filming camera's pose on its carrier.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mount {
    /// The tracking camera, or an object.
    pub carrier: BodyChoice,
    /// `T_carrier_filming`, both as bodies: x right, y forward, z up.
    pub pose: Pose<Body, Body>,
    /// Covariance of that pose: of [δp, δθ] in the carrier's axes, as in the record; zero if not
    /// stated.
    pub covariance: Matrix6<f64>,
}

impl Mount {
    /// Returns `T_stage_filming`, given the carrier's pose.
    pub fn carried(&self, carrier: &Pose<Stage, Body>) -> Pose<Stage, Body> {
        *carrier * self.pose
    }

    /// Returns the covariance of the filming camera's pose, given the carrier's; both of [δp, δθ]
    /// in stage axes.
    ///
    /// With p = p_c + R_c o and R = R_c R_m: δp = δp_c + δθ_c x R_c o + R_c δo, δθ = δθ_c + R_c δφ.
    pub fn carried_covariance(&self, carrier: &Pose<Stage, Body>, covariance: &Matrix6<f64>) -> Matrix6<f64> {
        let rotation = carrier.rotation_matrix();
        let mut by_carrier = Matrix6::identity();
        by_carrier.fixed_view_mut::<3, 3>(0, 3).copy_from(&-skew(&(rotation * self.pose.translation)));
        let by_mount = twice(&rotation);
        let sum = by_carrier * covariance * by_carrier.transpose() + by_mount * self.covariance * by_mount.transpose();
        // Keep it exactly symmetric despite rounding.
        (sum + sum.transpose()) * 0.5
    }
}

/// Returns the block-diagonal matrix that rotates both shift and rotation.
fn twice(rotation: &Matrix3<f64>) -> Matrix6<f64> {
    let mut both = Matrix6::zeros();
    both.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation);
    both.fixed_view_mut::<3, 3>(3, 3).copy_from(rotation);
    both
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3, Vector6};

    use super::*;

    fn stepped<A, B>(pose: &Pose<A, B>, step: &Vector6<f64>) -> Pose<A, B> {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(step[3], step[4], step[5]));
        Pose::new(rotation * pose.rotation, pose.translation + Vector3::new(step[0], step[1], step[2]))
    }

    #[test]
    fn the_mounted_covariance_agrees_with_differences() {
        let carrier = Pose::<Stage, Body>::new(UnitQuaternion::from_euler_angles(0.2, -0.3, 1.1), Vector3::new(0.5, -4.0, 1.6));
        let pose = Pose::new(UnitQuaternion::from_euler_angles(0.1, 0.2, -0.4), Vector3::new(0.3, -0.1, 0.25));
        let mount = Mount { carrier: BodyChoice::Camera, pose, covariance: Matrix6::identity() };
        let covariance = mount.carried_covariance(&carrier, &Matrix6::identity());
        let base = mount.carried(&carrier);
        let mut sum = Matrix6::zeros();
        for k in 0..6 {
            let mut step = Vector6::zeros();
            step[k] = 1e-6;
            let by_carrier = mount.carried(&stepped(&carrier, &step));
            let by_mount = Mount { pose: stepped(&pose, &step), ..mount }.carried(&carrier);
            for moved in [by_carrier, by_mount] {
                let (p, r) = (moved.translation - base.translation, (moved.rotation * base.rotation.inverse()).scaled_axis());
                let d = Vector6::new(p.x, p.y, p.z, r.x, r.y, r.z) / 1e-6;
                sum += d * d.transpose();
            }
        }
        assert!((covariance - sum).norm() < 1e-4, "{covariance} {sum}");
    }

    #[test]
    fn a_camera_above_and_ahead_is_above_and_ahead() {
        // The rig pans a quarter turn to the left: forward is then -x.
        let carrier = Pose::<Stage, Body>::new(UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::FRAC_PI_2), Vector3::zeros());
        let pose = Pose::new(UnitQuaternion::identity(), Vector3::new(0.0, 0.2, 0.1));
        let mount = Mount { carrier: BodyChoice::Camera, pose, covariance: Matrix6::zeros() };
        assert!((mount.carried(&carrier).translation - Vector3::new(-0.2, 0.0, 0.1)).norm() < 1e-12);
    }
}
