//! A motion and its uncertainty, propagated from frame to frame with white-noise jerk.
//!
//! It initialises alignment and describes how the camera moved during a frame's readout and
//! exposure. It is solved jointly with the picture: velocity and acceleration are the filter's,
//! corrected by what the rows show.

use nalgebra::Matrix3;

use super::process_noise::{Innovation, ProcessNoise};
use super::state::{Motion, MotionError, MotionMatrix};
use crate::geometry::{Body, Camera, Pose};

/// Prior of an unobserved motion, one sigma: m/s at `UNSEEN_DISTANCE_M`, rad/s, m/s² at that
/// distance, rad/s². A hand-held camera moves about this much. Lowered, a single rolling-shutter
/// frame claims to know more than it shows; raised, first poses of such cameras are less certain.
const UNSEEN: [f64; 4] = [0.8, 1.0, 10.0, 30.0];
pub(super) const UNSEEN_DISTANCE_M: f64 = 4.0;
/// Tilt error caused by a stretched picture, as a multiple of the stretch angle over the frame.
/// Assumed, somewhat above 1. Raised, a pose found from features constrains alignment less;
/// lowered, it pulls alignment while the camera moves.
const STRETCH_TO_TILT: f64 = 1.5;
/// How long a velocity is remembered, seconds; beyond that it fades over `FADES_IN_S` into the
/// prior of an unobserved motion. Chosen: cameras at 20 frames per second or faster fade nothing.
/// Raised, slow cameras are predicted along outdated velocities; lowered, their motion is as
/// uncertain as a new one's.
const REMEMBERED_S: f64 = 0.05;
const FADES_IN_S: f64 = 0.1;

/// Minimum fraction of a predicted variance that a frame must remove for its innovation to count.
/// Chosen. Raised, bodies that show little are not learnt from; lowered to 0, values that are small
/// due to rounding or the picture's curvature count as motion.
const MIN_GAIN: f64 = 0.2;

/// A motion and its uncertainty.
#[derive(Debug, Clone, Copy)]
pub struct MotionEstimate {
    /// Best estimate.
    pub motion: Motion,
    /// Covariance of its error.
    pub covariance: MotionMatrix,
}

impl MotionEstimate {
    /// Returns the possible error of a pose found from features, one sigma, m at a distance and
    /// rad: features ignore the rolling shutter, and motion during readout stretches their picture,
    /// which looks like a tilt.
    pub fn off_by_readout(readout_s: f64, distance_m: f64) -> [f64; 2] {
        let rotation = STRETCH_TO_TILT * UNSEEN[1] * readout_s;
        [rotation * distance_m, rotation]
    }

    /// Creates the estimate for a pose whose motion is unobserved. `shift` and `rotation`: one
    /// sigma of the pose, metres and radians.
    pub fn unseen(pose: Pose<Body, Camera>, distance_m: f64, shift: f64, rotation: f64) -> Self {
        let mut covariance = MotionMatrix::zeros();
        for (block, sigma) in [shift, rotation].into_iter().enumerate() {
            for k in 0..3 {
                covariance[(3 * block + k, 3 * block + k)] = sigma * sigma;
            }
        }
        add_unseen(&mut covariance, distance_m, 1.0);
        Self { motion: Motion::still(pose), covariance }
    }

    /// Returns the innovations of shift and rotation when a frame changes this prediction to
    /// `found`. `None` if the frame adds almost no information, or a covariance is singular.
    ///
    /// A frame turns a prediction of covariance P into an estimate of covariance C; under the model
    /// the change has covariance P - C (Kalman 1960). For a well observed body that is about P. For
    /// one that shows little of its tilt it is far less, and a small change is then no sign of
    /// smooth motion.
    pub fn innovations(&self, found: &Self) -> [Option<Innovation>; 2] {
        let error = self.motion.error_to(&found.motion);
        [0, 3].map(|first| {
            let block = |of: &MotionMatrix| of.fixed_view::<3, 3>(first, first).into_owned();
            let root = block(&self.covariance).cholesky()?.l();
            let whiten = root.try_inverse()?;
            let change = whiten * error.fixed_rows::<3>(first);
            let gain = Matrix3::identity() - whiten * block(&found.covariance) * whiten.transpose();
            let axes = gain.symmetric_eigen();
            let informative = axes.eigenvalues.iter().zip(axes.eigenvectors.column_iter()).filter(|(gain, _)| **gain >= MIN_GAIN);
            let (sum, freedom) = informative.fold((0.0, 0), |(sum, n), (gain, axis)| (sum + axis.dot(&change).powi(2) / gain, n + 1));
            (freedom > 0).then(|| Innovation { squared: sum / freedom as f64, freedom })
        })
    }

