//! The finder on rendered boards with exact truth, and on pictures without a board.

use image::{GrayImage, Luma};
use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::calibrate::rendered::{BoardPhotographer, Photograph};
use crate::calibrate::solve::adjust::BoardFrame;
use crate::camera::{CameraModel, Intrinsics};
use crate::geometry::{Camera, Pose};

fn photographer() -> BoardPhotographer {
    let distortion = [-0.28, 0.09, 0.001, -0.0005, 0.0];
    let intrinsics = Intrinsics { width: 640, height: 480, fx: 560.0, fy: 560.0, cx: 322.0, cy: 238.0, skew: 0.0, distortion };
    BoardPhotographer::new(CameraModel::new(intrinsics).unwrap())
}

/// A board with its middle `z` in front of the camera, tilted about an axis in its plane, then
/// rotated in its plane.
fn pose(board: &Board, tilt_deg: f64, azimuth: f64, roll: f64, z: f64) -> Pose<Camera, BoardFrame> {
    let axis = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0);
    let rotation = UnitQuaternion::from_scaled_axis(axis * tilt_deg.to_radians()) * UnitQuaternion::from_scaled_axis(Vector3::z() * roll);
    let middle = board.corner(board.corner_count() - 1).push(0.0) * 0.5;
    Pose::new(rotation, Vector3::new(0.01, -0.005, z) - rotation * middle)
}

/// Returns the rms distance to the truth over pictures of several tilts; every corner must be
/// found.
fn error_px(board: &Board, how: &Photograph, tilts: &[f64], z: f64) -> f64 {
    let camera = photographer();
    let (mut squares, mut count) = (0.0, 0.0);
    for (k, &tilt) in tilts.iter().enumerate() {
        let pose = pose(board, tilt, 0.9 + 2.1 * k as f64, 0.2, z);
        let picture = camera.photograph(board, &pose, &Photograph { seed: k as u64, ..*how });
        let found = find_board(&picture, board).unwrap_or_else(|e| panic!("{board}, tilt {tilt}, {how:?}: {e}"));
        assert_eq!(found.seen(), board.corner_count(), "{board}, tilt {tilt}, {how:?}");
        for (corner, truth) in found.corners.iter().flatten().zip(camera.corners(board, &pose)) {
            squares += (corner - truth).norm_squared();
            count += 1.0;
        }
    }
    (squares / count).sqrt()
}

#[test]
fn corners_are_exact_to_hundredths_sharp_and_blurred() {
    let board = Board::new(9, 6, 0.03).unwrap();
    for (blur_px, limit) in [(0.5, 0.03), (1.5, 0.06), (3.0, 0.1)] {
        let error = error_px(&board, &Photograph { blur_px, ..Photograph::default() }, &[0.0, 20.0, 45.0, 60.0], 0.5);
        assert!(error <= limit, "blur {blur_px}: {error:.4} px");
    }
}

#[test]
fn boards_of_any_size_are_found() {
    for (columns, rows, square_m) in [(6, 4, 0.04), (13, 12, 0.018), (10, 10, 0.022), (24, 17, 0.011)] {
        let board = Board::new(columns, rows, square_m).unwrap();
        let error = error_px(&board, &Photograph::default(), &[10.0, 40.0], 0.5);
        assert!(error <= 0.03, "{board}: {error:.4} px");
    }
}

#[test]
fn blur_over_small_squares_moves_no_corner() {
    for (columns, rows, square_m) in [(13, 12, 0.018), (10, 10, 0.022), (24, 17, 0.012)] {
        let board = Board::new(columns, rows, square_m).unwrap();
        for (blur_px, limit) in [(1.5, 0.04), (3.0, 0.06)] {
            let error = error_px(&board, &Photograph { blur_px, ..Photograph::default() }, &[0.0, 30.0], 0.5);
            assert!(error <= limit, "{board}, blur {blur_px}: {error:.4} px");
        }
    }
}

#[test]
fn a_shadow_across_the_board_hides_corners_on_its_edge_only() {
    let board = Board::new(9, 6, 0.03).unwrap();
    let camera = photographer();
    let pose = pose(&board, 20.0, 1.0, 0.1, 0.5);
    let mut picture = camera.photograph(&board, &pose, &Photograph::default());
    let truth = camera.corners(&board, &pose);
    for (x, y, level) in picture.enumerate_pixels_mut() {
        let past = f64::from(x) - 330.0 + 0.4 * f64::from(y);
        level.0[0] = (f64::from(level.0[0]) * (0.15 + 0.85 / (1.0 + (past / 6.0).exp()))) as u8;
    }
    let found = find_board(&picture, &board).unwrap();
    assert!(found.seen() > 40, "{}", found.seen());
    for (corner, truth) in found.corners.iter().zip(&truth) {
        assert!(corner.is_none_or(|c| (c - truth).norm() < 0.9), "{corner:?} is not {truth}");
    }
}

