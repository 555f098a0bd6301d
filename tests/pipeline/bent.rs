//! Cloth that hangs in folds or moves in a draught: tracked with its shape, or without it and with
//! an honest covariance.

use std::sync::Arc;

use nalgebra::{Vector1, Vector3};
use stagepose::diagnostics::geometry::BicubicSpline;
use stagepose::diagnostics::track::{BentShape, SurfaceShape};
use stagepose::{CameraPath, Draught, PoseSample, Spline, State, VirtualStage, Wave};

use super::scene::{backdrop, camera, nees_per_freedom, quiet, rows, setup, track, track_rows, truth_of};

const FRAMES: u64 = 12;

/// A camera that moves past the cloth from one side to the other.
fn across() -> CameraPath {
    let keys = [(-0.5, [-1.9, -3.1, 0.3]), (0.2, [0.2, -3.4, 0.1]), (0.9, [1.8, -3.0, 0.4])].map(|(t, p)| (t, Vector3::from(p)));
    let targets = [(-0.5, Vector3::new(-0.1, 0.0, 0.0)), (0.9, Vector3::new(0.1, 0.0, 0.1))];
    CameraPath { position: Spline::new(&keys).unwrap(), target: Spline::new(&targets).unwrap(), roll_rad: 0.02, shake: None }
}

/// Folds of 12 mm, half a metre wide, as a survey would find them.
fn folds() -> SurfaceShape {
    let size_m = [4.0, 3.0];
    let mut height = BicubicSpline::zero([20, 15], size_m);
    for (k, c) in height.coefficients_mut().iter_mut().enumerate() {
        let (i, j) = ((k % 23) as f64, (k / 23) as f64);
        *c = Vector1::new(0.012 * (1.3 * i + 0.2 * j).sin() + 0.006 * (0.5 * j - 0.1 * i).cos());
    }
    SurfaceShape::Bent(Arc::new(BentShape { height, stretch: BicubicSpline::zero([2, 2], size_m), ways: Vec::new() }))
}

/// Waves with this height in metres: two that stand still, and one that moves at this rate.
fn waves(height_m: f64, rate_hz: f64) -> Vec<Wave> {
    let wave = |wave_vector, rate_hz, phase_rad| Wave { height_m, wave_vector, rate_hz, phase_rad };
    vec![wave([4.4, 0.4], 0.0, 0.9), wave([9.0, -0.8], 0.0, 2.1), wave([3.2, 1.0], rate_hz, 0.2)]
}

fn hung(change: impl FnOnce(&mut VirtualStage)) -> VirtualStage {
    let mut scene = quiet(camera(480, 270), across(), backdrop());
    change(&mut scene);
    scene
}

/// Returns how many frames are tracked, their mean NEES over 6, and the median error, mm.
fn scored(scene: &VirtualStage, samples: &[PoseSample]) -> (usize, f64, f64) {
    let tracked: Vec<&PoseSample> = samples.iter().filter(|s| s.state == State::Tracking).collect();
    let nees = tracked.iter().map(|s| nees_per_freedom(scene, s)).sum::<f64>() / tracked.len().max(1) as f64;
    let off = |s: &&PoseSample| 1e3 * (truth_of(scene, s).translation - s.measurement.expect("it tracks").pose.translation).norm();
    let mut off: Vec<f64> = tracked.iter().map(off).collect();
    off.sort_by(f64::total_cmp);
    (tracked.len(), nees, off.get(off.len() / 2).copied().unwrap_or(f64::NAN))
}

#[test]
fn a_cloth_with_a_configured_shape_tracks_like_a_flat_one() {
    let flat = hung(|_| {});
    let (_, _, flat_mm) = scored(&flat, &track(&flat, FRAMES));
    let bent = hung(|scene| scene.stage.surfaces[0].shape = folds());
    let (count, nees, bent_mm) = scored(&bent, &track(&bent, FRAMES));
    println!("{count} of {FRAMES}, {bent_mm:.3} mm, NEES / 6 {nees:.2}; flat {flat_mm:.3} mm");
    assert!(count >= 11 && bent_mm < 2.0 * flat_mm && nees < 3.0, "{count} {bent_mm} {nees}");
    // The same pictures with a flat stage configured: the folds do matter.
    let mut told = setup(&bent);
    told.stage = backdrop();
    let (_, _, unsurveyed_mm) = scored(&bent, &track_rows(told, &rows(&bent, FRAMES)));
    assert!(unsurveyed_mm > 10.0 * bent_mm, "{unsurveyed_mm} {bent_mm}");
}

#[test]
fn unconfigured_folds_and_draughts_are_in_the_covariance() {
    for (height_m, rate_hz) in [(0.008, 0.0), (0.006, 0.4)] {
        let scene = hung(|scene| scene.draughts = vec![Draught { surface: 0, waves: waves(height_m, rate_hz) }]);
        let (count, nees, mm) = scored(&scene, &track(&scene, FRAMES));
        println!("{height_m} m, {rate_hz} Hz: {count} of {FRAMES}, {mm:.2} mm, NEES / 6 {nees:.2}");
        assert!(count >= 10 && mm > 1.0 && nees < 5.0, "{count} {mm} {nees}");
    }
}
