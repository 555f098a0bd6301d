use nalgebra::Vector3;
use proptest::prelude::*;

use super::*;

const FRAME_NS: i64 = 33_333_333;

fn frame(number: i64) -> Timestamp {
    Timestamp::from_ns(number * FRAME_NS)
}

fn at(x: f64, rotation: f64) -> Pose<Stage, Body> {
    Pose::new(UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rotation), Vector3::new(x, 0.0, 0.0))
}

fn limits() -> SafetySettings {
    SafetySettings {
        max_speed_m_s: Some(3.0),
        max_angular_speed_rad_s: Some(2.0),
        permitted_box_m: Some([[-2.0, -2.0, -2.0], [2.0, 2.0, 2.0]]),
        ..SafetySettings::default()
    }
}

fn with_blend() -> SafetySettings {
    SafetySettings { blend: Some(BlendRates { speed_m_s: 0.5, angular_speed_rad_s: 0.4 }), ..limits() }
}

#[test]
fn without_limits_every_finite_pose_passes_as_it_is() {
    let mut limiter = Limiter::new(SafetySettings::default());
    for (k, x) in [0.0, 50.0, -1e6].into_iter().enumerate() {
        assert_eq!(limiter.judge(Timestamp::from_ns(k as i64), &at(x, x)), Verdict::Pass(at(x, x)));
    }
    let bad = Pose::new(UnitQuaternion::identity(), Vector3::new(0.0, f64::NAN, 0.0));
    assert_eq!(limiter.judge(Timestamp::from_ns(9), &bad), Verdict::Withhold(Withheld::NotFinite));
}

#[test]
fn poses_outside_the_box_or_too_fast_are_withheld() {
    let mut limiter = Limiter::new(limits());
    assert!(matches!(limiter.judge(frame(0), &at(1.9, 0.0)), Verdict::Pass(_)));
    assert_eq!(limiter.judge(frame(1), &at(2.01, 0.0)), Verdict::Withhold(Withheld::OutsideBox));
    assert!(matches!(limiter.judge(frame(2), &at(1.99, 0.0)), Verdict::Pass(_)));
    assert_eq!(limiter.judge(frame(3), &at(1.0, 0.0)), Verdict::Withhold(Withheld::TooFast));
    assert_eq!(limiter.judge(frame(4), &at(1.95, 0.5)), Verdict::Withhold(Withheld::RotatesTooFast));
    // 0.99 m from the last pose sent takes 0.33 s at 3 m/s.
    assert_eq!(limiter.judge(frame(11), &at(1.0, 0.0)), Verdict::Withhold(Withheld::TooFast));
    assert!(matches!(limiter.judge(frame(12), &at(1.0, 0.0)), Verdict::Pass(_)));
}

#[test]
fn default_limits_pass_a_whip_pan_but_not_a_jump_to_a_copy() {
    // 690 degrees and 12 m per second, the fastest that two frames may confirm each other; a spun
    // prop; and a camera at 240 frames per second with 5 mm of noise.
    for (dt_ns, way, rotation) in [(FRAME_NS, 12.0 / 30.0, 12.0 / 30.0), (16_666_667, 0.0, 0.28), (4_166_667, 0.005, 0.0)] {
        let mut limiter = Limiter::new(SafetySettings::usual());
        for k in 0..20 {
            let to = at(way * k as f64, rotation * k as f64);
            assert_eq!(limiter.judge(Timestamp::from_ns(k * dt_ns), &to), Verdict::Pass(to));
        }
    }
    let mut limiter = Limiter::new(SafetySettings::usual());
    limiter.judge(frame(0), &at(0.0, 0.0));
    assert_eq!(limiter.judge(frame(1), &at(6.5, 0.0)), Verdict::Withhold(Withheld::TooFast));
    assert_eq!(limiter.judge(frame(2), &at(0.0, 1.5)), Verdict::Withhold(Withheld::RotatesTooFast));
    assert_eq!(limiter.judge(frame(3), &at(0.1, 0.0)), Verdict::Pass(at(0.1, 0.0)));
}

#[test]
fn after_a_gap_the_output_blends_from_its_last_pose() {
    let mut limiter = Limiter::new(with_blend());
    limiter.judge(frame(0), &at(0.0, 0.0));
    limiter.gap();
    assert_eq!(limiter.judge(frame(30), &at(1.0, 0.2)), Verdict::Blend(at(0.0, 0.0)));
    let verdicts: Vec<_> = (31..100).map(|k| limiter.judge(frame(k), &at(1.0, 0.2))).collect();
    assert!(matches!(verdicts[0], Verdict::Blend(p) if (p.translation.x - 0.5 * 0.033_333_333).abs() < 1e-9));
    let arrived = verdicts.iter().position(|v| *v == Verdict::Pass(at(1.0, 0.2))).unwrap();
    // 1 m at 0.5 m/s.
    assert!((59..=61).contains(&arrived), "{arrived}");
}

#[test]
fn a_pose_in_every_second_frame_still_completes_the_blend() {
    let mut limiter = Limiter::new(with_blend());
    limiter.judge(frame(0), &at(0.0, 0.0));
    limiter.gap();
    let arrived = (1..100).find(|k| {
        limiter.gap();
        limiter.judge(frame(2 * k), &at(0.5, 0.1)) == Verdict::Pass(at(0.5, 0.1))
    });
    // Half a metre at 0.5 m/s takes 15 times two frames, after the first, which stands still.
    assert!(arrived.is_some_and(|k| (15..=17).contains(&k)), "{arrived:?}");
}

/// Frames: whether the pose is known, its position, its rotation, and the step in frames.
fn steps() -> impl Strategy<Value = Vec<(bool, f64, f64, u32)>> {
    // Sometimes a non-finite or absurd number.
    let x = prop_oneof![20 => -3.0..3.0, 1 => Just(f64::NAN), 1 => Just(f64::INFINITY), 1 => Just(1e12)];
    prop::collection::vec((any::<bool>(), x, -3.0..3.0, 1_u32..8), 1..80)
}

proptest! {
    /// Whatever the input and the blend rates, no step that is sent is faster than the limits.
    #[test]
    fn no_output_step_exceeds_the_limits(steps in steps(), speed_m_s in 0.1..20.0, angular_speed_rad_s in 0.1..20.0) {
        let blend = Some(BlendRates { speed_m_s, angular_speed_rad_s });
        let mut limiter = Limiter::new(SafetySettings { blend, ..limits() });
        let mut now = Timestamp::default();
        let mut last: Option<(Timestamp, Pose<Stage, Body>)> = None;
        for (is_known, x, rotation, frames) in steps {
            now = now.after_ns(FRAME_NS * i64::from(frames));
            if !is_known {
                limiter.gap();
                continue;
            }
            if let Verdict::Pass(p) | Verdict::Blend(p) = limiter.judge(now, &at(x, rotation)) {
                if let Some((then, before)) = last {
                    let dt = now.seconds_since(then);
                    prop_assert!((p.translation - before.translation).norm() <= 3.0 * dt + 1e-6);
                    prop_assert!(p.angle_to(&before) <= 2.0 * dt + 1e-6);
                }
                prop_assert!(p.translation.x.abs() <= 2.0);
                last = Some((now, p));
            }
        }
    }
}
