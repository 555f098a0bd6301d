//! A camera that stands still at a configured pose, and the watch on whether it still does.
//!
//! The configured pose is taken as measured in every frame, so that objects are tracked with no
//! stage surface in view. Wherever the stage itself is seen, its pose must agree within the doubt
//! of both; a camera that was bumped is withheld until it stands as configured again, or the config
//! is changed.

use nalgebra::{Matrix6, Vector6};

use super::measured::Measured;
use crate::geometry::{Camera, Pose, Stage};

/// Squared distance between the configured and the seen pose, in sigmas, beyond which a frame says
/// that the camera was moved: chance reaches it once in 10 million frames (chi-square, 6 degrees of
/// freedom). Raised, smaller bumps go unnoticed; lowered, a camera that stands still is withheld.
const MAX_SQUARED_SIGMAS: f64 = 43.7;
/// Frames in a row that must say so, and that must agree before the pose is given again. Chosen:
/// one wrong look withholds nothing. Raised, a bump is noticed later.
const LOOKS: u32 = 3;

/// A camera's configured pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FixedCamera {
    /// `T_stage_camera`.
    pub pose: Pose<Stage, Camera>,
    /// Covariance of [δp, δθ] in stage axes, m and rad; positive definite. The error is the same in
    /// all frames.
    pub covariance: Matrix6<f64>,
}

impl FixedCamera {
    /// Returns the pose as a measurement without noise of its own.
    pub(super) fn measured(&self) -> Measured<Camera> {
        Measured { pose: self.pose, noise: Matrix6::zeros(), by_model: Some(self.covariance) }
    }

    /// Returns the squared distance of a seen pose, in sigmas of both; `None` if the covariances
    /// have no inverse.
    fn squared_sigmas(&self, seen: &Measured<Camera>) -> Option<f64> {
        let shift = seen.pose.translation - self.pose.translation;
        let rotation = (seen.pose.rotation * self.pose.rotation.inverse()).scaled_axis();
        let apart = Vector6::new(shift.x, shift.y, shift.z, rotation.x, rotation.y, rotation.z);
        let sum = (self.covariance + seen.covariance()).cholesky()?;
        Some(apart.dot(&sum.solve(&apart)))
    }
}

/// Compares what is seen of the stage with where the camera should be.
#[derive(Debug, Clone)]
pub(super) struct FixedWatch {
    camera: FixedCamera,
    /// Looks in a row that contradict what is held.
    contradictions: u32,
    is_moved: bool,
}

impl FixedWatch {
    pub fn new(camera: FixedCamera) -> Self {
        Self { camera, contradictions: 0, is_moved: false }
    }

    /// Takes a frame, with the stage's pose if it is seen; returns the camera's measurement, or
    /// `None` while the camera counts as moved. A frame that does not show the stage changes
    /// nothing.
    pub fn look(&mut self, seen: Option<&Measured<Camera>>) -> Option<Measured<Camera>> {
        if let Some(sigmas) = seen.and_then(|seen| self.camera.squared_sigmas(seen)) {
            let contradicts = (sigmas > MAX_SQUARED_SIGMAS) != self.is_moved;
            self.contradictions = if contradicts { self.contradictions + 1 } else { 0 };
            if self.contradictions >= LOOKS {
                (self.is_moved, self.contradictions) = (!self.is_moved, 0);
            }
        }
        (!self.is_moved).then(|| self.camera.measured())
    }

    /// Whether the camera counts as moved.
    pub fn is_moved(&self) -> bool {
        self.is_moved
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    fn camera() -> FixedCamera {
        FixedCamera { pose: Pose::new(UnitQuaternion::identity(), Vector3::new(0.0, -4.0, 1.6)), covariance: Matrix6::identity() * 1e-6 }
    }

    /// The stage seen from `x` further to the right, with a doubt of 1 mm and 1 mrad.
    fn seen(x: f64) -> Measured<Camera> {
        let pose = Pose::new(UnitQuaternion::identity(), Vector3::new(x, -4.0, 1.6));
        Measured { pose, noise: Matrix6::identity() * 1e-6, by_model: None }
    }

    #[test]
    fn a_camera_that_stands_still_is_given_whether_the_stage_is_seen_or_not() {
        let mut watch = FixedWatch::new(camera());
        for k in 0..1000 {
            // As far as both doubts go: 2.8 sigmas.
            let scatter = [Some(0.004), None, Some(-0.004)][k % 3];
            let measured = watch.look(scatter.map(seen).as_ref()).unwrap();
            assert_eq!(
                (measured.pose, measured.covariance(), measured.common()),
                (camera().pose, camera().covariance, camera().covariance)
            );
        }
    }

    #[test]
    fn a_bumped_camera_is_withheld_until_it_stands_as_configured_again() {
        let mut watch = FixedWatch::new(camera());
        // One wrong look says nothing, nor do looks with a right one between them.
        for x in [0.02, 0.0, 0.02, 0.02, 0.0] {
            assert!(watch.look(Some(&seen(x))).is_some());
        }
        let given: Vec<bool> = (0..4).map(|_| watch.look(Some(&seen(0.02))).is_some()).collect();
        assert_eq!(given, [true, true, false, false]);
        // Not seeing the stage is no reason to trust it again.
        assert!(watch.look(None).is_none() && watch.is_moved());
        let given: Vec<bool> = (0..4).map(|_| watch.look(Some(&seen(0.001))).is_some()).collect();
        assert_eq!(given, [false, false, true, true]);
    }
}
