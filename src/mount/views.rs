//! The measurements: the poses of both cameras while the rig stood still, in one stage or in one
//! each.

use nalgebra::{Matrix6, UnitQuaternion, Vector3};

use crate::geometry::{Camera, Pose, Stage};

/// A measured pose of a camera: `T_stage_camera`, and the covariance of [δp, δθ] in stage axes with
/// p_true = p + δp and R_true = Exp(δθ) R, m and rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// The camera's pose.
    pub pose: Pose<Stage, Camera>,
    /// Its covariance.
    pub covariance: Matrix6<f64>,
}

/// The measurements of both cameras during one standstill of the rig.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewPair {
    /// The tracking camera.
    pub tracking: View,
    /// The filming camera, in its own stage.
    pub filming: View,
}

/// Whether both cameras measure in the same stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stages {
    /// One stage frame.
    Shared,
    /// A board for each camera; the relation of the boards is estimated too.
    Apart,
}

/// Returns the mean of poses that are close to each other.
pub(super) fn mean<To, From>(poses: &[Pose<To, From>]) -> Option<Pose<To, From>> {
    let (first, n) = (poses.first()?.rotation, poses.len() as f64);
    let shift = poses.iter().map(|pose| pose.translation).sum::<Vector3<f64>>() / n;
    let rotation = poses.iter().map(|pose| (pose.rotation * first.inverse()).scaled_axis()).sum::<Vector3<f64>>() / n;
    Some(Pose::new(UnitQuaternion::from_scaled_axis(rotation) * first, shift))
}
