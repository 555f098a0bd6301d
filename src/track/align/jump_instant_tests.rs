//! Jumps of known instants and sizes, seen by rows that show exactly where they are.

use super::*;
use crate::geometry::Pose;
use crate::motion::{Motion, MotionEstimate};
use crate::track::align::velocity_jump::by_bend;

const DISTANCE_M: f64 = 4.0;
const ROLLING: Shutter = Shutter { readout_s: 0.014, exposure_s: 0.008 };
const GLOBAL: Shutter = Shutter { readout_s: 0.0, exposure_s: 0.012 };
const FRAME_S: f64 = 1.0 / 30.0;
/// All bands together tell each coordinate of the pose to 0.1 mm or mrad.
const INFORMATION: f64 = 1e8 / BANDS as f64;

/// At rest, as known from the frames before: 0.1 mm and mrad, 20 mm/s and mrad/s, 1 m/s² and rad/s².
fn known() -> MotionMatrix {
    let sigma = |k: usize| [1e-4, 0.02, 1.0][k / 6];
    MotionMatrix::from_diagonal(&MotionError::from_fn(|k, _| f64::powi(sigma(k), -2)))
}

fn alone(information: MotionMatrix, error: MotionError) -> [Option<Expectation>; EXPECTATIONS] {
    [Some(Expectation { information, error, likelihood: 1.0, covariance: None }), None]
}

/// What the bands of a camera show that rests and moves sideways from an instant on; nothing of it is explained yet.
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
fn the_mean_time_since_an_instant_is_that_of_the_exposure() {
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
                    // Too small and too late to be seen: the next frame will show it.
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
fn where_all_rows_are_exposed_together_the_covariance_covers_it() {
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
fn a_camera_that_rests_stays_sure() {
    for shutter in [ROLLING, GLOBAL] {
        let found = bands(shutter, 0.0, 0.0).mixture(alone(known(), MotionError::zeros()), FRAME_S, DISTANCE_M).expect("regular");
        assert!(found.pose.norm() < 1e-9 && found.motion.norm() < 1e-9);
        assert!(found.pose_covariance[(0, 0)] < 0.1 * found.motion_covariance[(0, 0)], "{}", found.pose_covariance[(0, 0)]);
    }
}

#[test]
fn an_even_motion_before_tells_a_small_start_from_jerk() {
    // A start at 0.05 m/s in the middle of the frame, a fifth of a millimetre, where jerk explains a whole one; the truth is no shift.
    let jerky = MotionMatrix::from_diagonal(&MotionError::from_fn(|k, _| f64::powi([1e-3, 0.1, 5.0][k / 6], -2)));
    let shown = bands(ROLLING, 0.0, 0.05);
    let by_jerk = shown.mixture(alone(jerky, MotionError::zeros()), FRAME_S, DISTANCE_M).expect("regular");
    let expectations = [(jerky, 0.01), (known(), 0.99)]
        .map(|(information, likelihood)| Some(Expectation { information, error: MotionError::zeros(), likelihood, covariance: None }));
    let by_both = shown.mixture(expectations, FRAME_S, DISTANCE_M).expect("regular");
    let off = |found: &Mixture| found.pose[0].abs();
    assert!(off(&by_both) < 0.7 * off(&by_jerk), "{} {}", off(&by_both), off(&by_jerk));
    // Where the camera rests, jerk is hardly believed, and the pose is as sure as the even motion has it.
    let rests = bands(ROLLING, 0.0, 0.0);
    let [wide, sure] = [alone(jerky, MotionError::zeros()), expectations]
        .map(|e| rests.mixture(e, FRAME_S, DISTANCE_M).expect("regular").motion_covariance[(6, 6)]);
    assert!(sure < 0.5 * wide, "{sure} {wide}");
}

#[test]
fn what_is_no_motion_is_no_panic() {
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
