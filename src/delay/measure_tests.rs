//! The delay of synthetic rigs with known truth: exact, noisy, with gaps, and undetermined.

use nalgebra::{UnitQuaternion, Vector3};

use super::judge::judge;
use super::measure::{Delay, Side, Undetermined, measure_delay};
use super::synthetic::{Filming, Path};
use super::turns::{Turn, Turns};
use crate::calibrate::judge::Verdict;

/// A tracker's noise, radians: 0.005 degrees.
const NOISE: f64 = 9e-5;
const RANGE_S: f64 = 2.0;

fn measured(first: &Filming, second: &Filming, path: &Path) -> Delay {
    measure_delay(&first.turns(path), &second.turns(path), RANGE_S).unwrap()
}

#[test]
fn delays_of_either_sign_are_found_at_any_pair_of_rates() {
    let mount = UnitQuaternion::from_scaled_axis(Vector3::new(0.2, -0.9, 0.4));
    for (k, (fps, other_fps)) in [(30.0, 25.0), (25.0, 30.0), (30.0, 30.0), (59.94, 23.976), (25.0, 200.0)].into_iter().enumerate() {
        for delay_s in [0.0073, 0.041, 0.118, -0.023, 0.0, -1.2] {
            let path = Path::panned(k as u64);
            let second = Filming { mount, ..Filming::new(other_fps, delay_s, NOISE, 2) };
            let delay = measured(&Filming::new(fps, 0.0, NOISE, 1), &second, &path);
            let error = delay.delay_s - delay_s;
            assert!(error.abs() < 4.0 * delay.sigma_s && delay.sigma_s < 4e-4, "{fps} {other_fps} {delay_s}: {error} {delay:?}");
            assert_eq!(judge(&delay), (Verdict::Good, vec![]), "{delay:?}");
            assert!((delay.gain - 1.0).abs() < 0.01, "{delay:?}");
            let rotation = delay.rotation.map(|r| r.angle_to(&mount).to_degrees());
            assert!(rotation.is_none_or(|degrees| degrees < 1.0), "{rotation:?} {delay:?}");
        }
    }
}

#[test]
fn the_rotation_between_the_cameras_is_found_if_the_rig_turns_about_two_axes() {
    let mount = UnitQuaternion::from_scaled_axis(Vector3::new(0.2, -0.9, 0.4));
    let path = Path::panned(1);
    let tilted = |filming: Filming| {
        let also = Path::swaying(9.0, 0.7);
        let quarter = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
        let rows = filming.orientations(&path).into_iter();
        let at = |t: crate::frame::Timestamp| t.seconds() - filming.delay_s;
        let rows = rows.map(|(t, q)| (t, quarter * also.at(at(t)) * quarter.inverse() * q)).collect::<Vec<_>>();
        Turns::of_orientations(crate::frame::Timestamp::default(), rows)
    };
    for swapped in [false, true] {
        let (first, second) = (tilted(Filming::new(30.0, 0.0, NOISE, 1)), tilted(Filming { mount, ..Filming::new(25.0, 0.05, NOISE, 2) }));
        let delay = if swapped { measure_delay(&second, &first, 2.0) } else { measure_delay(&first, &second, 2.0) }.unwrap();
        let truth = if swapped { mount.inverse() } else { mount };
        let off = delay.rotation.expect("two axes").angle_to(&truth).to_degrees();
        assert!(off < 0.3, "{off} {delay:?}");
    }
}

/// Squared errors over squared sigmas, averaged over rigs.
fn nees(of_rig: impl Fn(u64) -> (Turns, Turns), truth_s: f64) -> (f64, f64) {
    const RIGS: u64 = 60;
    let (mut sum, mut sigmas) = (0.0, 0.0);
    for rig in 0..RIGS {
        let (first, second) = of_rig(rig);
        let delay = measure_delay(&first, &second, RANGE_S).unwrap();
        sum += ((delay.delay_s - truth_s) / delay.sigma_s).powi(2);
        sigmas += delay.sigma_s;
    }
    (sum / RIGS as f64, sigmas / RIGS as f64)
}

