//! Rendered boards whose colours differ in size by known factors, and displacements that are made
//! up.

use std::sync::OnceLock;

use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::calibrate::board::Board;
use crate::calibrate::picture::{Inspected, inspect};
use crate::calibrate::rendered::{BoardPhotographer, Photograph};
use crate::calibrate::session::{CalibrationOptions, CameraCalibration, calibrate};
use crate::camera::{CameraModel, Intrinsics};
use crate::geometry::Pose;

const SIZE: (u32, u32) = (640, 480);
const VIEWS: usize = 9;
/// Weights of the colours in grey (BT.601).
const WEIGHTS: [f64; 3] = [0.299, 0.587, 0.114];

/// A camera whose picture is `scale` times as large about its principal point.
fn photographer(scale: f64) -> BoardPhotographer {
    let distortion = [-0.2, 0.07, 0.0008, -0.0006, 0.0];
    let (fx, fy) = (520.0 * scale, 522.0 * scale);
    let intrinsics = Intrinsics { width: SIZE.0, height: SIZE.1, fx, fy, cx: 326.0, cy: 236.0, skew: 0.0, distortion };
    BoardPhotographer::new(CameraModel::new(intrinsics).unwrap())
}

/// Views of a board in colour; each colour has its own noise.
fn coloured(scales: [f64; 3]) -> Vec<RgbImage> {
    let (board, cameras) = (Board::new(9, 6, 0.024).unwrap(), scales.map(photographer));
    let view = |k: usize| {
        let azimuth = 1.57 * k as f64 + 0.4;
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * 0.55);
        let middle = board.corner(board.corner_count() - 1).push(0.0) * 0.5;
        let offset = Vector3::new(0.09 * ((k % 3) as f64 - 1.0), 0.06 * ((k / 3 % 3) as f64 - 1.0), 0.38 + 0.03 * (k % 2) as f64);
        let pose = Pose::new(rotation, offset - rotation * middle);
        let planes: Vec<GrayImage> = (0..3)
            .map(|c| {
                let how = Photograph { blur_px: 0.7, noise: 3.0, seed: (3 * k + c) as u64, ..Photograph::default() };
                cameras[c].photograph(&board, &pose, &how)
            })
            .collect();
        RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| image::Rgb([0, 1, 2].map(|c: usize| planes[c].get_pixel(x, y).0[0])))
    };
    (0..VIEWS).map(view).collect()
}

fn luma(picture: &RgbImage) -> GrayImage {
    let level = |p: &image::Rgb<u8>| (0..3).map(|c| WEIGHTS[c] * f64::from(p.0[c])).sum::<f64>().round() as u8;
    GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| image::Luma([level(picture.get_pixel(x, y))]))
}

fn calibrated(pictures: &[RgbImage]) -> (Vec<Inspected>, CameraCalibration) {
    let board = Board::new(9, 6, 0.024).unwrap();
    let inspected: Vec<Inspected> =
        pictures.iter().enumerate().map(|(k, p)| inspect(format!("{k}.png").into(), &luma(p), &board)).collect();
    let made = calibrate(&inspected, &board, &CalibrationOptions::default()).unwrap();
    (inspected, made)
}

fn measured(inspected: &[Inspected], made: &CameraCalibration, pictures: &[RgbImage]) -> Result<LateralColour, &'static str> {
    let all = inspected.iter().zip(pictures).enumerate();
    let views: Vec<_> = all.filter_map(|(k, (inspected, picture))| made.corner_colours(k, inspected, picture)).collect();
    LateralColour::of(&views, made.size)
}

const SCALES: [f64; 3] = [1.0003, 1.0, 0.9998];

/// The pictures with [`SCALES`] and their calibration.
fn lateral() -> &'static (Vec<RgbImage>, Vec<Inspected>, CameraCalibration) {
    static LATERAL: OnceLock<(Vec<RgbImage>, Vec<Inspected>, CameraCalibration)> = OnceLock::new();
    LATERAL.get_or_init(|| {
        let pictures = coloured(SCALES);
        let (inspected, made) = calibrated(&pictures);
        (pictures, inspected, made)
    })
}

/// The colours' true sizes relative to grey.
fn truth() -> [f64; 3] {
    let grey: f64 = SCALES.iter().zip(WEIGHTS).map(|(scale, weight)| scale * weight).sum();
    SCALES.map(|scale| scale / grey)
}

