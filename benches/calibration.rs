//! Calibration on one thread: finding a board in pictures of 640 x 480 and larger, and solving 25
//! views of 156 corners.
//!
//! `cargo bench --bench calibration`

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use stagepose::diagnostics::calibrate::{Board, BoardFrame, Observation, SolveOptions, estimate, find_board};
use stagepose::{Camera, CameraModel, Intrinsics, Pose};

#[path = "../tests/calibrate/rendered.rs"]
mod rendered;
use rendered::{BoardPhotographer, Photograph};

/// A 4:3 camera of this width.
fn camera(width: u32) -> BoardPhotographer {
    let (w, h) = (f64::from(width), f64::from(width * 3 / 4));
    let distortion = [-0.28, 0.09, 0.001, -0.0005, 0.0];
    let (fx, cx, cy) = (0.875 * w, 0.503 * w, 0.496 * h);
    let intrinsics = Intrinsics { width, height: width * 3 / 4, fx, fy: fx, cx, cy, skew: 0.0, distortion };
    BoardPhotographer::new(CameraModel::new(intrinsics).expect("a possible camera"))
}

/// Pose of a board tilted about an axis in its plane, with its middle `aside` of the axis, at the
/// distance where it fills 0.7 of the picture.
fn pose(board: &Board, tilt_deg: f64, azimuth: f64, aside: Vector2<f64>) -> Pose<Camera, BoardFrame> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * tilt_deg.to_radians());
    let last = board.corner(board.corner_count() - 1);
    let size = last + Vector2::new(2.0, 2.0) * board.square_m();
    let distance = (0.875 * size.x).max(1.167 * size.y) / 0.7;
    Pose::new(turn, (aside * distance).push(distance) - turn * last.push(0.0) * 0.5)
}

fn finding(c: &mut Criterion) {
    for (width, columns, rows) in [(640, 9, 6), (640, 13, 12), (640, 24, 17), (1280, 9, 6), (1920, 9, 6)] {
        let (camera, board) = (camera(width), Board::new(columns, rows, 0.025).expect("a possible board"));
        let picture = camera.photograph(&board, &pose(&board, 25.0, 0.9, Vector2::zeros()), &Photograph::default());
        c.bench_function(&format!("find a board of {board} in {width}x{}", width * 3 / 4), |b| {
            b.iter(|| find_board(&picture, &board).expect("it is there"))
        });
    }
}

fn solving(c: &mut Criterion) {
    let (camera, board) = (camera(640), Board::new(13, 12, 0.02).expect("a possible board"));
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let mut between = |a: f64, b: f64| a + (b - a) * random.random::<f64>();
    let mut view = |k: usize| -> Vec<Observation> {
        let aside = Vector2::new(between(-0.1, 0.1), between(-0.1, 0.1));
        let corners = camera.corners(&board, &pose(&board, between(20.0, 40.0), 2.4 * k as f64, aside));
        let noisy = corners.iter().map(|p| p + Vector2::new(between(-0.3, 0.3), between(-0.3, 0.3)));
        noisy.enumerate().map(|(k, pixel)| Observation { board_m: board.corner(k), pixel }).collect()
    };
    let views: Vec<Vec<Observation>> = (0..25).map(&mut view).collect();
    c.bench_function("solve 25 views of 156 corners", |b| {
        b.iter(|| estimate(&views, (640, 480), &SolveOptions::default()).expect("they determine the lens"))
    });
}

criterion_group! {
    name = calibration;
    config = Criterion::default().sample_size(10);
    targets = finding, solving
}
criterion_main!(calibration);
