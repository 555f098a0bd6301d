use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::camera::{Intrinsics, Shutter};
use crate::geometry::bspline::BicubicSpline;
use crate::geometry::resection::{MovingCamera, Observation, resect};
use crate::track::patches::row_motion::RowMotion;
use crate::track::scene::shape::tests::folds;
use crate::track::scene::shape::{BentShape, SurfaceShape};
use crate::track::scene::surface::SurfaceSpec;
use crate::track::synthetic::{cloth, facing, lens, prepared, seen_anchors};

const NOISE_PX: f64 = 0.02;

/// A cloth and two flats before it.
fn set() -> Vec<SurfaceSpec> {
    let flat = |seed: u32, place: Vector3<f64>, rotation: f64| {
        let mut flat = cloth(seed);
        flat.pose = Pose::new(UnitQuaternion::from_euler_angles(0.0, rotation, 0.0), place);
        flat.size_m = [1.2, 0.9];
        flat
    };
    vec![cloth(1), flat(2, Vector3::new(0.9, 0.3, 0.9), 0.4), flat(3, Vector3::new(-1.0, -0.4, 0.6), -0.3)]
}

/// Studies a walk past the `real` stage through the `real_lens`, tracked with the `configured`
/// stage.
fn misfits(configured: Vec<SurfaceSpec>, real: Vec<SurfaceSpec>, real_lens: &CameraModel) -> Vec<Misfit> {
    walk(configured, real, real_lens, [0.0; 4]).0
}