#[test]
fn known_sizes_are_found_within_their_uncertainty() {
    let (pictures, inspected, made) = lateral();
    let colours = measured(inspected, made, pictures).unwrap();
    assert_eq!(colours.pictures, VIEWS);
    for ((name, found), truth) in colours.named().zip(truth()) {
        println!("{name} {found:?} {:.6}", truth);
        assert!((found.scale - truth).abs() < found.scale_uncertainty, "{name}: {found:?} is not {truth}");
        assert!(found.scale_uncertainty < 4e-5, "{name}: {found:?}");
        assert!((found.corner_px - 400.0 * (truth - 1.0)).abs() < found.corner_uncertainty_px, "{name}: {found:?}");
        assert!(found.shift_px.norm() < 0.01 && found.corners > 50 * VIEWS, "{name}: {found:?}");
    }
    let words = colours.meaning();
    assert!(
        words.contains("in red alone 0.02")
            && words.contains("too near")
            && words.contains("in blue alone 0.02")
            && words.contains("too far"),
        "{words}"
    );
}

/// The pictures as JPEG keeps them by default: colour differences at half the size, interpolated.
fn with_half_colour(picture: &RgbImage) -> RgbImage {
    let (grey, at) = (luma(picture), |v: u32, size: u32| v.min(size - 1));
    let difference = |x: u32, y: u32, c: usize| {
        let sum = |f: &dyn Fn(u32, u32) -> f64| f(0, 0) + f(1, 0) + f(0, 1) + f(1, 1);
        0.25 * sum(&|dx, dy| {
            let (x, y) = (at(2 * x + dx, SIZE.0), at(2 * y + dy, SIZE.1));
            f64::from(picture.get_pixel(x, y).0[c]) - f64::from(grey.get_pixel(x, y).0[0])
        })
    };
    let nearest = |v: u32, size: u32| {
        let beside = if v.is_multiple_of(2) { (v / 2).saturating_sub(1) } else { at(v / 2 + 1, size / 2) };
        [(v / 2, 0.75), (beside, 0.25)]
    };
    RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| {
        let level = f64::from(grey.get_pixel(x, y).0[0]);
        image::Rgb([0, 1, 2].map(|c| {
            let pairs = nearest(y, SIZE.1).into_iter().flat_map(|(j, wy)| nearest(x, SIZE.0).map(|(i, wx)| (i, j, wx * wy)));
            (level + pairs.map(|(i, j, weight)| weight * difference(i, j, c)).sum::<f64>()).round() as u8
        }))
    })
}

#[test]
fn colour_at_half_size_shows_most_of_it() {
    let (pictures, inspected, made) = lateral();
    let halved: Vec<RgbImage> = pictures.iter().map(with_half_colour).collect();
    let colours = measured(inspected, made, &halved).unwrap();
    for ((name, found), truth) in colours.named().zip(truth()) {
        let share = (found.scale - 1.0) / (truth - 1.0);
        println!("{name} {share:.3} {found:?}");
        assert!((0.85..1.1).contains(&share) || name == "green", "{name}: {share}");
    }
}

#[test]
fn equal_colours_differ_by_nothing_beyond_the_uncertainty() {
    let pictures = coloured([1.0; 3]);
    let (inspected, made) = calibrated(&pictures);
    let colours = measured(&inspected, &made, &pictures).unwrap();
    for (name, found) in colours.named() {
        println!("{name} {found:?}");
        assert!((found.scale - 1.0).abs() < found.scale_uncertainty && found.scale_uncertainty < 4e-5, "{name}: {found:?}");
    }
    assert!(colours.meaning().starts_with("None"), "{}", colours.meaning());
}

#[test]
fn grey_pictures_give_nothing() {
    let (pictures, inspected, made) = lateral();
    let grey = |rounding: u32| -> Vec<RgbImage> {
        let pixel = |level: u8, x: u32| image::Rgb([level.saturating_add((x % 2 * rounding) as u8), level, level]);
        pictures.iter().map(luma).map(|g| RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| pixel(g.get_pixel(x, y).0[0], x))).collect()
    };
    assert_eq!(measured(inspected, made, &grey(0)), Err(GREY));
    assert_eq!(measured(inspected, made, &grey(1)), Err(GREY));
    // A file that was replaced in between.
    assert_eq!(measured(inspected, made, &vec![RgbImage::new(320, 240); VIEWS]), Err(GREY));
    assert_eq!(made.lateral_colour, Err(GREY));
}

