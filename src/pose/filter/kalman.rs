//! Kalman filters with fading memory, one for the position and one for the rotation.
//!
//! Uniform motion and constant acceleration cause no delay. The memory's length adapts to the
//! measurements: a still camera is smoothed, a motion that contradicts the long memories is
//! followed at once by the short ones, and a jump restarts the filter at rest. So a kick, an end
//! stop or a cut never counts as a velocity. Nothing can ring: see `fading`.

use nalgebra::{Matrix6, UnitQuaternion, Vector3};

use super::follower::Follower;
use crate::frame::Timestamp;
use crate::geometry::{Pose, Stage};
use crate::motion::Motion;

/// Settings of the Kalman filter.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct KalmanSettings {
    /// Accelerations while moving, one sigma, m/s².
    pub acceleration_m_s2: f64,
    /// Angular accelerations while moving, one sigma, rad/s².
    pub angular_acceleration_rad_s2: f64,
}

impl Default for KalmanSettings {
    fn default() -> Self {
        Self { acceleration_m_s2: 30.0, angular_acceleration_rad_s2: 60.0 }
    }
}

#[derive(Debug, Clone)]
pub(super) struct Kalman {
    position: Follower<Vector3<f64>>,
    rotation: Follower<UnitQuaternion<f64>>,
}

impl Kalman {
    pub fn start<From>(settings: KalmanSettings, ahead_s: f64, pose: &Pose<Stage, From>, covariance: &Matrix6<f64>) -> Self {
        let [position, rotation] = variances(covariance);
        Self {
            position: Follower::start(settings.acceleration_m_s2, ahead_s, pose.translation, position),
            rotation: Follower::start(settings.angular_acceleration_rad_s2, ahead_s, pose.rotation, rotation),
        }
    }

    pub fn update<From>(&mut self, timestamp: Timestamp, step_s: f64, measured: &Pose<Stage, From>, covariance: &Matrix6<f64>) {
        let [position, rotation] = variances(covariance);
        self.position.update(timestamp, step_s, &measured.translation, position);
        self.rotation.update(timestamp, step_s, &measured.rotation, rotation);
    }

    pub fn motion<From>(&self) -> Motion<Stage, From> {
        let (position, rotation) = (self.position.estimate(), self.rotation.estimate());
        // The rotation is followed in stage axes.
        let to_own_axes = rotation.place.inverse();
        Motion {
            pose: Pose::new(rotation.place, position.place),
            velocity: position.velocity,
            angular_velocity: to_own_axes * rotation.velocity,
            acceleration: position.acceleration,
            angular_acceleration: to_own_axes * rotation.acceleration,
        }
    }
}

/// Returns the mean variance per axis of position and of rotation. Which axis is worst changes
/// little from frame to frame, and only changes affect the weights.
fn variances(covariance: &Matrix6<f64>) -> [f64; 2] {
    [0, 3].map(|at| covariance.fixed_view::<3, 3>(at, at).trace() / 3.0)
}