/// The same, with the root mean square pose error, mm.
fn walk(configured: Vec<SurfaceSpec>, real: Vec<SurfaceSpec>, real_lens: &CameraModel, askew: [f64; 4]) -> (Vec<Misfit>, f64) {
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let (configured, real, configured_lens) = (prepared(configured), prepared(real), lens(640, 480));
    let mut study = ModelStudy::new(configured.surfaces.len(), 14);
    let mut squared_m2 = 0.0;
    for k in 0..14 {
        let (rotation, tilt) = (0.09 * f64::from(k) - 0.6, 0.12 * f64::from(k % 4) - 0.18);
        let start = facing(tilt, rotation, Vector3::new(0.4 * rotation, 0.1 * tilt, 4.3 + 0.15 * f64::from(k % 5)));
        let noise = |_, _| Vector2::from_fn(|_, _| (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>() * NOISE_PX);
        let mut anchors = seen_anchors(&real, &start, real_lens, 8, noise);
        for a in &mut anchors {
            let spec = &configured.surfaces[a.surface as usize].spec;
            let at = spec.to_metres(a.artwork);
            let moved: Vector2<f64> = moved_by_corners(spec.size_m, at).iter().zip(askew).map(|(by, number)| by * number).sum();
            a.artwork = spec.to_artwork(at - moved);
            a.observation.point = spec.body_point(a.artwork);
            a.observation.information /= NOISE_PX.powi(2);
        }
        let observations: Vec<Observation> = anchors.iter().map(|a| a.observation).collect();
        let pose = resect(&start, &MovingCamera::still(&configured_lens), &observations, 30).expect("a pose").pose;
        squared_m2 += (pose.inverse().translation - start.inverse().translation).norm_squared();
        let mut residuals = TileResiduals::default();
        residuals.take(&pose, &configured_lens, &anchors).expect("tiles enough");
        let rows = RowMotion { shutter: Shutter::default(), readout_sigma_s: 0.02, before: Some((pose, 0.03, None)) };
        let rows = RowDisplacement::new(&configured_lens, &rows, &pose);
        study.add(&StudiedFrame { residuals: &residuals, pose: &pose, anchors: &anchors, rows: &rows }, &configured);
    }
    (study.misfits(&configured, &configured_lens), 1e3 * (squared_m2 / 14.0_f64).sqrt())
}

#[test]
fn a_correctly_configured_stage_has_no_misfit() {
    assert_eq!(misfits(set(), set(), &lens(640, 480)), []);
    assert_eq!(misfits(vec![cloth(1)], vec![cloth(1)], &lens(640, 480)), []);
}

#[test]
fn a_wrong_lens_is_reported_with_its_numbers() {
    let i = *lens(640, 480).intrinsics();
    let real = CameraModel::new(Intrinsics { fx: 1.02 * i.fx, fy: 1.02 * i.fy, cx: i.cx + 6.0, cy: i.cy - 4.0, ..i }).unwrap();
    for stage in [vec![cloth(1)], set()] {
        let found = misfits(stage.clone(), stage, &real);
        let Some(Misfit { part: Part::Lens { focal_percent, centre_px: [x, y], radial, farthest_px }, share, .. }) = found.first().copied()
        else {
            panic!("{found:?}")
        };
        assert!(found.len() == 1 && (focal_percent - 2.0).abs() < 0.3 && (x - 6.0).abs() < 1.5 && (y + 4.0).abs() < 1.5, "{found:?}");
        assert!(radial.abs() < 0.01 && (5.0..20.0).contains(&farthest_px) && share > 0.9, "{found:?}");
    }
}

#[test]
fn the_cost_of_a_misfit_is_its_pose_error() {
    let i = *lens(640, 480).intrinsics();
    let zoomed = CameraModel::new(Intrinsics { fx: 1.01 * i.fx, fy: 1.01 * i.fy, ..i }).unwrap();
    let mut stretched = vec![cloth(1)];
    stretched[0].size_m[0] *= 1.006;
    for (real, lens) in [(vec![cloth(1)], &zoomed), (stretched, &lens(640, 480))] {
        let (found, off_mm) = walk(vec![cloth(1)], real, lens, [0.0; 4]);
        let [Misfit { cost_mm, .. }] = found[..] else { panic!("{found:?}") };
        assert!((cost_mm / off_mm - 1.0).abs() < 0.2, "{found:?}: {off_mm}");
    }
}

#[test]
fn a_missing_distortion_is_the_lens() {
    let i = *lens(640, 480).intrinsics();
    let bent = CameraModel::new(Intrinsics { distortion: [-0.2, 0.05, 0.0005, -0.0003, 0.0], ..i }).unwrap();
    let found = misfits(vec![cloth(1)], vec![cloth(1)], &bent);
    assert!(matches!(found[..], [Misfit { part: Part::Lens { radial, .. }, .. }] if (radial + 0.1).abs() < 0.02), "{found:?}");
}

#[test]
fn a_misplaced_flat_is_reported_with_its_offset() {
    let mut moved = set();
    moved[2].pose.translation += Vector3::new(0.006, -0.004, 0.012);
    let found = misfits(set(), moved, &lens(640, 480));
    let [Misfit { part: Part::Place { surface: 2, moved_mm: [x, y, z], rotation_deg }, .. }] = found[..] else { panic!("{found:?}") };
    assert!((x - 6.0).abs() < 0.3 && (y + 4.0).abs() < 0.3 && (z - 12.0).abs() < 0.6 && rotation_deg < 0.05, "{found:?}");
}

#[test]
fn between_two_surfaces_the_second_is_reported_as_moved() {
    let two = || set()[..2].to_vec();
    let mut moved = two();
    moved[1].pose = Pose::new(UnitQuaternion::from_euler_angles(0.0, 0.41, 0.0), moved[1].pose.translation + Vector3::new(0.0, 0.01, 0.0));
    let found = misfits(two(), moved, &lens(640, 480));
    assert!(
        matches!(found[..], [Misfit { part: Part::Place { surface: 1, rotation_deg, .. }, .. }] if (rotation_deg - 0.57).abs() < 0.1),
        "{found:?}"
    );
}

#[test]
fn a_stretched_print_is_reported_with_its_ratio() {
    for (stage, k) in [(vec![cloth(1)], 0), (set(), 1)] {
        let mut real = stage.clone();
        real[k].size_m[0] *= 1.006;
        let found = misfits(stage, real, &lens(640, 480));
        let [Misfit { part: Part::Ratio { surface, wider_percent }, .. }] = found[..] else { panic!("{found:?}") };
        assert!(surface == k && (wider_percent - 0.6).abs() < 0.05, "{found:?}");
    }
}

#[test]
fn a_skewed_picture_is_reported_with_its_corners() {
    // Sheared by 0.3 %, with keystones of 0.2 %: the worst corner is off by 4.5 + 7 mm across and 3
    // + 3 mm up.
    let (found, _) = walk(vec![cloth(1)], vec![cloth(1)], &lens(640, 480), [0.0, 0.003, 0.002, 0.002]);
    let [Misfit { part: Part::Corners { surface: 0, most_px, most_mm }, .. }] = found[..] else { panic!("{found:?}") };
    assert!((9.0..18.0).contains(&most_mm) && (most_px / most_mm - 0.16).abs() < 0.01, "{found:?}");
}

#[test]
fn folds_are_reported_with_their_height() {
    let mut bent = vec![cloth(1)];
    // Without the stretch of these folds, which is a different cause.
    let SurfaceShape::Bent(shape) = folds() else { unreachable!("folds are bent") };
    let stretch = BicubicSpline::zero([1, 1], bent[0].size_m);
    bent[0].shape = SurfaceShape::Bent(Arc::new(BentShape { stretch, ..(*shape).clone() }));
    let found = misfits(vec![cloth(1)], bent, &lens(640, 480));
    let Some(Misfit { part: Part::Shape { surface: 0, rms_mm, most_mm }, .. }) = found.first().copied() else { panic!("{found:?}") };
    assert!((4.0..14.0).contains(&rms_mm) && most_mm > 1.5 * rms_mm, "{found:?}");
}
