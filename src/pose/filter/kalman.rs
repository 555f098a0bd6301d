//! A Kalman filter with constant velocity on SE(3), weighted by each measurement's own covariance.
//!
//! State: pose and velocities; errors [δp, δθ, δv, δω] in stage axes, with the record's perturbation R_true = Exp(δθ) R. Between frames the
//! velocities hold up to random accelerations (Bar-Shalom's discrete white noise acceleration). How large these are is adapted: the
//! normalised innovation squared says whether the motion surprises the filter. A still camera brings the noise down and the pose to
//! rest; one surprise brings it up at once. Motion at constant velocity has no delay; at rest it takes about a fifth of a second to notice
//! a motion as slow as the measurement's own noise.

use nalgebra::{Matrix6, SMatrix, SVector, UnitQuaternion, Vector6};

use super::Motion;
use crate::geometry::{Pose, Stage};

/// How a Kalman filter is set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KalmanSettings {
    /// Accelerations while moving, one sigma.
    pub acceleration_m_s2: f64,
    /// Angular accelerations while moving, one sigma.
    pub turn_acceleration_rad_s2: f64,
}

impl Default for KalmanSettings {
    fn default() -> Self {
        Self { acceleration_m_s2: 30.0, turn_acceleration_rad_s2: 60.0 }
    }
}

type Matrix12 = SMatrix<f64, 12, 12>;
type Vector12 = SVector<f64, 12>;

/// A still camera's accelerations, as a share of a moving one's.
const STILL: f64 = 0.003;
/// An innovation so far beyond what was expected is a motion that begins: its mean is 1, and 4 comes by chance once in two thousand.
const SURPRISE: f64 = 4.0;
/// The adapted noise keeps the mean innovation here: below 1, so that it follows rather too quickly than too slowly.
const WANTED: f64 = 0.4;
/// Time constant of the adaptation, seconds.
const ADAPTS_IN_S: f64 = 0.3;
/// What a velocity may be when nothing is known of it, one sigma, m/s and rad/s.
const FIRST_VELOCITY: f64 = 0.5;

#[derive(Debug, Clone)]
pub(super) struct Kalman<From> {
    settings: KalmanSettings,
    pub motion: Motion<From>,
    covariance: Matrix12,
    /// Accelerations now, as a share of a moving camera's.
    liveliness: f64,
    /// Mean of the normalised innovation squared per degree of freedom.
    surprise: f64,
}

impl<From> Kalman<From> {
    pub fn start(settings: KalmanSettings, pose: &Pose<Stage, From>, covariance: &Matrix6<f64>) -> Self {
        let mut first = Matrix12::identity() * FIRST_VELOCITY.powi(2);
        first.fixed_view_mut::<6, 6>(0, 0).copy_from(covariance);
        Self { settings, motion: Motion::at_rest(*pose), covariance: first, liveliness: STILL, surprise: WANTED }
    }

    pub fn update(&mut self, step_s: f64, measured: &Pose<Stage, From>, noise: &Matrix6<f64>) {
        let expected = self.motion.after(step_s);
        let turn = (measured.rotation * expected.rotation.inverse()).scaled_axis();
        let way = measured.translation - expected.translation;
        let innovation = Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z);
        let mut carry = Matrix12::identity();
        carry.fixed_view_mut::<6, 6>(0, 6).copy_from(&(Matrix6::identity() * step_s));
        let carried = carry * self.covariance * carry.transpose();
        self.adapt(step_s, &innovation, &(upper(&carried) + noise));
        let predicted = carried + self.accelerations(step_s);
        // Not invertible only for numbers that are no covariance: then the measurement is taken as it is.
        let Some(inverse) = (upper(&predicted) + noise).cholesky().map(|c| c.inverse()) else {
            *self = Self::start(self.settings, measured, noise);
            return;
        };
        let gain = predicted.fixed_columns::<6>(0) * inverse;
        let step: Vector12 = gain * innovation;
        let corrected = predicted - gain * predicted.fixed_rows::<6>(0);
        self.covariance = (corrected + corrected.transpose()) * 0.5;
        self.take(&expected, &step);
    }

    /// Moves to the expected pose plus a step of the errors.
    fn take(&mut self, expected: &Pose<Stage, From>, step: &Vector12) {
        let part = |at: usize| step.fixed_rows::<3>(at).into_owned();
        let mut rotation = UnitQuaternion::from_scaled_axis(part(3)) * expected.rotation;
        rotation.renormalize();
        self.motion.pose = Pose::new(rotation, expected.translation + part(0));
        self.motion.velocity += part(6);
        self.motion.turn_rate += part(9);
    }

    /// Sets the liveliness by how well the innovation was foreseen; `foreseen` lacks the accelerations.
    fn adapt(&mut self, step_s: f64, innovation: &Vector6<f64>, foreseen: &Matrix6<f64>) {
        let spread = foreseen + upper(&self.accelerations(step_s));
        let Some(spread) = spread.cholesky() else { return };
        let found = innovation.dot(&spread.solve(innovation)) / 6.0;
        if found > SURPRISE {
            (self.liveliness, self.surprise) = (1.0, 1.0);
            return;
        }
        let share = 1.0 - (-step_s / ADAPTS_IN_S).exp();
        self.surprise += share * (found - self.surprise);
        let by = (self.surprise.max(1e-3) / WANTED).ln().clamp(-1.0, 1.0);
        self.liveliness = (self.liveliness * (share * by).exp()).clamp(STILL, 1.0);
    }

    /// What random accelerations add within a step.
    fn accelerations(&self, step_s: f64) -> Matrix12 {
        let mut added = Matrix12::zeros();
        for axis in 0..6 {
            let sigma = if axis < 3 { self.settings.acceleration_m_s2 } else { self.settings.turn_acceleration_rad_s2 };
            let variance = (self.liveliness * sigma).powi(2);
            added[(axis, axis)] = variance * step_s.powi(4) / 4.0;
            added[(axis, axis + 6)] = variance * step_s.powi(3) / 2.0;
            added[(axis + 6, axis)] = added[(axis, axis + 6)];
            added[(axis + 6, axis + 6)] = variance * step_s.powi(2);
        }
        added
    }
}

/// The part of the pose.
fn upper(m: &Matrix12) -> Matrix6<f64> {
    m.fixed_view::<6, 6>(0, 0).into_owned()
}
