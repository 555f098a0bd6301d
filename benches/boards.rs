//! The board finder on rendered pictures with exact ground truth: how accurate its corners are, and
//! how it copes with hard pictures.
//!
//! `cargo bench --bench boards` prints two tables. A corner that is off by one pixel or more counts
//! as wrong.

use std::f64::consts::TAU;

use image::GrayImage;
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use stagepose::diagnostics::calibrate::{Board, BoardFrame, FoundBoard, find_board};
use stagepose::{Camera, CameraModel, Intrinsics, Pose};

#[path = "../tests/calibrate/rendered.rs"]
mod rendered;
use rendered::{BoardPhotographer, Photograph};

const BOARDS: [(u32, u32); 4] = [(9, 6), (13, 12), (10, 10), (24, 17)];
const KINDS: [&str; 7] =
    ["plain", "phone in the dark", "the same, reflections", "hard shadow", "50 to 62 degrees", "a finger", "partly outside"];
/// Pictures of each kind.
const PICTURES: u64 = 24;

fn camera(focal_px: f64, distortion: [f64; 5]) -> BoardPhotographer {
    let intrinsics = Intrinsics { width: 640, height: 480, fx: focal_px, fy: focal_px, cx: 322.0, cy: 237.0, skew: 0.0, distortion };
    BoardPhotographer::new(CameraModel::new(intrinsics).expect("a possible camera"))
}

/// Pose of a board that would fill `fill` of the picture head-on, with its middle `aside` of the
/// axis in fractions of the picture.
fn pose(board: &Board, focal_px: f64, fill: f64, [tilt_deg, azimuth, roll]: [f64; 3], aside: Vector2<f64>) -> Pose<Camera, BoardFrame> {
    let axis = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * tilt_deg.to_radians();
    let turn = UnitQuaternion::from_scaled_axis(axis) * UnitQuaternion::from_scaled_axis(Vector3::z() * roll);
    let last = board.corner(board.corner_count() - 1);
    let size = last + Vector2::new(2.0, 2.0) * board.square_m();
    let distance = 1.03 * focal_px * (size.x / 640.0).max(size.y / 480.0) / fill;
    let middle = Vector2::new(aside.x * 640.0, aside.y * 480.0) / focal_px * distance;
    Pose::new(turn, middle.push(distance) - turn * last.push(0.0) * 0.5)
}

/// Returns the distances from the truth for the best-fitting turn of a symmetric board; `NAN` where
/// a corner is hidden.
fn errors(found: &FoundBoard, truth: &[Vector2<f64>], board: &Board) -> Vec<f64> {
    let (columns, rows) = (board.columns() as usize, board.rows() as usize);
    let turned = |turn: usize| -> Vec<f64> {
        let place = |k: usize| {
            let (c, r) = (k % columns, k / columns);
            match turn {
                0 => (c, r),
                1 => (columns - 1 - c, rows - 1 - r),
                2 => (r, columns - 1 - c),
                _ => (rows - 1 - r, c),
            }
        };
        let error = |(k, corner): (usize, &Option<Vector2<f64>>)| {
            let (c, r) = place(k);
            corner.map_or(f64::NAN, |corner| (corner - truth[r * columns + c]).norm())
        };
        found.corners.iter().enumerate().map(error).collect()
    };
    let sum = |all: &[f64]| all.iter().filter(|e| e.is_finite()).sum::<f64>();
    let turns = if columns == rows { 4 } else { 2 };
    (0..turns).map(turned).min_by(|a, b| sum(a).total_cmp(&sum(b))).unwrap_or_default()
}

fn rms(errors: &[f64]) -> f64 {
    let seen: Vec<f64> = errors.iter().copied().filter(|e| e.is_finite()).collect();
    (seen.iter().map(|e| e * e).sum::<f64>() / seen.len().max(1) as f64).sqrt()
}

/// Prints corner errors over five tilts, for boards, sizes and blurs.
fn accuracy() {
    println!("rms of the corner error, px: tilts 0, 15, 30, 45, 60 degrees, noise 2 grey levels (- where the board is not found)");
    let camera = camera(560.0, [-0.28, 0.09, 0.001, -0.0005, 0.0]);
    for (columns, rows) in BOARDS {
        let board = Board::new(columns, rows, 0.02).expect("a possible board");
        for fill in [0.5, 0.85] {
            for blur_px in [0.0, 0.5, 1.5, 3.0] {
                let mut line = format!("{board} filling {fill}, blur {blur_px}:");
                for (k, tilt) in [0.0, 15.0, 30.0, 45.0, 60.0].into_iter().enumerate() {
                    let turn = [tilt, 0.9 + 2.1 * k as f64, 0.2 - 0.1 * k as f64];
                    let pose = pose(&board, 560.0, fill, turn, Vector2::zeros());
                    let picture = camera.photograph(&board, &pose, &Photograph { blur_px, seed: k as u64, ..Photograph::default() });
                    line += &match find_board(&picture, &board) {
                        Ok(found) => format!(" {:.4}", rms(&errors(&found, &camera.corners(&board, &pose), &board))),
                        Err(_) => " -".to_owned(),
                    };
                }
                println!("{line}");
            }
        }
    }
}

