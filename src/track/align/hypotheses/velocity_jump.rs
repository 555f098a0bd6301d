//! Cameras that are started, stopped or pushed: their velocity jumps, at any instant, also while a
//! frame is exposed and read.
//!
//! The motion filter models white jerk, which has no jumps. Where a jump explains the frame better,
//! by its marginal likelihood and the odds against it, the frame is solved with a second prior,
//! whose velocity jumped at some time since the last frame or within this one ([`jumped`]). Then
//! every frame is tested for when its velocity jumped, and by how much (`solve::jump_instant`).
//! [`by_bend`] and [`by_start`] return the uncertainty that remains.

use nalgebra::{Matrix6, Vector6};

use super::Hypothesis;
use crate::camera::Shutter;
use crate::motion::{Continuation, MotionEstimate, MotionMatrix, unseen};
use crate::track::align::frame_problem::FrameProblem;
use crate::track::align::picture::surface::distance_m;
use crate::track::align::solve::level_problem::LevelPrior;
use crate::track::align::tuning::TUNING;

/// Mean square, over all s, of s (1 - s) / 2: the error, per exposure and unit of speed, of a
/// camera that starts or stops at the fraction s of the exposure. Not a setting.
const START_STOP_MEAN_SQUARE: f64 = 1.0 / 120.0;

/// The velocity jumped since the last frame. A small picture has few pixels. Where they contradict
/// the prediction, their residuals are large and weigh little beside the prior: the pose stays
/// where it was predicted, and only the residuals show the jump.
pub struct VelocityJump;

impl Hypothesis for VelocityJump {
    fn name(&self) -> &'static str {
        "velocity jump"
    }

    fn is_called_for(&self, frame: &mut FrameProblem) -> bool {
        let (Some(with_jump), Some(mut solution)) = (prior(frame), frame.buffers.fine.solution()) else { return false };
        let found = solution.estimate();
        let log_odds = (TUNING.jump_probability / (1.0 - TUNING.jump_probability)).ln()
            + log_evidence_ratio(&found, frame.expected, [frame.known.information, &with_jump]).unwrap_or(f64::NEG_INFINITY);
        solution.found.residual_sigma > TUNING.clear_fit_sigma || log_odds > 0.0
    }

    fn solve(&self, frame: &mut FrameProblem) -> Option<()> {
        let (found, information) = (frame.found()?.motion, prior(frame)?);
        frame.has_jumped = true;
        frame.settle(found, &LevelPrior { information: &information, ..frame.known })
    }
}

/// Returns the information of the prior whose velocity jumped since the last frame; `None` for a
/// body that was just found.
fn prior(frame: &FrameProblem) -> Option<MotionMatrix> {
    let expected = frame.expected;
    let with_jump = jumped(expected, frame.since_s?, &frame.slow.shutter, distance_m(frame.surfaces, &expected.motion.pose));
    Some(with_jump.covariance.cholesky()?.inverse())
}

/// Returns the logarithm of the ratio of two priors' marginal likelihoods (Laplace's approximation;
/// MacKay 2003, chapter 28), without solving with the second one. `found`: the motion solved with
/// the first prior; `expected`: the mean of both; `information`: of the first and the second.
/// `None` where a matrix is not positive.
fn log_evidence_ratio(found: &MotionEstimate, expected: &MotionEstimate, information: [&MotionMatrix; 2]) -> Option<f64> {
    let [first, second] = information;
    let posterior = found.covariance.cholesky()?.inverse();
    let error = expected.motion.error_to(&found.motion);
    let log_root = |matrix: &MotionMatrix| Some(matrix.cholesky()?.l().diagonal().iter().map(|pivot| pivot.ln()).sum::<f64>());
    // The data's cost is quadratic about the solution, where its slope cancels that of the prior.
    let pull = (first - second) * error;
    let other_posterior = posterior - first + second;
    let other_cost = error.dot(&(second * error)) - pull.dot(&other_posterior.cholesky()?.solve(&pull));
    let log_likelihoods = 0.5 * (error.dot(&(first * error)) - other_cost);
    Some(log_likelihoods + log_root(second)? - log_root(first)? - log_root(&other_posterior)? + log_root(&posterior)?)
}

