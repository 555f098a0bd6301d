//! Cameras that are started, stopped or pushed: their velocity jumps, at any instant, also while a frame is exposed and read.
//!
//! White jerk has no jumps. Where a pose is found too far from what jerk explains, the frame is solved with a second expectation, whose
//! velocity jumped somewhere since the last frame or within this one. When it jumped, and by how much, is asked of every frame after that
//! (`jump_instant`); here is also what those questions leave open.

use nalgebra::{Matrix6, Vector6};

use crate::camera::Shutter;
use crate::motion::{Continuation, MotionEstimate, unseen};

/// A pose found further than this from where it was expected (squared, in sigmas, six degrees of freedom: one frame in 2000 by chance) is
/// solved with a jump. Raised, jumps pull the pose by what was expected; lowered, frames of a shaken camera know
/// less of their motion than they could: with 16 instead of 30, d-whip's errors grow from 0.24 to 0.31 mm.
const UNEXPECTED: f64 = 24.0;
/// A jump within the exposure bends the path of the picture: the acceleration that a rolling shutter's rows take it for, one sigma, times
/// the velocity that is usual over the time of a frame. Raised, frames with a jump know less of their acceleration; lowered, the bend
/// passes for a shift of the pose.
const BEND: f64 = 2.0;
/// One sigma of the pose's error, as a share of how far it was found from where it was expected: all of it where the camera starts in the
/// second half of the exposure, nothing before. Where rows tell the instant it is known far better, so that this is half of the scatter
/// over all instants. Raised, the covariance of every surprise is wider.
const OFF_SHARE: f64 = 0.22;
/// The same of how far the pose was found from the line that the camera went on. A line is known nearly as well as a pose, so that also a small
/// jump within the exposure leads away from it: what is off is then all error in half of the cases. With 0.22, errors of 4.5 sigma are usual among
/// poses that left their line; raised, the covariance of every start and stop is wider.
const LINE_SHARE: f64 = 0.4;
/// A jump of this many sigmas at the middle of the exposure is the largest that such an error comes from: it is an eighth of the jump times
/// the exposure. Raised, poses that are far off for other reasons get a wider covariance than any start could need.
const MAX_JUMP: f64 = 3.0;
/// Of a velocity that changed within a frame, times how long the frame was exposed and read, this share is an error of the pose: at most an
/// eighth of it where all rows are exposed together, and 0.05 where rows follow each other. Raised, covariances of shaken cameras are
/// wider.
const BEND_SHARE: f64 = 0.1;
/// A camera that starts or stops at a share s of the exposure is seen s (1 - s) / 2 of it from where its stamp says, per unit of
/// speed: the mean square over all s.
const STARTED_SQUARE: f64 = 1.0 / 120.0;

/// Whether a pose lies too far from what was expected (squared Mahalanobis distance) for jerk to explain it.
pub fn is_unexpected(squared_mahalanobis: f64) -> bool {
    squared_mahalanobis >= UNEXPECTED
}

/// What is expected after `dt_s` where the velocity may have jumped meanwhile. `expected`: where it did not.
pub fn jumped(expected: &MotionEstimate, dt_s: f64, shutter: &Shutter, distance_m: f64) -> MotionEstimate {
    let mut covariance = expected.covariance;
    let frame_s = shutter.readout_s + shutter.exposure_s;
    // At any instant since the last frame, or up to the end of this one.
    let since_s = dt_s.max(0.5 * frame_s);
    let [speed, turn_rate, ..] = unseen(distance_m);
    for (first, sigma) in [(0, speed), (3, turn_rate)] {
        let bend = if frame_s > 0.0 { BEND * sigma * shutter.readout_s / frame_s.powi(2) } else { 0.0 };
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

/// What a motion that bent within the frame adds to the covariance of the pose: the picture's middle is not where the camera was at the stamp.
/// `line`: where the line led that the camera went on, if it did; otherwise the pose is held against what was expected. Also a pose
/// that stays within the noise about its line may be off: a jump may hide there.
pub fn by_bend(
    expected: &MotionEstimate,
    found: &MotionEstimate,
    line: Option<&Continuation>,
    shutter: &Shutter,
    distance_m: f64,
) -> Matrix6<f64> {
    let error = expected.motion.error_to(&found.motion);
    let frame_s = shutter.readout_s.hypot(shutter.exposure_s);
    let [speed, turn_rate, ..] = unseen(distance_m);
    let off = line.map_or(error, |line| line.expected.motion.error_to(&found.motion));
    let off: Vector6<f64> = off.fixed_rows::<6>(0).into_owned();
    let share = if line.is_some() { LINE_SHARE } else { OFF_SHARE };
    // By as much may the line itself be off; while the pose lies on it, that is part of the distance.
    let left = line.filter(|line| line.has_left);
    let covariance = left.map_or(Matrix6::zeros(), |line| line.expected.covariance.fixed_view::<6, 6>(0, 0).into_owned());
    // How long a usual jump takes to get there.
    let takes_s = (off.fixed_rows::<3>(0).norm() / speed).hypot(off.fixed_rows::<3>(3).norm() / turn_rate);
    let most = (MAX_JUMP / 8.0 * frame_s / takes_s.max(f64::MIN_POSITIVE)).min(1.0);
    let bend: Vector6<f64> = error.fixed_rows::<6>(6) * (BEND_SHARE * frame_s);
    (off * off.transpose() + covariance) * (share * most).powi(2) + bend * bend.transpose()
}

/// What is left open of the first pose: whether the camera just started or stopped.
pub fn by_start(found: &MotionEstimate, shutter: &Shutter) -> Matrix6<f64> {
    found.covariance.fixed_view::<6, 6>(6, 6) * (STARTED_SQUARE * shutter.exposure_s.powi(2))
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::Pose;
    use crate::motion::{Motion, MotionMatrix};

    const DISTANCE_M: f64 = 4.0;
    const GLOBAL: Shutter = Shutter { readout_s: 0.0, exposure_s: 0.012 };
    const ROLLING: Shutter = Shutter { readout_s: 0.014, exposure_s: 0.008 };

    fn rest(variance: f64) -> MotionEstimate {
        let pose = Pose::new(UnitQuaternion::identity(), Vector3::zeros());
        MotionEstimate { motion: Motion::still(pose), covariance: MotionMatrix::identity() * variance }
    }

    #[test]
    fn moments_are_those_of_a_velocity_that_jumped_at_any_instant() {
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
    fn a_start_within_the_exposure_is_off_by_no_more_than_the_covariance_says() {
        let exposure_s = GLOBAL.exposure_s;
        let [speed, ..] = unseen(DISTANCE_M);
        for k in 1..40 {
            let s = f64::from(k) / 40.0;
            for jump in [0.3 * speed, speed, 2.0 * speed] {
                // Rest, then uniform motion from the share s of the exposure on: the mean of the path, and where the camera was in its middle.
                let seen = jump * exposure_s * (1.0 - s).powi(2) / 2.0;
                let truth = jump * exposure_s * (0.5 - s).max(0.0);
                let mut found = rest(1e-10);
                found.motion.pose = Pose::new(UnitQuaternion::identity(), Vector3::x() * seen);
                let sigma = by_bend(&rest(1e-8), &found, None, &GLOBAL, DISTANCE_M)[(0, 0)].sqrt();
                assert!((seen - truth).abs() < 4.8 * sigma, "{s} {jump}: {} {sigma}", seen - truth);
                // Nor is it absurdly more than the largest error of such a jump.
                assert!(sigma < OFF_SHARE * MAX_JUMP / 8.0 * speed * exposure_s * 1.001);
            }
        }
    }
}
