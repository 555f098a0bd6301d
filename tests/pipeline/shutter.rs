//! A rolling shutter on a shaking hand-held camera.

use stagepose::{Shake, State};

use super::scene::{backdrop, camera, errors, nees_per_freedom, past, quiet, rows, setup, track_rows};

#[test]
fn a_known_readout_reduces_the_scatter() {
    let mut path = past();
    path.shake = Some(Shake::new(0.01, 0.012, 4.0, 5));
    let mut scene = quiet(camera(640, 360), path, backdrop());
    scene.shutter.readout_s = 0.02;
    let rows = rows(&scene, 14);
    let scatter = |readout_s: f64| {
        let mut told = setup(&scene);
        told.shutter.readout_s = Some(readout_s);
        let samples = track_rows(told, &rows);
        // The motion is known from the second frame on, its change from the third.
        let squares: Vec<f64> =
            samples.iter().skip(3).filter(|s| s.state == State::Tracking).map(|s| errors(&scene, s).0.powi(2)).collect();
        (squares.len(), (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt())
    };
    let ((known, with), (_, without)) = (scatter(scene.shutter.readout_s), scatter(0.0));
    println!("rms share of the distance: {with:.5} with the readout, {without:.5} without");
    assert_eq!(known, 11);
    assert!(with < 0.3 * without && with < 0.002, "{with} {without}");
}

#[test]
fn a_shaken_camera_with_an_unconfigured_shutter_is_followed() {
    for seed in [3, 7] {
        let mut path = past();
        path.shake = Some(Shake::new(0.015, 0.02, 5.0, seed));
        let mut scene = quiet(camera(640, 360), path, backdrop());
        scene.shutter.readout_s = 0.015;
        let rows = rows(&scene, 30);
        let mut told = setup(&scene);
        told.shutter.readout_s = None;
        let samples = track_rows(told, &rows);
        let given = samples.iter().filter(|s| s.state == State::Tracking).count();
        let reasons: Vec<_> = samples.iter().filter_map(|s| s.reason).collect();
        println!("shake {seed}: {given} of 30 given, {reasons:?}");
        // Now and then the rows are displaced as if the lens had moved.
        assert!(given >= 27, "shake {seed}: {given} of 30 given, {reasons:?}");
    }
}

#[test]
fn a_readout_that_is_not_configured_is_learnt() {
    for (readout_s, seed) in [(0.02, 3), (0.0, 5)] {
        let mut path = past();
        path.shake = Some(Shake::new(0.015, 0.02, 5.0, seed));
        let mut scene = quiet(camera(640, 360), path, backdrop());
        scene.shutter.readout_s = readout_s;
        let rows = rows(&scene, 60);
        let mut told = setup(&scene);
        told.shutter.readout_s = None;
        let samples = track_rows(told, &rows);
        let learnt = samples[59].learnt.readout.expect("a readout that was learnt");
        assert!((learnt.seconds - readout_s).abs() < (3.0 * learnt.sigma_s).min(1e-3), "{readout_s}: {learnt:?}");
        assert!(samples[0].learnt.readout.is_none());
        // Until the readout is known, the covariance includes it: hardly any frame is off by more
        // than 4 sigma.
        let wrong = samples.iter().filter(|s| {
            s.measurement.as_ref().is_some_and(|m| {
                let sigma_m = m.covariance.fixed_view::<3, 3>(0, 0).trace().sqrt();
                errors(&scene, s).0 * m.pose.translation.norm() > 4.0 * sigma_m
            })
        });
        assert!(wrong.count() <= 2, "{readout_s}");
    }
}

/// A NEES beyond 9 per degree of freedom is overconfident, as `../shared/bench/malice` counts it.
const MAX_NEES: f64 = 9.0;

/// The prediction for the first tracked frame is zero velocity, whatever the camera does.
#[test]
fn first_poses_include_the_unknown_readout_in_their_sigma() {
    for seed in [3, 5, 7, 9, 11] {
        let mut path = past();
        path.shake = Some(Shake::new(0.015, 0.02, 5.0, seed));
        let mut scene = quiet(camera(640, 360), path, backdrop());
        scene.shutter.readout_s = 0.02;
        let mut setup = setup(&scene);
        setup.shutter.readout_s = None;
        let samples = track_rows(setup, &rows(&scene, 8));
        let nees: Vec<f64> = samples.iter().filter(|s| s.measurement.is_some()).map(|s| nees_per_freedom(&scene, s)).collect();
        println!("shake {seed}: NEES per freedom {nees:.2?}");
        assert!(nees.len() >= 6 && nees.iter().all(|n| *n < MAX_NEES), "shake {seed}: {nees:.2?}");
    }
}