#[test]
fn the_stated_sigma_matches_the_error() {
    let rig = |fps: f64, noise: f64, jitter_s: f64| {
        move |seed: u64| {
            let path = Path::panned(seed);
            let first = Filming { jitter_s, ..Filming::new(30.0, 0.0, noise, 2 * seed + 500) };
            let second = Filming { jitter_s, ..Filming::new(fps, 0.041, noise, 2 * seed + 501) };
            (first.turns(&path), second.turns(&path))
        }
    };
    let pictures = |seed: u64| {
        let path = Path::panned(seed);
        let second = Filming::new(25.0, 0.041, 10.0 * NOISE, 2 * seed + 701);
        (Filming::new(30.0, 0.0, NOISE, 2 * seed + 700).turns(&path), second.turns_of_pictures(&path, 1.1))
    };
    let cases: [(&str, (f64, f64)); 5] = [
        ("poses", nees(rig(25.0, 10.0 * NOISE, 0.0), 0.041)),
        // At equal rates, interpolation averages the noise of two frames at some delays only.
        ("equal rates", nees(rig(30.0, 10.0 * NOISE, 0.0), 0.041)),
        ("much noise", nees(rig(25.0, 60.0 * NOISE, 0.0), 0.041)),
        ("jitter", nees(rig(25.0, NOISE, 1e-3), 0.041)),
        ("pictures", nees(pictures, 0.041)),
    ];
    for (name, (nees, sigma_s)) in cases {
        println!("{name}: NEES {nees:.2}, sigma {:.3} ms", sigma_s * 1e3);
    }
    for (name, (nees, _)) in cases {
        // Four standard deviations of the mean of 60 squared normal numbers are 0.73.
        assert!((0.3..1.73).contains(&nees), "{name}: NEES {nees}");
    }
}

#[test]
fn another_lens_or_a_loose_mount_shows_in_the_gain_and_not_in_the_delay() {
    let path = Path::panned(11);
    let first = Filming::new(30.0, 0.0, NOISE, 1).turns(&path);
    for (gain, verdict) in [(1.1, Verdict::Good), (1.4, Verdict::Usable), (0.3, Verdict::DoNotUse)] {
        let second = Filming::new(25.0, 0.0073, NOISE, 2).turns_of_pictures(&path, gain);
        let delay = measure_delay(&first, &second, RANGE_S).unwrap();
        assert!((delay.delay_s - 0.0073).abs() < 4.0 * delay.sigma_s && (delay.gain / gain - 1.0).abs() < 0.01, "{delay:?}");
        let (judged, reasons) = judge(&delay);
        assert_eq!(judged, verdict, "{reasons:?}");
        assert!(verdict == Verdict::Good || reasons[0].contains("times as fast as the first"), "{reasons:?}");
    }
}

#[test]
fn a_periodic_motion_is_refused_and_its_other_delays_are_named() {
    let path = Path::swaying(15.0, 1.0);
    let delay = measured(&Filming::new(30.0, 0.0, NOISE, 1), &Filming::new(25.0, 0.041, NOISE, 2), &path);
    let (verdict, reasons) = judge(&delay);
    assert_eq!(verdict, Verdict::DoNotUse, "{delay:?}");
    let text = reasons.join("; ");
    assert!(text.contains("repeats itself"), "{text}");
    // Half a period later, the matrix reverses the motion.
    assert!(delay.rivals.iter().any(|rival| (rival.delay_s - delay.delay_s).abs() < 0.6), "{delay:?}");
}

#[test]
fn too_little_motion_is_refused() {
    let filming = |noise| [Filming::new(30.0, 0.0, noise, 1), Filming::new(25.0, 0.041, noise, 2)];
    let refused =
        |path: Path, [first, second]: [Filming; 2]| measure_delay(&first.turns(&path), &second.turns(&path), RANGE_S).unwrap_err();
    let still = refused(Path::panned(3).smaller(0.0), filming(NOISE));
    assert!(matches!(still, Undetermined::TooSlow { side: Side::First, deg_per_s } if deg_per_s < 1.0), "{still}");
    let slow = refused(Path::panned(3).smaller(0.05), filming(NOISE));
    assert!(matches!(slow, Undetermined::TooSlow { deg_per_s, .. } if deg_per_s < 5.0), "{slow}");
    // A second of motion is too short.
    let short = filming(NOISE).map(|filming| Filming { span_s: [1.0, 1.7], ..filming });
    assert!(matches!(refused(Path::panned(3), short), Undetermined::TooSlow { .. }));
    let few = filming(NOISE).map(|filming| Filming { fps: 6.0, span_s: [0.0, 3.0], ..filming });
    let few = refused(Path::panned(3), few);
    assert!(matches!(few, Undetermined::TooFew { found } if (10..24).contains(&found)), "{few}");
}

