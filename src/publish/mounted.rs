//! The filming camera: what is bolted to the tracking camera, or to a tracked object, and moves with it.
//!
//! The tracker tells where its own camera is, a renderer wants the one whose picture it draws on. Where the two sit on one rig, the
//! filming camera's pose is the carrier's times a fixed one, and its covariance the carrier's at the end of that arm: a degree that the
//! carrier is off swings a camera half a metre away by 9 mm.

use std::time::Duration;

use nalgebra::{Matrix3, Matrix6};

use super::report::BodyChoice;
use crate::camera::CameraModel;
use crate::geometry::{Body, Pose, Stage, skew};

/// `[mount]`
#[derive(Debug, Clone, PartialEq)]
pub struct MountSettings {
    /// The name by which outputs speak of it.
    pub name: String,
    /// Where it sits.
    pub mount: Mount,
    /// Its lens, where a calibration tells it.
    pub camera: Option<CameraModel>,
    /// Outputs that speak of it tell the poses of this long ago.
    pub delay: Duration,
}

/// Where the filming camera sits on its carrier.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mount {
    /// The tracking camera, or an object.
    pub carrier: BodyChoice,
    /// `T_carrier_filming`, both as bodies: x right, y forward, z up.
    pub pose: Pose<Body, Body>,
    /// How well that is known: covariance of [δp, δθ] in the carrier's axes, as the record has it; zero where nobody says.
    pub covariance: Matrix6<f64>,
}

impl Mount {
    /// `T_stage_filming`, from the carrier's.
    pub fn carried(&self, carrier: &Pose<Stage, Body>) -> Pose<Stage, Body> {
        *carrier * self.pose
    }

    /// The covariance of the filming camera's pose, from the carrier's; both of [δp, δθ] in stage axes.
    ///
    /// With p = p_c + R_c o and R = R_c R_m: δp = δp_c + δθ_c x R_c o + R_c δo, δθ = δθ_c + R_c δφ.
    pub fn carried_covariance(&self, carrier: &Pose<Stage, Body>, covariance: &Matrix6<f64>) -> Matrix6<f64> {
        let turn = carrier.rotation_matrix();
        let mut by_carrier = Matrix6::identity();
        by_carrier.fixed_view_mut::<3, 3>(0, 3).copy_from(&-skew(&(turn * self.pose.translation)));
        let by_mount = twice(&turn);
        let sum = by_carrier * covariance * by_carrier.transpose() + by_mount * self.covariance * by_mount.transpose();
        // Rounding must not leave a matrix that is not its own transpose.
        (sum + sum.transpose()) * 0.5
    }
}

/// The same turn of shift and rotation.
fn twice(turn: &Matrix3<f64>) -> Matrix6<f64> {
    let mut both = Matrix6::zeros();
    both.fixed_view_mut::<3, 3>(0, 0).copy_from(turn);
    both.fixed_view_mut::<3, 3>(3, 3).copy_from(turn);
    both
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3, Vector6};

    use super::*;

    fn stepped<A, B>(pose: &Pose<A, B>, step: &Vector6<f64>) -> Pose<A, B> {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[3], step[4], step[5]));
        Pose::new(turn * pose.rotation, pose.translation + Vector3::new(step[0], step[1], step[2]))
    }

    #[test]
    fn the_covariance_is_that_of_differences() {
        let carrier = Pose::<Stage, Body>::new(UnitQuaternion::from_euler_angles(0.2, -0.3, 1.1), Vector3::new(0.5, -4.0, 1.6));
        let pose = Pose::new(UnitQuaternion::from_euler_angles(0.1, 0.2, -0.4), Vector3::new(0.3, -0.1, 0.25));
        let mount = Mount { carrier: BodyChoice::Camera, pose, covariance: Matrix6::identity() };
        let told = mount.carried_covariance(&carrier, &Matrix6::identity());
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
        assert!((told - sum).norm() < 1e-4, "{told} {sum}");
    }

    #[test]
    fn a_camera_above_and_ahead_is_above_and_ahead() {
        // The rig pans to the left by a quarter: ahead is then towards -x.
        let carrier = Pose::<Stage, Body>::new(UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::FRAC_PI_2), Vector3::zeros());
        let pose = Pose::new(UnitQuaternion::identity(), Vector3::new(0.0, 0.2, 0.1));
        let mount = Mount { carrier: BodyChoice::Camera, pose, covariance: Matrix6::zeros() };
        assert!((mount.carried(&carrier).translation - Vector3::new(-0.2, 0.0, 0.1)).norm() < 1e-12);
    }
}
