//! The estimation on simulated corners: it recovers the truth, and the uncertainties are correct.

use nalgebra::UnitQuaternion;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::adjust::BoardFrame;
use super::lens::{FreeNumbers, LENS_NAMES, Lens, LensVector};
use super::*;
use crate::calibrate::board::Board;
use crate::geometry::{Camera, Pose};

const SIZE: (u32, u32) = (640, 480);

fn truth() -> Lens {
    Lens(LensVector::from([560.0, 555.0, 322.0, 236.0, 0.0, -0.28, 0.12, 0.0008, -0.0006, 0.0]))
}

/// Views of a board tilted to all sides; `tilt` scales the tilts of about 30 degrees.
fn poses(count: usize, tilt: f64, random: &mut Pcg64Mcg) -> Vec<Pose<Camera, BoardFrame>> {
    let one = |k: usize, random: &mut Pcg64Mcg| {
        let mut between = |a: f64, b: f64| a + (b - a) * random.random::<f64>();
        let azimuth = 2.4 * k as f64;
        let axis = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * tilt * between(0.35, 0.7);
        let rotation = UnitQuaternion::from_scaled_axis(axis) * UnitQuaternion::from_scaled_axis(Vector3::z() * between(-0.4, 0.4));
        let middle = rotation * Vector3::new(0.1, 0.0625, 0.0);
        Pose::new(rotation, Vector3::new(between(-0.08, 0.08), between(-0.05, 0.05), between(0.32, 0.5)) - middle)
    };
    (0..count).map(|k| one(k, random)).collect()
}

fn corners(lens: &Lens, poses: &[Pose<Camera, BoardFrame>], noise_px: f64, random: &mut Pcg64Mcg) -> Vec<Vec<Observation>> {
    let board = Board::new(9, 6, 0.025).unwrap();
    let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
    let mut view = |pose: &Pose<Camera, BoardFrame>| {
        (0..board.corner_count())
            .map(|k| {
                let board_m = board.corner(k);
                let p = pose.rotation * board_m.push(0.0) + pose.translation;
                let exact = lens.project(p.xy() / p.z);
                Observation { board_m, pixel: exact + Vector2::new(normal(), normal()) * noise_px }
            })
            .collect::<Vec<_>>()
    };
    poses.iter().map(&mut view).collect()
}

#[test]
fn exact_corners_give_the_exact_lens() {
    let mut random = Pcg64Mcg::seed_from_u64(3);
    let poses = poses(8, 1.0, &mut random);
    let views = corners(&truth(), &poses, 0.0, &mut random);
    let made = estimate(&views, SIZE, &SolveOptions::default()).unwrap();
    assert!((made.bundle.lens.0 - truth().0).amax() < 1e-5, "{}", made.bundle.lens.0 - truth().0);
    assert!(made.rms_px < 1e-6);
    for (pose, truth) in made.bundle.poses.iter().zip(&poses) {
        assert!(pose.angle_to(truth) < 1e-7 && (pose.translation - truth.translation).norm() < 1e-7);
    }
}

#[test]
fn skew_and_k3_are_recovered_when_freed() {
    let mut random = Pcg64Mcg::seed_from_u64(4);
    let mut lens = truth();
    (lens.0[4], lens.0[9]) = (0.003, -0.05);
    let poses = poses(10, 1.0, &mut random);
    let views = corners(&lens, &poses, 0.0, &mut random);
    let free = FreeNumbers { free: [true; 10], square_pixels: false };
    let made = estimate(&views, SIZE, &SolveOptions { free, ..SolveOptions::default() }).unwrap();
    assert!((made.bundle.lens.0 - lens.0).amax() < 1e-4, "{}", made.bundle.lens.0 - lens.0);
}

#[test]
fn held_parameters_stay_and_square_pixels_stay_square() {
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let views = corners(&truth(), &poses(8, 1.0, &mut random), 0.1, &mut random);
    let mut options = SolveOptions::default();
    options.free.square_pixels = true;
    (options.free.free[2], options.held[2]) = (false, Some(322.0));
    options.free.free[7] = false;
    let made = estimate(&views, SIZE, &options).unwrap();
    let (n, u) = (made.bundle.lens.0, made.lens_uncertainty());
    assert_eq!((n[0] - n[1], n[2], n[7], u[2], u[7]), (0.0, 322.0, 0.0, 0.0, 0.0));
    assert!(u[0] > 0.0 && u[0] == u[1]);
}

