//! Cameras that are started, stopped or pushed: their velocity jumps, at any instant, also while a frame is exposed and read.
//!
//! White jerk has no jumps. So there is a second expectation of each frame, with a velocity that jumped somewhere since the last frame or
//! within this one. Where a pose is found too far from what jerk explains, the frame is solved with it. Where it is not, a
//! jump may hide all the same: it shows as a small change of the pose, which is wrong by then. A mixture of both
//! expectations (Bar-Shalom, Li and Kirubarajan 2001, section 11.6) tells how far off.

use nalgebra::{Matrix6, Vector6};

use super::Sensor;
use super::motion::{MotionError, MotionEstimate, MotionMatrix, unseen};

/// A pose found further than this from where it was expected (squared, in sigmas, six degrees of freedom: one frame in 2000 by chance) is
/// solved with a jump. Raised, jumps pull the pose by what was expected; lowered, frames of a shaken camera know
/// less of their motion than they could: with 16 instead of 30, d-whip's errors grow from 0.24 to 0.31 mm.
const SURPRISING: f64 = 24.0;
/// How likely a jump is that shows no further than that. Raised, the covariance of every frame of a rolling shutter grows.
const LIKELIHOOD: f64 = 0.03;
/// A jump within the exposure bends the path of the picture: the acceleration that a rolling shutter's rows take it for, one sigma, times
/// the velocity that is usual over the time of a frame.
const BEND: f64 = 2.0;
/// One sigma of the pose's error, as a share of how far the pose was found from where it was expected: all of it where
/// the camera starts in the second half of the exposure, nothing where it does before.
const OFF_SHARE: f64 = 0.4;
/// A jump of this many sigmas at the middle of the exposure is the largest that such an error comes from: it is an eighth of the jump times
/// the exposure.
const LARGEST_JUMP: f64 = 3.0;
/// Of a velocity that changed within a frame, times how long the frame was exposed and read, this share is an error of the pose: at most an
/// eighth of it where all rows are exposed together, and 0.05 where rows follow each other; twice as much, because the
/// velocity that is found lies between those before and after.
const BEND_SHARE: f64 = 0.18;
/// A camera that starts or stops at a share s of the exposure is seen s (1 - s) / 2 of it from where its stamp says, per unit of
/// speed: the mean square over all s.
const STARTED_SQUARE: f64 = 1.0 / 120.0;

/// Where a pose lies so far from what was expected (squared, in sigmas) that jerk does not explain it.
pub fn is_surprising(surprise: f64) -> bool {
    surprise >= SURPRISING
}