/// Boards in `views` parts of the picture, whose corners are displaced by `by` in every colour,
/// with noise of their own and a shift that the corners of each view share.
fn made_up(views: usize, seed: u64, [own, shared]: [f64; 2], by: impl Fn(Vector2<f64>) -> Vector2<f64>) -> Vec<Vec<CornerColours>> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut noise = |sigma: f64| {
        let mut one = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        Vector2::new(one(), one()) * sigma
    };
    let view = |v: usize| {
        let (middle, shift) = (Vector2::new(80.0 * ((v % 3) as f64 - 1.0), 60.0 * ((v / 3 % 3) as f64 - 1.0)), noise(shared));
        let corner = |k: usize| {
            let place = middle + Vector2::new(35.0 * ((k % 9) as f64 - 4.0), 35.0 * ((k / 9) as f64 - 2.5));
            CornerColours { place, moved: [0; 3].map(|_| Some(by(place) + shift + noise(own))) }
        };
        (0..54).map(corner).collect()
    };
    (0..views).map(view).collect()
}

#[test]
fn a_shift_a_cube_and_outliers_are_told_from_the_scale() {
    let bent = |p: Vector2<f64>| p * (3e-4 - 1e-3 * (p / 400.0).norm_squared()) + Vector2::new(0.3, -0.1);
    let mut views = made_up(9, 1, [0.02, 0.0], bent);
    views.iter_mut().for_each(|view| view[7].moved = [Some(Vector2::new(0.9, 1.1)); 3]);
    let found = LateralColour::of(&views, SIZE).unwrap().colours[0];
    assert!(found.is_cubic && found.corners == 9 * 53, "{found:?}");
    assert!((found.corner_px + 0.28).abs() < found.corner_uncertainty_px && found.corner_uncertainty_px < 0.1, "{found:?}");
    assert!((found.shift_px - Vector2::new(0.3, -0.1)).norm() < 0.005, "{found:?}");
    // The mean square of the radius's fourth over that of its square is 0.477 for 4 to 3.
    assert!((found.scale - 1.0 - (3e-4 - 0.4772 * 1e-3)).abs() < found.scale_uncertainty, "{found:?}");
    let straight = LateralColour::of(&made_up(9, 2, [0.02, 0.0], |p| p * 2e-4), SIZE).unwrap().colours[2];
    assert!(!straight.is_cubic && (straight.scale - 1.0002).abs() < straight.scale_uncertainty, "{straight:?}");
}

#[test]
fn the_uncertainty_holds_with_errors_that_a_picture_shares() {
    for noise in [[0.02, 0.0], [0.02, 0.02]] {
        let error = |seed: u64| {
            let found = LateralColour::of(&made_up(12, seed, noise, |p| p * 2e-4), SIZE).unwrap().colours;
            // The three colours share the pictures' errors, so one of them counts.
            (found[1].scale - 1.0002) / (found[1].scale_uncertainty / 3.0)
        };
        let rms = ((0..200).map(|seed| error(seed).powi(2)).sum::<f64>() / 200.0).sqrt();
        println!("{noise:?} {rms}");
        assert!((0.7..1.3).contains(&rms), "{noise:?}: {rms}");
    }
}

#[test]
fn too_few_corners_and_pictures_give_the_reason() {
    let scaled = |p: Vector2<f64>| p * 2e-4;
    assert_eq!(LateralColour::of(&made_up(1, 1, [0.02, 0.0], scaled), SIZE), Err(TOO_FEW));
    // Compression leaves each colour a copy of grey.
    assert_eq!(LateralColour::of(&made_up(9, 1, [1e-7, 0.0], |p| p * 0.0), SIZE), Err(COPIES));
    let mut views = made_up(9, 1, [0.02, 0.0], scaled);
    // A board in red and white has no contrast in red.
    views.iter_mut().flatten().for_each(|corner| corner.moved[0] = None);
    assert_eq!(LateralColour::of(&views, SIZE), Err(TOO_FEW));
}