/// 200 sets of noisy corners: 3 sigma holds in at least 97 %, and errors over sigma have an rms
/// near 1, for the lens and for the poses.
#[test]
fn uncertainties_are_right() {
    let mut random = Pcg64Mcg::seed_from_u64(6);
    let poses = poses(10, 1.0, &mut random);
    let runs = 200;
    let (mut squares, mut inside) = ([0.0; 9], [0; 9]);
    let (mut pose_squares, mut pose_inside) = (0.0, 0);
    for _ in 0..runs {
        let views = corners(&truth(), &poses, 0.15, &mut random);
        let made = estimate(&views, SIZE, &SolveOptions::default()).unwrap();
        let three_sigma = made.lens_uncertainty();
        for k in (0..9).filter(|&k| k != 4) {
            let error = made.bundle.lens.0[k] - truth().0[k];
            squares[k] += (3.0 * error / three_sigma[k]).powi(2);
            inside[k] += usize::from(error.abs() <= three_sigma[k]);
        }
        let view = made.extrinsics(0);
        let rotated = view.rotation_vector - poses[0].rotation.scaled_axis();
        let moved = view.translation_m - poses[0].translation;
        let pairs = [(rotated, view.rotation_uncertainty), (moved, view.translation_uncertainty_m)];
        for (error, sigma) in pairs.iter().flat_map(|(e, s)| e.iter().zip(s.iter())) {
            pose_squares += (3.0 * error / sigma).powi(2);
            pose_inside += usize::from(error.abs() <= *sigma);
        }
    }
    for k in (0..9).filter(|&k| k != 4) {
        let rms = (squares[k] / f64::from(runs)).sqrt();
        println!(
            "{}: rms of the normalised error {rms:.3}, inside 3 sigma {:.1} %",
            LENS_NAMES[k],
            100.0 * inside[k] as f64 / f64::from(runs)
        );
        assert!((0.8..1.25).contains(&rms), "{}: normalised error {rms:.3}", LENS_NAMES[k]);
        assert!(inside[k] * 100 >= 97 * runs as usize, "{}: {} of {runs} inside", LENS_NAMES[k], inside[k]);
    }
    let rms = (pose_squares / f64::from(6 * runs)).sqrt();
    println!("a view's pose: {rms:.3}, {:.1} %", 100.0 * pose_inside as f64 / f64::from(6 * runs));
    assert!((0.8..1.25).contains(&rms), "poses: normalised error {rms:.3}");
    assert!(pose_inside * 100 >= 97 * 6 * runs as usize, "poses: {pose_inside} of {} inside", 6 * runs);
}

#[test]
fn outlier_corners_are_rejected_and_change_little() {
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let mut views = corners(&truth(), &poses(10, 1.0, &mut random), 0.1, &mut random);
    let clean = estimate(&views, SIZE, &SolveOptions::default()).unwrap();
    for (v, view) in views.iter_mut().enumerate() {
        view[7 * v % 54].pixel += Vector2::new(4.0, -3.0);
    }
    let made = estimate(&views, SIZE, &SolveOptions::default()).unwrap();
    for (v, used) in made.used.iter().enumerate() {
        assert!(!used[7 * v % 54], "view {v}");
    }
    assert!((made.bundle.lens.0[0] - clean.bundle.lens.0[0]).abs() < 0.2 * made.lens_uncertainty()[0]);
    let plain = estimate(&views, SIZE, &SolveOptions { bouguet: true, ..SolveOptions::default() }).unwrap();
    assert!(plain.used.iter().flatten().all(|used| *used) && plain.rms_px > 3.0 * made.rms_px);
}

#[test]
fn views_that_do_not_determine_the_lens_are_refused() {
    let mut random = Pcg64Mcg::seed_from_u64(8);
    let views = corners(&truth(), &poses(2, 1.0, &mut random), 0.1, &mut random);
    assert!(estimate(&views, SIZE, &SolveOptions::default()).is_none());
}
