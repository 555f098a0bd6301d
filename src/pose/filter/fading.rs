//! A Kalman filter with fading memory (Sorenson and Sacks, "Recursive fading memory filtering",
//! 1971).
//!
//! Model: constant acceleration without process noise. Instead, each measurement's weight decays
//! with its age, by exp(-age / memory). The estimate is thus the best-fitting parabola through the
//! weighted measurements, for any frame intervals and noise. From the information form S' = f F⁻ᵀ S
//! F⁻¹ + Hᵀ R⁻¹ H with f = exp(-dt / memory), errors propagate from frame to frame by (I - K H) F =
//! f S'⁻¹ F⁻ᵀ S; over many frames, by the product of all f times a matrix that does not grow with
//! their number. In steady state all three eigenvalues equal f: real and positive, so nothing can
//! ring or alternate, at any rate and noise.

use nalgebra::{Matrix3, Vector3};

use super::place::Place;

/// Prior of an unknown motion, one sigma each.
#[derive(Debug, Clone, Copy)]
pub(super) struct Unknown {
    /// Metres or radians per second.
    pub velocity: f64,
    /// Metres or radians per second squared.
    pub acceleration: f64,
}

/// Minimum weight decay factor per step, for memories far shorter than the frame interval. Lowered,
/// the last three measurements decide just as well, and rounding errors grow; raised, long frame
/// intervals lag.
const MIN_KEPT: f64 = 0.01;

#[derive(Debug, Clone)]
pub(super) struct Fading<P> {
    pub place: P,
    pub velocity: Vector3<f64>,
    pub acceleration: Vector3<f64>,
    /// Weighted information of the measurements on position, velocity and acceleration; the same
    /// for each axis.
    information: Matrix3<f64>,
    /// Covariance of the estimate due to measurement noise alone.
    noise: Matrix3<f64>,
}

impl<P: Place> Fading<P> {
    pub fn at_rest(place: P, variance: f64, unknown: &Unknown) -> Self {
        let noise = Matrix3::from_diagonal(&Vector3::new(variance, unknown.velocity.powi(2), unknown.acceleration.powi(2)));
        let information = Matrix3::from_diagonal(&noise.diagonal().map(f64::recip));
        Self { place, velocity: Vector3::zeros(), acceleration: Vector3::zeros(), information, noise }
    }

    /// Takes a measurement; returns the innovation in standard deviations of noise alone.
    pub fn update(&mut self, step_s: f64, memory_s: f64, measured: &P, variance: f64) -> Vector3<f64> {
        let kept = (-step_s / memory_s).exp().max(MIN_KEPT);
        let (on, back) = (carry(step_s), carry(-step_s));
        let expected = self.place.moved(self.velocity * step_s + self.acceleration * (step_s * step_s / 2.0));
        let innovation = measured.way_from(&expected);
        let mut information = back.transpose() * self.information * back * kept;
        information[(0, 0)] += variance.recip();
        let noise = on * self.noise * on.transpose();
        let in_sigmas = innovation / (noise[(0, 0)] + variance).sqrt();
        // Not invertible only if the numbers overflow: then start again from this measurement.
        let Some(inverse) = information.cholesky().map(|c| c.inverse()) else {
            *self = Self::at_rest(*measured, variance, &Unknown { velocity: 1.0, acceleration: 1.0 });
            return in_sigmas;
        };
        let gain: Vector3<f64> = inverse.column(0) / variance;
        self.place = expected.moved(innovation * gain.x);
        self.velocity += self.acceleration * step_s + innovation * gain.y;
        self.acceleration += innovation * gain.z;
        self.information = (information + information.transpose()) * 0.5;
        let mut left = Matrix3::identity();
        left.set_column(0, &(Vector3::x() - gain));
        self.noise = left * noise * left.transpose() + gain * gain.transpose() * variance;
        in_sigmas
    }
}

/// Transition matrix of position, velocity and acceleration of one axis over some seconds.
fn carry(seconds: f64) -> Matrix3<f64> {
    Matrix3::new(1.0, seconds, seconds * seconds / 2.0, 0.0, 1.0, seconds, 0.0, 0.0, 1.0)
}

#[cfg(test)]
#[path = "fading_tests.rs"]
mod tests;