#[test]
fn a_cut_off_board_is_reported_as_cut() {
    let board = Board::new(9, 6, 0.03).unwrap();
    let camera = photographer();
    for aside in [0.18, 0.24, 0.3] {
        let mut there = pose(&board, 20.0, 1.0, 0.1, 0.5);
        there.translation.x += aside;
        let error = find_board(&camera.photograph(&board, &there, &Photograph::default()), &board).unwrap_err();
        assert!(matches!(error, NoBoard::OtherSize { cut: true, .. }), "{aside}: {error}");
    }
}

#[test]
fn corners_survive_darkness_noise_and_uneven_light() {
    let board = Board::new(10, 10, 0.022).unwrap();
    let dark = Photograph { dark: 4.0, light: 26.0, background: 2.0, margin: 0.3, blur_px: 1.0, noise: 1.5, falloff: 0.5, seed: 3 };
    let error = error_px(&board, &dark, &[5.0, 35.0, 50.0], 0.5);
    assert!(error < 0.15, "{error:.4} px");
}

#[test]
fn a_reflection_hides_its_corners_and_no_others() {
    let board = Board::new(9, 6, 0.03).unwrap();
    let camera = photographer();
    let pose = pose(&board, 25.0, 1.0, 0.1, 0.5);
    let mut picture = camera.photograph(&board, &pose, &Photograph::default());
    let truth = camera.corners(&board, &pose);
    let spot = truth[22];
    for (x, y, level) in picture.enumerate_pixels_mut() {
        let d = (f64::from(x) - spot.x).hypot(f64::from(y) - spot.y);
        level.0[0] = (f64::from(level.0[0]) + 400.0 * (-(d / 22.0).powi(2)).exp()).min(255.0) as u8;
    }
    let found = find_board(&picture, &board).unwrap();
    assert!((46..54).contains(&found.seen()), "{}", found.seen());
    assert!(found.corners[22].is_none());
    for (corner, truth) in found.corners.iter().zip(&truth) {
        assert!(corner.is_none_or(|c| (c - truth).norm() < 0.5));
    }
}

#[test]
fn the_origin_is_the_dark_corner_at_any_board_rotation() {
    let board = Board::new(9, 6, 0.025).unwrap();
    let camera = photographer();
    for quarter in 0..4 {
        let pose = pose(&board, 20.0, 0.5, f64::from(quarter) * std::f64::consts::FRAC_PI_2 + 0.3, 0.55);
        let found = find_board(&camera.photograph(&board, &pose, &Photograph::default()), &board).unwrap();
        let truth = camera.corners(&board, &pose);
        assert!((found.corners[0].unwrap() - truth[0]).norm() < 0.2, "turn {quarter}");
        assert!((found.corners[8].unwrap() - truth[8]).norm() < 0.2, "turn {quarter}");
    }
}

#[test]
fn another_board_is_named_and_a_missing_one_is_an_error() {
    let camera = photographer();
    let there = Board::new(8, 5, 0.03).unwrap();
    let picture = camera.photograph(&there, &pose(&there, 15.0, 1.0, 0.0, 0.5), &Photograph::default());
    let wanted = Board::new(9, 6, 0.03).unwrap();
    let error = find_board(&picture, &wanted).unwrap_err();
    assert!(matches!(error, NoBoard::OtherSize { columns: 8, rows: 5, cut: false, .. }), "{error}");
    // A smaller board is not found in a larger one.
    let smaller = Board::new(7, 5, 0.03).unwrap();
    assert!(find_board(&picture, &smaller).is_err());
    let black = find_board(&GrayImage::new(320, 240), &wanted).unwrap_err();
    assert!(black.to_string().contains("dark"), "{black}");
    let noise = GrayImage::from_fn(320, 240, |x, y| Luma([(x.wrapping_mul(2_654_435_761) ^ y.wrapping_mul(40_503)).to_le_bytes()[1]]));
    assert!(find_board(&noise, &wanted).is_err());
    assert!(find_board(&GrayImage::new(1, 1), &wanted).is_err());
}