/// What is expected after `dt_s` where the velocity may have jumped meanwhile. `expected`: where it did not.
pub fn jumped(expected: &MotionEstimate, dt_s: f64, sensor: &Sensor, distance_m: f64) -> MotionEstimate {
    let mut covariance = expected.covariance;
    let frame_s = sensor.readout_s + sensor.exposure_s;
    // At any instant since the last frame, or up to the end of this one.
    let since_s = dt_s.max(0.5 * frame_s);
    let [speed, turn_rate, ..] = unseen(distance_m);
    for (first, sigma) in [(0, speed), (3, turn_rate)] {
        let bend = if frame_s > 0.0 { BEND * sigma * sensor.readout_s / frame_s.powi(2) } else { 0.0 };
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

/// Takes back the acceleration that a frame with a jump was solved with: it stood for the jump, which is over.
pub fn end_jump(estimate: &mut MotionEstimate, sensor: &Sensor, distance_m: f64) {
    let MotionEstimate { motion, covariance } = estimate;
    let half_frame_s = 0.5 * (sensor.readout_s + sensor.exposure_s);
    let mut by_bend = MotionError::zeros();
    by_bend.fixed_rows_mut::<3>(6).copy_from(&(motion.acceleration * half_frame_s));
    by_bend.fixed_rows_mut::<3>(9).copy_from(&(motion.turn_acceleration * half_frame_s));
    motion.acceleration.fill(0.0);
    motion.turn_acceleration.fill(0.0);
    *covariance += by_bend * by_bend.transpose();
    covariance.fixed_view_mut::<6, 18>(12, 0).fill(0.0);
    covariance.fixed_view_mut::<18, 6>(0, 12).fill(0.0);
    let [.., acceleration, turn_acceleration] = unseen(distance_m);
    for (first, sigma) in [(12, acceleration), (15, turn_acceleration)] {
        for k in first..first + 3 {
            covariance[(k, k)] = sigma * sigma;
        }
    }
}

/// What a jump that was not seen adds to the covariance of a pose. `expected` and `with_jump`: without and with one; `found`: what the frame
/// made of the former.
pub fn unseen_jump(expected: &MotionEstimate, with_jump: &MotionEstimate, found: &MotionEstimate) -> Option<Matrix6<f64>> {
    let inverse = |m: &MotionMatrix| m.cholesky().map(|c| c.inverse());
    // What the frame alone says, together with the wider expectation.
    let frame = inverse(&found.covariance)? - inverse(&expected.covariance)?;
    let wider = inverse(&(frame + inverse(&with_jump.covariance)?))?;
    let of_pose = |m: &MotionMatrix| m.fixed_view::<6, 6>(0, 0).into_owned();
    Some((of_pose(&wider) - of_pose(&found.covariance)) * LIKELIHOOD)
}

/// What a motion that bent within the frame adds to the covariance of the pose: the picture's middle is not where the camera was at the stamp.
pub fn by_bend(expected: &MotionEstimate, found: &MotionEstimate, sensor: &Sensor, distance_m: f64) -> Matrix6<f64> {
    let error = expected.motion.error_to(&found.motion);
    let frame_s = sensor.readout_s.hypot(sensor.exposure_s);
    let [speed, turn_rate, ..] = unseen(distance_m);
    let off: Vector6<f64> = error.fixed_rows::<6>(0).into_owned();
    // How long a usual jump takes to get there.
    let takes_s = (off.fixed_rows::<3>(0).norm() / speed).hypot(off.fixed_rows::<3>(3).norm() / turn_rate);
    let most = (LARGEST_JUMP / 8.0 * frame_s / takes_s.max(f64::MIN_POSITIVE)).min(1.0);
    let off = off * (OFF_SHARE * most);
    let bend: Vector6<f64> = error.fixed_rows::<6>(6) * (BEND_SHARE * frame_s);
    off * off.transpose() + bend * bend.transpose()
}

/// What is left open of the first pose: whether the camera just started or stopped.
pub fn by_start(found: &MotionEstimate, sensor: &Sensor) -> Matrix6<f64> {
    found.covariance.fixed_view::<6, 6>(6, 6) * (STARTED_SQUARE * sensor.exposure_s.powi(2))
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::Pose;
    use crate::track::align::motion::Motion;

    const DISTANCE_M: f64 = 4.0;
    const GLOBAL: Sensor = Sensor { readout_s: 0.0, exposure_s: 0.012 };
    const ROLLING: Sensor = Sensor { readout_s: 0.014, exposure_s: 0.008 };

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
                let sigma = by_bend(&rest(1e-8), &found, &GLOBAL, DISTANCE_M)[(0, 0)].sqrt();
                assert!((seen - truth).abs() < 2.6 * sigma, "{s} {jump}: {} {sigma}", seen - truth);
                // Nor is it absurdly more than the largest error of such a jump.
                assert!(sigma < OFF_SHARE * LARGEST_JUMP / 8.0 * speed * exposure_s * 1.001);
            }
        }
    }

    #[test]
    fn a_frame_that_leaves_motion_open_is_less_sure_where_it_may_have_jumped() {
        let expected = rest(1e-6);
        // Rows that tell the pose plus 5 ms of its velocity, but not one from the other.
        let mut rows = MotionMatrix::zeros();
        for k in 0..6 {
            let (a, b) = (1.0, 0.005);
            rows[(k, k)] = 1e10 * a * a;
            rows[(k, k + 6)] = 1e10 * a * b;
            rows[(k + 6, k)] = 1e10 * a * b;
            rows[(k + 6, k + 6)] = 1e10 * b * b;
        }
        let covariance = (rows + expected.covariance.try_inverse().unwrap()).try_inverse().unwrap();
        let found = MotionEstimate { covariance, ..expected };
        let same = unseen_jump(&expected, &expected, &found).unwrap();
        assert!(same.norm() < 1e-6 * covariance.fixed_view::<6, 6>(0, 0).norm());
        let with_jump = jumped(&expected, 1.0 / 30.0, &ROLLING, DISTANCE_M);
        let more = unseen_jump(&expected, &with_jump, &found).unwrap();
        // The variance of x where x + b v is known, from the moments of both.
        let c = &with_jump.covariance;
        let (x, xv, v, b) = (c[(0, 0)], c[(0, 6)], c[(6, 6)], 0.005);
        let open = x - (x + b * xv).powi(2) / (x + 2.0 * b * xv + b * b * v);
        assert!((more[(0, 0)] / (LIKELIHOOD * open) - 1.0).abs() < 0.2, "{} {open}", more[(0, 0)]);
    }

    #[test]
    fn the_acceleration_that_stood_for_a_jump_ends_with_the_frame() {
        let mut estimate = rest(1e-4);
        estimate.motion.acceleration = Vector3::new(60.0, 0.0, 0.0);
        end_jump(&mut estimate, &ROLLING, DISTANCE_M);
        assert_eq!(estimate.motion.acceleration, Vector3::zeros());
        // Up to half of the jump is not in the velocity yet.
        assert!(estimate.covariance[(6, 6)] > (60.0f64 * 0.011).powi(2));
        assert!(estimate.covariance.cholesky().is_some());
    }
}