/// Returns the prior after `dt_s` seconds if the velocity may have jumped meanwhile. `expected`:
/// the prediction without a jump; `distance_m`: to the nearest surface, for the usual velocity.
pub fn jumped(expected: &MotionEstimate, dt_s: f64, shutter: &Shutter, distance_m: f64) -> MotionEstimate {
    let mut covariance = expected.covariance;
    let frame_s = shutter.readout_s + shutter.exposure_s;
    // At any instant since the last frame, or up to the end of this one.
    let since_s = dt_s.max(0.5 * frame_s);
    let [speed, angular_velocity, ..] = unseen(distance_m);
    for (first, sigma) in [(0, speed), (3, angular_velocity)] {
        let bend = if frame_s > 0.0 { TUNING.jump_acceleration_sigma * sigma * shutter.readout_s / frame_s.powi(2) } else { 0.0 };
        for k in first..first + 3 {
            covariance[(k, k)] += (sigma * since_s).powi(2) / 3.0;
            covariance[(k, k + 6)] += sigma.powi(2) * since_s / 2.0;
            covariance[(k + 6, k)] += sigma.powi(2) * since_s / 2.0;
            covariance[(k + 6, k + 6)] += sigma.powi(2);
            covariance[(k + 12, k + 12)] += bend.powi(2);
        }
    }
    MotionEstimate { motion: expected.motion, covariance }
}

/// Returns the covariance that a bend of the motion within the frame adds to the pose: the middle
/// of the picture's path is not where the camera was at the stamp. `line`: the prediction of the
/// line that the camera was following, if there was one; otherwise the pose is compared with
/// `expected`. A pose within the noise about its line may be off as well, as a small jump may hide
/// there.
pub fn by_bend(
    expected: &MotionEstimate,
    found: &MotionEstimate,
    line: Option<&Continuation>,
    shutter: &Shutter,
    distance_m: f64,
) -> Matrix6<f64> {
    let error = expected.motion.error_to(&found.motion);
    let frame_s = shutter.readout_s.hypot(shutter.exposure_s);
    let [speed, angular_velocity, ..] = unseen(distance_m);
    let off = line.map_or(error, |line| line.expected.motion.error_to(&found.motion));
    let off: Vector6<f64> = off.fixed_rows::<6>(0).into_owned();
    let share = if line.is_some() { TUNING.jump_line_error_ratio } else { TUNING.jump_prediction_error_ratio };
    // The line itself may be off by this much. While the pose lies on it, that is part of the
    // distance already.
    let left = line.filter(|line| line.has_left);
    let covariance = left.map_or(Matrix6::zeros(), |line| line.expected.covariance.fixed_view::<6, 6>(0, 0).into_owned());
    // How long a usual jump takes to get there.
    let takes_s = (off.fixed_rows::<3>(0).norm() / speed).hypot(off.fixed_rows::<3>(3).norm() / angular_velocity);
    let most = (TUNING.max_jump_sigmas / 8.0 * frame_s / takes_s.max(f64::MIN_POSITIVE)).min(1.0);
    let bend: Vector6<f64> = error.fixed_rows::<6>(6) * (TUNING.jump_velocity_error_ratio * frame_s);
    (off * off.transpose() + covariance) * (share * most).powi(2) + bend * bend.transpose()
}

