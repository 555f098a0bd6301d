//! Jumps of known instants and sizes, in rows that show exactly where they are.

use super::*;
use crate::geometry::Pose;
use crate::motion::{Motion, MotionEstimate};
use crate::track::align::hypotheses::velocity_jump::by_bend;
use crate::track::align::tuning::TUNING;

const DISTANCE_M: f64 = 4.0;
const ROLLING: Shutter = Shutter { readout_s: 0.014, exposure_s: 0.008 };
const GLOBAL: Shutter = Shutter { readout_s: 0.0, exposure_s: 0.012 };
const FRAME_S: f64 = 1.0 / 30.0;
/// All bands together determine each coordinate of the pose to 0.1 mm or mrad.
const INFORMATION: f64 = 1e8 / BANDS as f64;

/// At rest, as known from the frames before: 0.1 mm and mrad, 20 mm/s and mrad/s, 1 m/s² and
/// rad/s².
fn known() -> MotionMatrix {
    let sigma = |k: usize| [1e-4, 0.02, 1.0][k / 6];
    MotionMatrix::from_diagonal(&MotionError::from_fn(|k, _| f64::powi(sigma(k), -2)))
}

fn alone(information: MotionMatrix, error: MotionError) -> [Option<MotionPrior>; MAX_PRIORS] {
    [Some(MotionPrior { information, error, likelihood: 1.0, covariance: None }), None]
}

/// The bands of a camera that rests, and moves sideways from an instant on. No step has explained
/// any of it yet.
fn bands(shutter: Shutter, instant_s: f64, speed: f64) -> RowBands {
    let mut bands = RowBands::new(shutter);
    let filled = if shutter.readout_s == 0.0 { BANDS / 2..BANDS / 2 + 1 } else { 0..BANDS };
    for k in filled {
        let share = if shutter.readout_s == 0.0 { BANDS as f64 } else { 1.0 };
        let middle_s = bands.middle_s(k);
        let band = &mut bands.bands[k];
        band.is_empty = false;
        for i in 0..6 {
            band.by_pose[0][entry(i, i)] = share * INFORMATION;
        }
        band.left[0][0] = share * INFORMATION * speed * mean_since(middle_s, instant_s, shutter.exposure_s);
    }
    bands
}

#[test]
fn the_mean_time_since_a_jump_averages_over_the_exposure() {
    for t in [-0.011, -0.004, 0.0, 0.003, 0.02] {
        let at = |k: u32| t + 0.008 * ((f64::from(k) + 0.5) / 4000.0 - 0.5);
        let mean = (0..4000).map(|k| (at(k) - 0.001).max(0.0)).sum::<f64>() / 4000.0;
        assert!((mean_since(t, 0.001, 0.008) - mean).abs() < 1e-8, "{t}");
    }
}

#[test]
fn a_jump_is_found_at_its_instant() {
    for shutter in [ROLLING, Shutter { exposure_s: 0.002, ..ROLLING }] {
        let half_s = 0.5 * (shutter.readout_s + shutter.exposure_s);
        // Near the frame's end too few rows show it.
        for instant_s in [-2.0, -0.9, -0.5, -0.2, 0.0, 0.2].map(|share| share * half_s) {
            for speed in [0.3, -0.8] {
                let found =
                    bands(shutter, instant_s, speed).mixture(alone(known(), MotionError::zeros()), FRAME_S, DISTANCE_M).expect("regular");
                let truth = speed * (-instant_s).max(0.0);
                let sigma = (1.0 / (BANDS as f64 * INFORMATION) + found.pose_covariance[(0, 0)]).sqrt();
                let off = found.pose[0] - truth;
                assert!(
                    off.abs() < 3.0 * sigma && off.abs() < 0.25e-3 + 0.05 * truth.abs(),
                    "{shutter:?} {instant_s} {speed}: {off} {sigma}"
                );
                if instant_s > 0.0 && speed.abs() < 0.5 {
                    // Too small and too late to be seen; the next frame will show it.
                    continue;
                }
                assert!((found.motion[6] - speed).abs() < 0.1 + 0.15 * speed.abs(), "{instant_s} {speed}: {}", found.motion[6]);
                // After the frame the camera is where the jump has taken it.
                let after_s = half_s;
                let there = found.motion[0] + found.motion[6] * after_s + 0.5 * found.motion[12] * after_s * after_s;
                assert!((there - speed * (after_s - instant_s)).abs() < 1e-3, "{instant_s} {speed}: {there}");
            }
        }
    }
}