    /// Propagates an error of the motion by `dt_s`.
    pub fn error_after(&self, error: &MotionError, dt_s: f64) -> MotionError {
        self.transition(dt_s) * error
    }

    /// Returns the matrix that propagates errors of this motion by `dt_s`.
    pub fn transition(&self, dt_s: f64) -> MotionMatrix {
        self.step_to(&self.motion.after(dt_s), dt_s)
    }

    /// Returns the transition matrix of errors from this motion to `motion`, `dt_s` later.
    fn step_to(&self, motion: &Motion, dt_s: f64) -> MotionMatrix {
        // The rotation error is expressed in the camera's axes, which rotated meanwhile.
        let rotated = (motion.pose.rotation.inverse() * self.motion.pose.rotation).to_rotation_matrix().into_inner();
        let mut step = MotionMatrix::identity();
        let i = Matrix3::identity();
        let blocks = [(0, 6, dt_s), (6, 12, dt_s), (3, 9, dt_s), (9, 15, dt_s), (0, 12, 0.5 * dt_s * dt_s), (3, 15, 0.5 * dt_s * dt_s)];
        for (row, column, factor) in blocks {
            step.fixed_view_mut::<3, 3>(row, column).copy_from(&(i * factor));
        }
        step.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotated);
        step
    }

    /// Predicts the estimate `dt_s` ahead, at a distance from the stage.
    pub fn after(&self, dt_s: f64, distance_m: f64, process_noise: &ProcessNoise) -> Self {
        let motion = self.motion.after(dt_s);
        let step = self.step_to(&motion, dt_s);
        let mut covariance = step * self.covariance * step.transpose();
        add_jerk(&mut covariance, 0, process_noise.of_shift(distance_m), dt_s);
        add_jerk(&mut covariance, 3, process_noise.of_rotation(), dt_s);
        // Between a slow camera's frames, jerk is no longer a random walk: the motion is as
        // uncertain as a new one.
        let faded = ((dt_s - REMEMBERED_S).max(0.0) / FADES_IN_S).powi(2);
        add_unseen(&mut covariance, distance_m, 1.0 - (-faded).exp());
        Self { motion, covariance: (covariance + covariance.transpose()) * 0.5 }
    }
}

/// Returns the prior of an unobserved motion at a distance from the stage, one sigma: m/s, rad/s,
/// m/s², rad/s².
pub fn unseen(distance_m: f64) -> [f64; 4] {
    let d = distance_m / UNSEEN_DISTANCE_M;
    [UNSEEN[0] * d, UNSEEN[1], UNSEEN[2] * d, UNSEEN[3]]
}

/// Adds a fraction of the prior of unobserved velocities and accelerations.
fn add_unseen(covariance: &mut MotionMatrix, distance_m: f64, share: f64) {
    for (block, sigma) in unseen(distance_m).into_iter().enumerate() {
        for k in 6 + 3 * block..9 + 3 * block {
            covariance[(k, k)] += share * sigma * sigma;
        }
    }
}

/// Adds the second moments of white jerk of density `q` over `dt` to one half (shift at 0, rotation
/// at 3) of the state.
fn add_jerk(covariance: &mut MotionMatrix, first: usize, q: f64, dt: f64) {
    let moments = [
        [dt.powi(5) / 20.0, dt.powi(4) / 8.0, dt.powi(3) / 6.0],
        [dt.powi(4) / 8.0, dt.powi(3) / 3.0, dt.powi(2) / 2.0],
        [dt.powi(3) / 6.0, dt.powi(2) / 2.0, dt],
    ];
    for (i, row) in moments.iter().enumerate() {
        for (j, moment) in row.iter().enumerate() {
            for k in 0..3 {
                covariance[(first + 6 * i + k, first + 6 * j + k)] += q * moment;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::state::tests::moving;
    use super::*;

    #[test]
    fn the_predicted_covariance_matches_small_errors() {
        let dt = 0.02;
        let estimate = MotionEstimate::unseen(moving().pose, 4.0, 0.01, 0.01);
        let estimate = MotionEstimate { motion: moving(), ..estimate };
        for k in 0..18 {
            let mut error = MotionError::zeros();
            error[k] = 1e-5;
            let alone = MotionEstimate { covariance: error * error.transpose(), ..estimate };
            let carried = estimate.motion.after(dt).error_to(&estimate.motion.corrected(&error).after(dt));
            let grown = alone.after(dt, 0.0, &ProcessNoise::default());
            let mut jerk = MotionMatrix::zeros();
            add_jerk(&mut jerk, 3, ProcessNoise::default().of_rotation(), dt);
            let expected = carried * carried.transpose();
            assert!((grown.covariance - jerk - expected).norm() < 0.02 * expected.norm(), "{k}");
        }
    }
}