/// Changes the level of every pixel by its position.
fn shade(picture: &mut GrayImage, mut level: impl FnMut(Vector2<f64>, f64) -> f64) {
    for (x, y, pixel) in picture.enumerate_pixels_mut() {
        pixel.0[0] = level(Vector2::new(f64::from(x), f64::from(y)), f64::from(pixel.0[0])).clamp(0.0, 255.0) as u8;
    }
}

/// Renders one hard picture; returns it with the true corners.
fn hard(kind: &str, board: &Board, camera: &BoardPhotographer, number: u64, random: &mut Pcg64Mcg) -> (GrayImage, Vec<Vector2<f64>>) {
    let mut between = |a: f64, b: f64| a + (b - a) * random.random::<f64>();
    let fill = between(0.45, 0.85);
    let tilt = if kind.contains("62") { between(50.0, 62.0) } else { between(0.0, 45.0) };
    let room = if kind.contains("outside") { 0.35 } else { 0.3 * (1.0 - fill) };
    let aside = Vector2::new(between(-room, room), between(-room, room));
    let turn = [tilt, between(0.0, TAU), between(-0.6, 0.6)];
    let pose = pose(board, camera.model.intrinsics().fx, fill, turn, aside);
    let blur_px = between(0.4, 1.5);
    let falloff = between(0.0, 0.4) as f32;
    let margin = if number.is_multiple_of(3) { 0.3 } else { 1.0 };
    let light = between(60.0, 190.0) as f32;
    let dark_room = Photograph { dark: 6.0, light, background: 3.0, margin: margin - 0.3, blur_px, noise: 2.5, falloff, seed: number };
    let paper = Photograph { blur_px, falloff, margin, seed: number, ..Photograph::default() };
    let is_phone = kind.contains("phone") || kind.contains("reflections");
    let mut picture = camera.photograph(board, &pose, if is_phone { &dark_room } else { &paper });
    let truth = camera.corners(board, &pose);
    let middle = truth.iter().sum::<Vector2<f64>>() / truth.len() as f64;
    let radius = truth.iter().map(|t| (t - middle).norm()).fold(0.0, f64::max);
    let mut spot =
        |from: f64, to: f64| middle + Vector2::new(between(-1.0, 1.0), between(-1.0, 1.0)).normalize() * between(from, to) * radius;
    match kind {
        "the same, reflections" => {
            let spots = [spot(0.0, 0.9), spot(0.0, 0.9)];
            let (size, strength) = (between(8.0, 40.0), between(60.0, 300.0));
            shade(&mut picture, |p, level| level + spots.iter().map(|s| strength * (-((p - s).norm() / size).powi(2)).exp()).sum::<f64>());
        }
        "hard shadow" => {
            let (normal, left) = ((spot(1.0, 1.0) - middle) / radius, between(0.08, 0.3));
            let offset = between(-0.4, 0.4) * radius;
            shade(&mut picture, |p, level| level * (left + (1.0 - left) / (1.0 + (-((p - middle).dot(&normal) - offset) / 6.0).exp())));
        }
        "a finger" => {
            let (tip, size) = (spot(0.75, 1.1), between(10.0, 30.0));
            shade(&mut picture, |p, level| if (p - tip).norm() < size { 120.0 } else { level });
        }
        _ => {}
    }
    (picture, truth)
}

fn hard_pictures() {
    println!("\nhard pictures, {PICTURES} of each kind, two lenses:");
    let cameras = [camera(560.0, [-0.28, 0.09, 0.001, -0.0005, 0.0]), camera(420.0, [-0.33, 0.12, 0.0, 0.0, 0.0])];
    for (columns, rows) in BOARDS {
        let board = Board::new(columns, rows, 0.02).expect("a possible board");
        for kind in KINDS {
            let mut random = Pcg64Mcg::seed_from_u64(77);
            let mut all: Vec<f64> = Vec::new();
            for number in 0..PICTURES {
                let (picture, truth) = hard(kind, &board, &cameras[number as usize % 2], number, &mut random);
                if let Ok(found) = find_board(&picture, &board) {
                    all.extend(errors(&found, &truth, &board));
                }
            }
            let boards = all.len() / board.corner_count();
            let seen = all.iter().filter(|e| e.is_finite()).count();
            let wrong = all.iter().filter(|e| **e >= 1.0).count();
            let share = 100.0 * seen as f64 / all.len().max(1) as f64;
            println!("{board}, {kind}: {boards} found, {share:.1} % of their corners, {wrong} wrong, rms {:.4} px", rms(&all));
        }
    }
}

fn main() {
    accuracy();
    hard_pictures();
}
