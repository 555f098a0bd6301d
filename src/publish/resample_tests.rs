use nalgebra::{UnitQuaternion, Vector3};

use super::*;

const FRAME: Duration = Duration::from_millis(33);

fn at_ms(ms: i64) -> Timestamp {
    Timestamp::from_ns(ms * 1_000_000)
}

fn moving(ms: i64) -> Pose<Stage, Body> {
    let s = ms as f64 * 1e-3;
    Pose::new(UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.5 * s), Vector3::new(s, 0.0, 0.0))
}

fn known(state: State, ms: i64) -> Known {
    let has_pose = matches!(state, State::Tracking | State::Coasting);
    Known { state, pose: has_pose.then(|| moving(ms)), is_predicted: false }
}

/// Samples in these states, one frame apart from 0 on, with the pose of their instant.
fn samples(states: &[State]) -> Resampler {
    let mut resampler = Resampler::new(Duration::from_millis(500));
    for (k, state) in states.iter().enumerate() {
        resampler.push(at_ms(k as i64 * 33), known(*state, k as i64 * 33));
    }
    resampler
}

use State::{Coasting, Lost, Tracking};

#[test]
fn uniform_motion_is_resampled_exactly() {
    let r = samples(&[Tracking; 4]);
    for ms in [0, 1, 33, 50, 99, 100, 120, 198] {
        let (found, wanted) = (r.at(at_ms(ms), FRAME).pose.unwrap(), moving(ms));
        assert!((found.translation - wanted.translation).norm() < 1e-9 && found.angle_to(&wanted) < 1e-9, "{ms}");
    }
    assert!(r.at(Timestamp::from_ns(-1), FRAME).pose.is_none() && r.at(at_ms(200), FRAME).pose.is_none());
}

/// Returns (state, whether extrapolated) after some milliseconds.
fn state_at(r: &Resampler, ms: i64) -> (State, bool) {
    let known = r.at(at_ms(ms), FRAME);
    (known.state, known.is_predicted)
}

#[test]
fn tracking_extends_one_frame_interval_past_the_last_frame() {
    let r = samples(&[Tracking; 3]);
    assert_eq!([0, 20, 66].map(|ms| state_at(&r, ms)), [(Tracking, false); 3]);
    assert_eq!([67, 99].map(|ms| state_at(&r, ms)), [(Tracking, true); 2]);
    assert_eq!([101, 166].map(|ms| state_at(&r, ms)), [(Coasting, false); 2]);
    assert_eq!(state_at(&r, 167), (Lost, false));
}

#[test]
fn inside_a_gap_nothing_is_tracking() {
    let r = samples(&[Tracking, Tracking, Coasting, Coasting, Tracking, Tracking]);
    // The frames themselves keep their state.
    assert_eq!([33, 132].map(|ms| state_at(&r, ms).0), [Tracking; 2]);
    assert_eq!([34, 66, 80, 99, 131].map(|ms| state_at(&r, ms).0), [Coasting; 5]);
    assert_eq!(state_at(&r, 140).0, Tracking);
    // Frames that never came leave a gap too.
    let mut r = samples(&[Tracking; 2]);
    r.push(at_ms(99), known(Tracking, 99));
    assert_eq!([40, 90].map(|ms| state_at(&r, ms).0), [Coasting; 2]);
    assert_eq!(state_at(&r, 110), (Tracking, true));
}

#[test]
fn no_pose_is_interpolated_across_a_loss_or_a_long_gap() {
    let mut r = samples(&[Tracking, Tracking, Lost]);
    r.push(at_ms(99), known(Tracking, 500));
    assert_eq!([34, 65, 66, 80].map(|ms| state_at(&r, ms).0), [Coasting, Coasting, Lost, Lost]);
    // A single sample gives no motion.
    assert_eq!(r.at(at_ms(110), FRAME).pose, Some(moving(500)));
    r.push(at_ms(500), known(Tracking, 500));
    assert_eq!(state_at(&r, 300), (Lost, false));
}

#[test]
fn a_late_tick_still_gets_the_pose_before_a_loss() {
    let mut r = samples(&[Tracking; 4]);
    r.push(at_ms(4 * 33), known(Lost, 0));
    assert_eq!(state_at(&r, 50), (Tracking, false));
    assert_eq!(state_at(&r, 140), (Lost, false));
}

#[test]
fn a_correction_of_a_prediction_is_not_motion() {
    let mut r = samples(&[Tracking, Tracking, Coasting]);
    // The prediction was 80 mm off: the first measurement after it is extrapolated with the motion
    // of the earlier measurements.
    r.push(at_ms(99), known(Tracking, 99 - 80));
    let carried = r.at(at_ms(119), FRAME).pose.unwrap().translation.x;
    let speed = (0.019 - 0.033) / 0.066;
    assert!((carried - (0.019 + 0.020 * speed)).abs() < 1e-9, "{carried}");
}

#[test]
fn two_frames_at_nearly_one_instant_show_no_speed() {
    let mut r = samples(&[Tracking; 2]);
    let pose = Pose::new(UnitQuaternion::identity(), Vector3::new(0.034, 0.0, 0.0));
    r.push(at_ms(34), Known { state: Tracking, pose: Some(pose), is_predicted: false });
    assert!((r.at(at_ms(60), FRAME).pose.unwrap().translation.x - 0.060).abs() < 1e-9);
}

#[test]
fn gaps_are_judged_by_the_cameras_own_interval() {
    for (hz, delay_ms) in [(5, 0), (240, 500), (1, 0)] {
        let (interval, delay) = (Duration::from_secs(1) / hz, Duration::from_millis(delay_ms));
        let mut r = Resampler::new(delay);
        for k in 0..hz + 3 {
            r.push(Timestamp::default().after(interval * k), known(Tracking, (interval * k).as_millis() as i64));
        }
        let newest = Timestamp::default().after(interval * (hz + 2));
        let near = r.at(newest.after(interval), interval);
        assert_eq!((near.state, near.is_predicted), (Tracking, true), "{hz}");
        assert_ne!(r.at(newest.after(interval * 5 / 4), interval).state, Tracking, "{hz}");
        assert_eq!(r.at(newest.before(delay + interval / 2), interval).state, Tracking, "{hz}");
    }
}
