//! Errors of poses against exact truth, as the demo and the bars report them.

use crate::geometry::Pose;

/// A pose is wrong if its position is off by more than this share of the distance. Chosen: errors
/// that would be visible on a stage. Raised, fewer poses count as wrong.
pub const WRONG_SHARE: f64 = 0.01;
/// A pose is wrong if its direction is off by more than this, degrees. Raised, fewer poses count as
/// wrong.
pub const WRONG_DEG: f64 = 0.3;

/// The error of one pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseError {
    /// Distance from the true position, metres.
    pub position_m: f64,
    /// The same as a share of the camera's distance from what it sees.
    pub share: f64,
    /// Angle to the true rotation, degrees.
    pub rotation_deg: f64,
}

impl PoseError {
    /// Compares a pose with the truth. `distance_m`: of the camera from what it sees: the stage's
    /// origin, or an object.
    pub fn between<To, From>(pose: &Pose<To, From>, truth: &Pose<To, From>, distance_m: f64) -> Self {
        let position_m = (pose.translation - truth.translation).norm();
        Self { position_m, share: position_m / distance_m.max(f64::MIN_POSITIVE), rotation_deg: pose.angle_to(truth).to_degrees() }
    }

    /// Whether the pose is wrong, as `evaluate.py --tight` of `../shared/bench` defines it.
    pub fn is_wrong(&self) -> bool {
        self.share > WRONG_SHARE || self.rotation_deg > WRONG_DEG
    }
}

/// Returns a percentile of sorted values, linearly interpolated; `None` if there are none.
pub fn percentile(sorted: &[f64], share: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let place = share * last as f64;
    let (below, rest) = (place as usize, place.fract());
    Some(sorted[below] + (sorted[(below + 1).min(last)] - sorted[below]) * rest)
}
