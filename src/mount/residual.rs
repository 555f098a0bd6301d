//! The residual of a mount for a pair of views.
//!
//! Given the tracking camera's pose A, the mount X and the stages' relation Y predict the filming
//! camera's pose Y⁻¹ A X; the measured one is B. The residual is the difference of B from the
//! prediction, [δp, δθ] in the axes of B's stage. Both measurements' covariances are propagated to
//! it.

use nalgebra::{Matrix6, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};

use super::views::ViewPair;
use crate::geometry::{Camera, FilmingCamera, Pose, Stage, skew};

type Jacobian = SMatrix<f64, 6, 12>;

/// The unknowns: the mount, and the pose of the filming camera's stage in the tracking camera's.
#[derive(Debug, Clone, Copy)]
pub(super) struct Unknowns {
    pub mount: Pose<Camera, FilmingCamera>,
    pub between: Pose<Stage, Stage>,
}

impl Unknowns {
    pub(super) fn step(&mut self, step: &SVector<f64, 12>) {
        self.mount = moved(&self.mount, step.fixed_rows::<6>(0).into_owned());
        self.between = moved(&self.between, step.fixed_rows::<6>(6).into_owned());
    }

    /// Returns the predicted pose of the filming camera in its own stage.
    fn predicted(&self, pair: &ViewPair) -> Pose<Stage, FilmingCamera> {
        self.between.inverse() * pair.tracking.pose * self.mount
    }

    /// Returns measured minus predicted, and the derivative of the prediction by [δt, δφ] of the
    /// mount and of the stages' relation.
    pub(super) fn residual(&self, pair: &ViewPair) -> (Vector6<f64>, Jacobian) {
        let predicted = self.predicted(pair);
        let shift = pair.filming.pose.translation - predicted.translation;
        let rotation = (pair.filming.pose.rotation * predicted.rotation.inverse()).scaled_axis();
        let back = self.between.rotation_matrix().transpose();
        let forth = back * pair.tracking.pose.rotation_matrix();
        let arm = self.between.rotation_matrix() * predicted.translation;
        let mut jacobian = Jacobian::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&forth);
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&forth);
        jacobian.fixed_view_mut::<3, 3>(0, 6).copy_from(&-back);
        jacobian.fixed_view_mut::<3, 3>(0, 9).copy_from(&(back * skew(&arm)));
        jacobian.fixed_view_mut::<3, 3>(3, 9).copy_from(&-back);
        (Vector6::new(shift.x, shift.y, shift.z, rotation.x, rotation.y, rotation.z), jacobian)
    }

    /// Returns the covariance of a pair's residual: the filming camera's own, and the tracking
    /// camera's at the end of the mount's lever arm.
    pub(super) fn covariance(&self, pair: &ViewPair) -> Matrix6<f64> {
        let back = self.between.rotation_matrix().transpose();
        let arm = pair.tracking.pose.rotation * self.mount.translation;
        let mut by = Matrix6::zeros();
        by.fixed_view_mut::<3, 3>(0, 0).copy_from(&back);
        by.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-back * skew(&arm)));
        by.fixed_view_mut::<3, 3>(3, 3).copy_from(&back);
        by * pair.tracking.covariance * by.transpose() + pair.filming.covariance
    }

    /// Returns the squared Mahalanobis distance of every pair; `None` if a covariance is not
    /// positive definite.
    pub(super) fn distances(&self, pairs: &[ViewPair]) -> Option<Vec<f64>> {
        let distance = |pair: &ViewPair| {
            let (residual, _) = self.residual(pair);
            let information = self.covariance(pair).cholesky()?;
            Some(residual.dot(&information.solve(&residual)))
        };
        pairs.iter().map(distance).collect()
    }
}

impl ViewPair {
    /// Returns the covariance of the mount from this pair alone, given the stages' relation: of
    /// [δt, δφ] in the tracking camera's axes.
    pub fn mount_covariance(&self, mount: &Pose<Camera, FilmingCamera>, between: &Pose<Stage, Stage>) -> Matrix6<f64> {
        let back = self.tracking.pose.rotation_matrix().transpose() * between.rotation_matrix();
        let mut both = Matrix6::zeros();
        both.fixed_view_mut::<3, 3>(0, 0).copy_from(&back);
        both.fixed_view_mut::<3, 3>(3, 3).copy_from(&back);
        both * Unknowns { mount: *mount, between: *between }.covariance(self) * both.transpose()
    }
}

/// Applies [δt, δφ], in the axes of the target frame, to a pose.
fn moved<To, From>(pose: &Pose<To, From>, step: Vector6<f64>) -> Pose<To, From> {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(step[3], step[4], step[5]));
    Pose::new(rotation * pose.rotation, pose.translation + Vector3::new(step[0], step[1], step[2]))
}
