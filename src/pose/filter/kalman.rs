//! A Kalman filter with constant velocity on SE(3), weighted by each measurement's own covariance.
//!
//! State: pose and velocities; errors [δp, δθ, δv, δω] in stage axes, with the record's perturbation R_true = Exp(δθ) R. Between frames the
//! velocities hold up to random accelerations (Bar-Shalom's discrete white noise acceleration). How large these are is adapted: a still
//! camera brings them down and the pose to rest; innovations that repeat their sign (Mehra 1970) bring them up, one great surprise at
//! once. Motion at constant velocity has no delay; a motion as slow as the measurement's own noise is noticed after about 0.2 s.

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
const STILL: f64 = 0.0003;
/// A normalised innovation so far beyond its mean of 1 is a motion that begins; by chance it comes once in two thousand frames.
const SURPRISE: f64 = 4.0;
/// Correlation of one innovation with the next at which nothing is changed: with 0, noise alone would keep the filter lively.
const WANTED: f64 = 0.05;
/// How quickly the correlation moves the liveliness.
const EAGERNESS: f64 = 5.0;
/// Time constant of the correlation's average, seconds.
const ADAPTS_IN_S: f64 = 0.2;
/// What a velocity may be when nothing is known of it, one sigma, m/s and rad/s.
const FIRST_VELOCITY: f64 = 0.5;

#[derive(Debug, Clone)]
pub(super) struct Kalman<From> {
    settings: KalmanSettings,
    pub motion: Motion<From>,
    covariance: Matrix12,
    /// Accelerations now, as a share of a moving camera's.
    liveliness: f64,
    /// The last innovation, in units of what was expected of it.
    last: Vector6<f64>,
    /// Means of its product with the one before, and of its square.
    products: [f64; 2],
}

impl<From> Kalman<From> {
    pub fn start(settings: KalmanSettings, pose: &Pose<Stage, From>, covariance: &Matrix6<f64>) -> Self {
        let mut first = Matrix12::identity() * FIRST_VELOCITY.powi(2);
        first.fixed_view_mut::<6, 6>(0, 0).copy_from(covariance);
        Self { settings, motion: Motion::at_rest(*pose), covariance: first, liveliness: STILL, last: Vector6::zeros(), products: [0.0; 2] }
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

    /// Sets the liveliness by how the innovations follow one another; `foreseen` lacks the accelerations.
    ///
    /// Mehra's test: innovations of a filter that follows well are uncorrelated, of one that lags they have the same sign again and
    /// again. That holds whatever the scale of the measurement's covariance, which may well be too cautious.
    fn adapt(&mut self, step_s: f64, innovation: &Vector6<f64>, foreseen: &Matrix6<f64>) {
        let spread = foreseen + upper(&self.accelerations(step_s));
        let Some(in_sigmas) = spread.cholesky().and_then(|c| c.l().solve_lower_triangular(innovation)) else { return };
        let last = std::mem::replace(&mut self.last, in_sigmas);
        if in_sigmas.norm_squared() / 6.0 > SURPRISE {
            (self.liveliness, self.products) = (1.0, [0.0; 2]);
            return;
        }
        let share = 1.0 - (-step_s / ADAPTS_IN_S).exp();
        let [product, square] = &mut self.products;
        *product += share * (in_sigmas.dot(&last) - *product);
        *square += share * (in_sigmas.norm_squared() - *square);
        let correlation = *product / square.max(1e-12);
        let by = EAGERNESS * share * (correlation - WANTED).clamp(-1.0, 1.0);
        self.liveliness = (self.liveliness * by.exp()).clamp(STILL, 1.0);
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