#[test]
fn a_steady_turn_determines_no_delay() {
    // Half a period of 40 seconds, close to its middle.
    let path = Path::swaying(170.0, 0.025);
    let filming = |fps, delay_s, seed| Filming { span_s: [36.0, 42.0], ..Filming::new(fps, delay_s, 5.0 * NOISE, seed) };
    let measured = measure_delay(&filming(30.0, 0.0, 1).turns(&path), &filming(25.0, 0.041, 2).turns(&path), RANGE_S);
    let is_refused = measured.as_ref().map_or(true, |delay| judge(delay).0 == Verdict::DoNotUse);
    assert!(is_refused, "{measured:?}");
}

#[test]
fn clips_that_have_nothing_in_common_are_refused() {
    let turns = |span_s, path: &Path| Filming { span_s, ..Filming::new(30.0, 0.0, NOISE, 1) }.turns(path);
    let first = turns([0.0, 6.0], &Path::panned(4));
    let apart = measure_delay(&first, &turns([20.0, 26.0], &Path::panned(4)), RANGE_S).unwrap_err();
    assert!(matches!(apart, Undetermined::Apart { .. }) && apart.to_string().contains("do not overlap"), "{apart}");
    let barely = measure_delay(&first, &turns([7.9, 14.0], &Path::panned(4)), RANGE_S).unwrap_err();
    assert!(matches!(barely, Undetermined::TooFew { .. }), "{barely}");
    let nothing = measure_delay(&first, &Turns::default(), RANGE_S).unwrap_err();
    assert_eq!(nothing, Undetermined::Nothing(Side::Second));
    // Another motion: refused at once, or by the verdict.
    let other = measure_delay(&first, &turns([0.0, 6.0], &Path::panned(5)), RANGE_S);
    assert!(other.as_ref().map_or(true, |delay| judge(delay).0 == Verdict::DoNotUse), "{other:?}");
    let beyond = Filming::new(30.0, 1.0, NOISE, 2).turns(&Path::panned(4));
    let beyond = measure_delay(&first, &beyond, 0.3);
    assert!(beyond.as_ref().map_or(true, |delay| judge(delay).0 == Verdict::DoNotUse), "{beyond:?}");
}

#[test]
fn lost_frames_and_wrong_poses_do_no_harm() {
    let path = Path::panned(6);
    let first = Filming { lost: 0.15, ..Filming::new(30.0, 0.0, NOISE, 1) }.turns(&path);
    let second = Filming { lost: 0.15, ..Filming::new(25.0, 0.118, NOISE, 2) };
    let lost = second.orientations(&path).len();
    assert!((100..145).contains(&lost), "{lost}");
    let delay = measure_delay(&first, &second.turns(&path), RANGE_S).unwrap();
    assert!((delay.delay_s - 0.118).abs() < 4.0 * delay.sigma_s && delay.sigma_s < 4e-4, "{delay:?}");
    let mut rows = Filming::new(25.0, 0.118, NOISE, 2).orientations(&path);
    for k in [20, 70, 71] {
        rows[k].1 *= UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, -0.1));
    }
    let wrong = Turns::of_orientations(crate::frame::Timestamp::default(), rows);
    let delay = measure_delay(&first, &wrong, RANGE_S).unwrap();
    assert!((2..=12).contains(&delay.left_out), "{delay:?}");
    assert!((delay.delay_s - 0.118).abs() < 4.0 * delay.sigma_s && delay.sigma_s < 6e-4, "{delay:?}");
}

#[test]
fn stamps_made_from_a_wrong_frame_rate_are_named() {
    let path = Path::panned(8);
    let first = Filming::new(30.0, 0.0, NOISE, 1).turns(&path);
    let second = Filming::new(25.0, 0.02, NOISE, 2).turns(&path);
    // 25 in place of 24.9 frames per second.
    let drifting = |turn: &Turn| Turn { from_s: turn.from_s * 0.996, to_s: turn.to_s * 0.996, ..*turn };
    let second = Turns::new(second.as_slice().iter().map(drifting).collect::<Vec<_>>());
    let (verdict, reasons) = judge(&measure_delay(&first, &second, RANGE_S).unwrap());
    assert_ne!(verdict, Verdict::Good);
    assert!(reasons.iter().any(|reason| reason.contains("the delay changes by -1")), "{reasons:?}");
}