#[test]
fn a_global_shutter_covers_the_jump_by_its_covariance() {
    for k in 0..20 {
        let instant_s = GLOBAL.exposure_s * ((f64::from(k) + 0.5) / 20.0 - 0.5);
        let found = bands(GLOBAL, instant_s, 0.6).mixture(alone(known(), MotionError::zeros()), FRAME_S, DISTANCE_M).expect("regular");
        let off = found.pose[0] - 0.6 * (-instant_s).max(0.0);
        let rest = MotionEstimate { motion: Motion::still(Pose::identity()), covariance: MotionMatrix::identity() };
        let mut seen = rest;
        seen.motion.pose.translation.x = 0.6 * mean_since(0.0, instant_s, GLOBAL.exposure_s);
        let left_open = by_bend(&rest, &seen, None, &GLOBAL, DISTANCE_M) + found.pose_covariance;
        let sigma = (1.0 / (BANDS as f64 * INFORMATION) + left_open[(0, 0)]).sqrt();
        assert!(off.abs() < 5.0 * sigma, "{instant_s}: {off} {sigma}");
    }
}

#[test]
fn a_camera_at_rest_keeps_its_small_covariance() {
    for shutter in [ROLLING, GLOBAL] {
        let found = bands(shutter, 0.0, 0.0).mixture(alone(known(), MotionError::zeros()), FRAME_S, DISTANCE_M).expect("regular");
        assert!(found.pose.norm() < 1e-9 && found.motion.norm() < 1e-9);
        assert!(found.pose_covariance[(0, 0)] < 0.1 * found.motion_covariance[(0, 0)], "{}", found.pose_covariance[(0, 0)]);
    }
}

#[test]
fn prior_uniform_motion_separates_a_small_start_from_jerk() {
    // A start at 0.05 m/s in the middle of the frame: a shift of a fifth of a millimetre, where
    // jerk explains a whole one. The true shift at the stamp is zero.
    let jerky = MotionMatrix::from_diagonal(&MotionError::from_fn(|k, _| f64::powi([1e-3, 0.1, 5.0][k / 6], -2)));
    let shown = bands(ROLLING, 0.0, 0.05);
    let by_jerk = shown.mixture(alone(jerky, MotionError::zeros()), FRAME_S, DISTANCE_M).expect("regular");
    let priors = [(jerky, 0.01), (known(), 0.99)]
        .map(|(information, likelihood)| Some(MotionPrior { information, error: MotionError::zeros(), likelihood, covariance: None }));
    let by_both = shown.mixture(priors, FRAME_S, DISTANCE_M).expect("regular");
    let off = |found: &Mixture| found.pose[0].abs();
    assert!(off(&by_both) < 0.7 * off(&by_jerk), "{} {}", off(&by_both), off(&by_jerk));
    // Where the camera rests, jerk gets hardly any weight, and the pose is as certain as the
    // uniform motion makes it.
    let rests = bands(ROLLING, 0.0, 0.0);
    let [wide, sure] = [alone(jerky, MotionError::zeros()), priors]
        .map(|e| rests.mixture(e, FRAME_S, DISTANCE_M).expect("regular").motion_covariance[(6, 6)]);
    assert!(sure < 0.5 * wide, "{sure} {wide}");
}

#[test]
fn invalid_motions_never_panic() {
    let empty = RowBands::new(ROLLING);
    let found = empty.mixture(alone(known(), MotionError::zeros()), FRAME_S, DISTANCE_M).expect("what was known");
    assert!(found.motion.norm() == 0.0 && found.pose_covariance[(0, 0)] > 0.0);
    assert!(empty.mixture(alone(MotionMatrix::zeros(), MotionError::zeros()), FRAME_S, DISTANCE_M).is_none());
    assert!(empty.mixture(alone(known(), MotionError::repeat(f64::NAN)), FRAME_S, DISTANCE_M).is_none());
    let still = Shutter { readout_s: 0.0, exposure_s: 0.0 };
    for since_s in [0.0, FRAME_S] {
        assert!(bands(still, 0.0, 0.0).mixture(alone(known(), MotionError::zeros()), since_s, DISTANCE_M).is_some());
    }
}