/// Returns the covariance added to the first pose, as the camera may have just started or stopped.
pub fn by_start(found: &MotionEstimate, shutter: &Shutter) -> Matrix6<f64> {
    found.covariance.fixed_view::<6, 6>(6, 6) * (START_STOP_MEAN_SQUARE * shutter.exposure_s.powi(2))
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::Pose;
    use crate::motion::{Motion, MotionError};

    const DISTANCE_M: f64 = 4.0;
    const GLOBAL: Shutter = Shutter { readout_s: 0.0, exposure_s: 0.012 };
    const ROLLING: Shutter = Shutter { readout_s: 0.014, exposure_s: 0.008 };

    fn rest(variance: f64) -> MotionEstimate {
        let pose = Pose::new(UnitQuaternion::identity(), Vector3::zeros());
        MotionEstimate { motion: Motion::still(pose), covariance: MotionMatrix::identity() * variance }
    }

    /// The ratio of evidences of a linear problem, against the definition: the density of the
    /// data's estimate under each prior.
    #[test]
    fn the_evidence_ratio_is_that_of_the_definition() {
        let mut random = Pcg64Mcg::seed_from_u64(5);
        let mut matrix = |scale: f64| {
            let root = MotionMatrix::from_fn(|i, j| random.random_range(-1.0..1.0) + if i == j { 3.0 } else { 0.0 });
            root * root.transpose() * scale
        };
        for scale in [0.3, 3.0, 30.0] {
            let (by_data, first, second) = (matrix(2.0), matrix(1.0), matrix(scale));
            let seen = MotionError::from_fn(|i, _| 0.02 * (i as f64 - 7.0));
            let expected = MotionEstimate { covariance: first, ..rest(1.0) };
            let information = [first, second].map(|covariance| covariance.cholesky().expect("positive").inverse());
            let data_information = by_data.cholesky().expect("positive").inverse();
            let posterior = (data_information + information[0]).cholesky().expect("positive").inverse();
            let found = MotionEstimate { motion: expected.motion.corrected(&(posterior * data_information * seen)), covariance: posterior };
            let log_density = |prior: &MotionMatrix| {
                let both = (prior + by_data).cholesky().expect("positive");
                -0.5 * seen.dot(&both.solve(&seen)) - both.l().diagonal().iter().map(|pivot| pivot.ln()).sum::<f64>()
            };
            let by_definition = log_density(&second) - log_density(&first);
            let ratio = log_evidence_ratio(&found, &expected, [&information[0], &information[1]]).expect("positive");
            assert!((ratio - by_definition).abs() < 1e-3 * by_definition.abs().max(1.0), "{ratio} {by_definition}");
        }
    }

    #[test]
    fn moments_match_a_velocity_jump_at_any_instant() {
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let (dt_s, n) = (0.04, 200_000);
        let [speed, ..] = unseen(DISTANCE_M);
        let mut sums = [0.0; 3];
        for _ in 0..n {
            let v = speed * ((0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0);
            let x = v * dt_s * random.random::<f64>();
            sums = [sums[0] + x * x, sums[1] + x * v, sums[2] + v * v];
        }
        let found = jumped(&rest(0.0), dt_s, &GLOBAL, DISTANCE_M).covariance;
        for (sum, expected) in sums.iter().zip([found[(1, 1)], found[(1, 7)], found[(7, 7)]]) {
            assert!((sum / f64::from(n) / expected - 1.0).abs() < 0.02, "{sum} {expected}");
        }
        assert!(jumped(&rest(1e-9), dt_s, &ROLLING, DISTANCE_M).covariance.cholesky().is_some());
    }

    #[test]
    fn the_covariance_covers_a_start_during_the_exposure() {
        let exposure_s = GLOBAL.exposure_s;
        let [speed, ..] = unseen(DISTANCE_M);
        for k in 1..40 {
            let s = f64::from(k) / 40.0;
            for jump in [0.3 * speed, speed, 2.0 * speed] {
                // Rest, then uniform motion from the fraction s of the exposure on: the mean of the
                // path, and where the camera was at its middle.
                let seen = jump * exposure_s * (1.0 - s).powi(2) / 2.0;
                let truth = jump * exposure_s * (0.5 - s).max(0.0);
                let mut found = rest(1e-10);
                found.motion.pose = Pose::new(UnitQuaternion::identity(), Vector3::x() * seen);
                let sigma = by_bend(&rest(1e-8), &found, None, &GLOBAL, DISTANCE_M)[(0, 0)].sqrt();
                assert!((seen - truth).abs() < 4.8 * sigma, "{s} {jump}: {} {sigma}", seen - truth);
                // The covariance is not absurdly wider than the largest error of such a jump
                // either.
                assert!(sigma < TUNING.jump_prediction_error_ratio * TUNING.max_jump_sigmas / 8.0 * speed * exposure_s * 1.001);
            }
        }
    }
}