/// The mixture computed member by member, each from the joint normal equations of motion and jump.
fn member_by_member(bands: &RowBands, priors: [Option<MotionPrior>; MAX_PRIORS], dt_s: f64) -> Mixture {
    type Both = SMatrix<f64, 24, 24>;
    let [speed, angular_velocity, ..] = unseen(DISTANCE_M);
    // Logarithm of prior probability times evidence; pose and motion with their covariances.
    let mut members = Vec::new();
    for prior in priors.iter().flatten() {
        let without = bands.without_jump(prior, false).expect("regular");
        let information = without.solved.try_inverse().expect("regular");
        let pull = information * without.correction;
        let pose: Vector6<f64> = without.correction.fixed_rows::<6>(0).into();
        members.push((without.evidence + (1.0 - TUNING.jump_probability).ln(), pose, Matrix6::zeros(), without.correction, without.solved));
        for (instant_s, likelihood) in bands.instants(dt_s) {
            let sums = bands.jump_sums(instant_s);
            for size in JUMP_SIZES {
                let prior = Vector6::from_fn(|k, _| (size * if k < 3 { speed } else { angular_velocity }).powi(-2));
                let mut both = Both::zeros();
                both.fixed_view_mut::<18, 18>(0, 0).copy_from(&information);
                both.fixed_view_mut::<18, 6>(0, 18).copy_from(&sums.shared);
                both.fixed_view_mut::<6, 18>(18, 0).copy_from(&sums.shared.transpose());
                both.fixed_view_mut::<6, 6>(18, 18).copy_from(&(sums.own + Matrix6::from_diagonal(&prior)));
                let covariance = both.try_inverse().expect("regular");
                let right = SMatrix::<f64, 24, 1>::from_fn(|k, _| if k < 18 { pull[k] } else { sums.score[k - 18] });
                let solved = covariance * right;
                let spread: Matrix6<f64> = covariance.fixed_view::<6, 6>(18, 18).into();
                let gain = 0.5 * (right.dot(&solved) - pull.dot(&without.correction))
                    + 0.5 * (spread.determinant().ln() + prior.map(f64::ln).sum());
                // What the jump has moved: the pose at the stamp, and position and velocity after
                // the frame.
                let mut moved = SMatrix::<f64, 18, 24>::identity();
                for k in 0..6 {
                    moved[(k, k + 18)] = -instant_s;
                    moved[(k + 6, k + 18)] = 1.0;
                }
                let mut at_stamp = SMatrix::<f64, 6, 24>::identity();
                for k in 0..6 {
                    at_stamp[(k, k + 18)] = (-instant_s).max(0.0);
                }
                // In excess of the pose's covariance without a jump.
                let pose_covariance = at_stamp * covariance * at_stamp.transpose() - without.solved.fixed_view::<6, 6>(0, 0);
                let (motion, motion_covariance) = if gain > 0.0 {
                    (moved * solved, moved * covariance * moved.transpose())
                } else {
                    (without.correction, without.solved)
                };
                members.push((without.evidence + gain + likelihood.ln(), at_stamp * solved, pose_covariance, motion, motion_covariance));
            }
        }
    }
    let largest = members.iter().map(|m| m.0).fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = members.iter().map(|m| (m.0 - largest).exp()).sum();
    let weighted = || members.iter().map(|m| ((m.0 - largest).exp() / total, m));
    let pose: Vector6<f64> = weighted().map(|(w, m)| m.1 * w).sum();
    let motion: MotionError = weighted().map(|(w, m)| m.3 * w).sum();
    Mixture {
        pose,
        pose_covariance: weighted().map(|(w, m)| (m.2 + (m.1 - pose) * (m.1 - pose).transpose()) * w).sum(),
        motion,
        motion_covariance: weighted().map(|(w, m)| (m.4 + (m.3 - motion) * (m.3 - motion).transpose()) * w).sum(),
    }
}

#[test]
fn the_jump_estimate_is_the_mixture_of_its_members() {
    let jerky = MotionMatrix::from_diagonal(&MotionError::from_fn(|k, _| f64::powi([1e-3, 0.1, 5.0][k / 6], -2)));
    let error = MotionError::from_fn(|k, _| 1e-4 * f64::from(k as u8 % 5));
    let prior = |(information, likelihood): (MotionMatrix, f64)| Some(MotionPrior { information, error, likelihood, covariance: None });
    for priors in [[(jerky, 0.01), (known(), 0.99)].map(prior), [prior((known(), 1.0)), None]] {
        for (shutter, instant_s, speed) in
            [(ROLLING, 0.0, 0.0), (ROLLING, 0.0, 0.05), (ROLLING, -0.004, 0.3), (ROLLING, 0.003, -0.2), (GLOBAL, -0.002, 0.4)]
        {
            let shown = bands(shutter, instant_s, speed);
            let found = shown.mixture(priors, FRAME_S, DISTANCE_M).expect("regular");
            let truth = member_by_member(&shown, priors, FRAME_S);
            let sigma = truth.motion_covariance.diagonal().map(f64::sqrt);
            // Each dropped member has at most the weight NEGLIGIBLE, and is off by some sigmas.
            let off = (found.motion - truth.motion).component_div(&sigma).amax();
            assert!(off < 1e-3, "{shutter:?} {instant_s} {speed}: motion off by {off} sigmas");
            let relative = |found: f64, truth: f64| ((found - truth) / truth).abs();
            for k in 0..18 {
                let off = relative(found.motion_covariance[(k, k)], truth.motion_covariance[(k, k)]);
                assert!(off < 1e-3, "{shutter:?} {instant_s} {speed}: variance {k} of the motion off by {off}");
            }
            let pose_sigma = sigma.fixed_rows::<6>(0);
            assert!((found.pose - truth.pose).component_div(&pose_sigma).amax() < 1e-3, "{} {}", found.pose, truth.pose);
            for k in 0..6 {
                let off = (found.pose_covariance[(k, k)] - truth.pose_covariance[(k, k)]).abs() / truth.motion_covariance[(k, k)];
                assert!(off < 1e-3, "{shutter:?} {instant_s} {speed}: variance {k} of the pose off by {off}");
            }
        }
    }
}
