//! Sums of Haar wavelet responses around a keypoint (Bay, Ess, Tuytelaars & Van Gool, Speeded-Up
//! Robust Features (SURF), CVIU 2008, section 4).
//!
//! 64 values of unit norm, plus the sign of the Laplacian: bright and dark blobs, which never
//! correspond, differ there by 2, and two vectors of equal sign never differ by more (section 4.3
//! compares equal signs only).

use std::f64::consts::{FRAC_PI_3, TAU};

use nalgebra::Vector2;

use super::Describer;
use crate::features::two_views::detectors::surf_hessian;
use crate::features::two_views::integral_image::IntegralImage;
use crate::features::two_views::keypoint::{Descriptors, Features, Keypoint, PictureForms};

/// Describes a keypoint by wavelet responses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SurfDescriber {
    /// Whether regions are left upright (U-SURF): faster, and more distinctive if the camera rolls
    /// by at most 15 degrees. Default false.
    pub upright: bool,
}

/// Sub-regions per side (section 4.2).
const GRID: usize = 4;
/// Samples per side of a sub-region (section 4.2).
const SAMPLES: usize = 5;
/// Length of a descriptor: four sums per sub-region, and the sign.
const LENGTH: usize = GRID * GRID * 4 + 1;
/// Sigma of the weights around the keypoint, in its scales (section 4.2).
const WEIGHT_SIGMA: f64 = 3.3;
/// Radius of the samples that determine the orientation, and sigma of their weights, in scales
/// (section 4.1).
const DIRECTION_REACH: i32 = 6;
const DIRECTION_SIGMA: f64 = 2.0;
/// Minimum norm of the sums, grey levels; with less, the surroundings are uniform except for
/// rounding. Raised, faint places are dropped.
const MIN_NORM: f64 = 1.0;
/// Maximum scale described, pixels; larger wavelets are wider than any picture.
const MAX_SCALE: f64 = 1e4;

impl Describer for SurfDescriber {
    fn describe(&self, picture: &PictureForms, keypoints: &[Keypoint]) -> Features {
        let integral = picture.integral();
        let (mut kept, mut values) = (Vec::new(), Vec::new());
        for keypoint in picture.watch.over(keypoints) {
            let (scale, place) = (keypoint.scale(), keypoint.position);
            let inside = |v: f64, side: usize| v >= 0.0 && v <= side as f64 - 1.0;
            let has_size = scale > 0.0 && scale < MAX_SCALE;
            if !has_size || !inside(place.x, integral.width) || !inside(place.y, integral.height) {
                continue;
            }
            let angle = if self.upright { 0.0 } else { direction(integral, place, scale) };
            if let Some(sums) = described(integral, place, scale, angle) {
                kept.push(Keypoint::round(place, scale, keypoint.response).rotated(angle));
                values.extend_from_slice(&sums);
            }
        }
        Features { keypoints: kept, descriptors: Descriptors::Vectors { length: LENGTH, values } }
    }
}

/// Returns the horizontal and vertical wavelet responses of a square of 2 `half` pixels at a
/// position, mean grey levels; `None` if it leaves the picture.
fn wavelets(integral: &IntegralImage, at: Vector2<f64>, half: isize) -> Option<Vector2<f64>> {
    // The square's centre is between pixels, at a corner of four.
    let (x, y) = ((at.x + 0.5).round() as isize, (at.y + 0.5).round() as isize);
    let (left, right, top, bottom) = (x - half, x + half, y - half, y + half);
    if left < 0 || top < 0 || right > integral.width as isize || bottom > integral.height as isize {
        return None;
    }
    let sum = |x: (isize, isize), y: (isize, isize)| f64::from(integral.sum(x, y));
    let across = sum((x, right), (top, bottom)) - sum((left, x), (top, bottom));
    let down = sum((left, right), (y, bottom)) - sum((left, right), (top, y));
    Some(Vector2::new(across, down) / (2 * half * half) as f64)
}

/// Returns the direction of the largest sum of responses within 60 degrees of each other.
fn direction(integral: &IntegralImage, place: Vector2<f64>, scale: f64) -> f64 {
    let half = ((2.0 * scale).round() as isize).max(1);
    let mut responses = Vec::with_capacity(113);
    for k in 0..(2 * DIRECTION_REACH + 1).pow(2) {
        let side = 2 * DIRECTION_REACH + 1;
        let offset = Vector2::new(f64::from(k % side - DIRECTION_REACH), f64::from(k / side - DIRECTION_REACH));
        if offset.norm_squared() >= f64::from(DIRECTION_REACH * DIRECTION_REACH) {
            continue;
        }
        if let Some(response) = wavelets(integral, place + offset * scale, half) {
            let weighted = response * (-0.5 * offset.norm_squared() / (DIRECTION_SIGMA * DIRECTION_SIGMA)).exp();
            responses.push((weighted.y.atan2(weighted.x), weighted));
        }
    }
    // A window starts at each response; between two of them its content does not change.
    let window = |start: f64| -> Vector2<f64> {
        responses.iter().filter(|(angle, _)| (angle - start).rem_euclid(TAU) <= FRAC_PI_3).map(|(_, r)| *r).sum()
    };
    let mut best = Vector2::zeros();
    for (start, _) in &responses {
        let sum = window(*start);
        if sum.norm_squared() > best.norm_squared() {
            best = sum;
        }
    }
    best.y.atan2(best.x)
}

/// Returns the sums of the responses and of their magnitudes in each sub-region, and the sign of
/// the Laplacian. `None` if the region is uniform.
fn described(integral: &IntegralImage, place: Vector2<f64>, scale: f64, angle: f64) -> Option<[f32; LENGTH]> {
    let (sin, cos) = angle.sin_cos();
    let half = (scale.round() as isize).max(1);
    let mut sums = [0.0f64; LENGTH];
    let side = GRID * SAMPLES;
    for k in 0..side * side {
        let (i, j) = (k % side, k / side);
        let offset = Vector2::new(i as f64, j as f64) - Vector2::from_element(0.5 * (side - 1) as f64);
        let rotated = Vector2::new(cos * offset.x - sin * offset.y, sin * offset.x + cos * offset.y);
        let Some(response) = wavelets(integral, place + rotated * scale, half) else { continue };
        let weighted = response * (-0.5 * offset.norm_squared() / (WEIGHT_SIGMA * WEIGHT_SIGMA)).exp();
        let (along, beside) = (cos * weighted.x + sin * weighted.y, cos * weighted.y - sin * weighted.x);
        let cell = 4 * (j / SAMPLES * GRID + i / SAMPLES);
        for (sum, value) in sums[cell..cell + 4].iter_mut().zip([along, along.abs(), beside, beside.abs()]) {
            *sum += value;
        }
    }
    let norm = sums.iter().map(|v| v * v).sum::<f64>().sqrt();
    if norm < MIN_NORM {
        return None;
    }
    let [xx, yy, _] = surf_hessian(integral, place, scale);
    let mut out = sums.map(|v| (v / norm) as f32);
    out[LENGTH - 1] = if xx + yy > 0.0 { 1.0 } else { -1.0 };
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, Luma};

    /// Bumps at random places around (100, 100), rotated and scaled about it.
    fn texture(angle: f64, scale: f64, gain: f64) -> GrayImage {
        let mut state = 7u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24) - 0.5
        };
        let bumps: Vec<[f64; 4]> = (0..300).map(|_| [200.0 * random(), 200.0 * random(), 6.0 + 6.0 * random(), 2.0 * random()]).collect();
        let (sin, cos) = angle.sin_cos();
        GrayImage::from_fn(200, 200, |x, y| {
            let d = Vector2::new(f64::from(x) - 100.0, f64::from(y) - 100.0) / scale;
            let (u, v) = (cos * d.x + sin * d.y, cos * d.y - sin * d.x);
            let value = |b: &[f64; 4]| b[3] * (-0.5 * ((u - b[0]).powi(2) + (v - b[1]).powi(2)) / (b[2] * b[2])).exp();
            Luma([(128.0 + gain * bumps.iter().map(value).sum::<f64>()).clamp(0.0, 255.0) as u8])
        })
    }

    /// Descriptors of 25 places around (100, 100) that rotate and scale with the texture.
    fn places(picture: &GrayImage, angle: f64, scale: f64) -> Vec<(Vec<f32>, f64)> {
        let (sin, cos) = angle.sin_cos();
        let offsets = (0..25).map(|k| Vector2::new(f64::from(k % 5 - 2), f64::from(k / 5 - 2)) * 9.0 * scale);
        let rotated = offsets.map(|o| Vector2::new(100.0 + cos * o.x - sin * o.y, 100.0 + sin * o.x + cos * o.y));
        rotated.map(|place| at(picture, place, 2.5 * scale)).collect()
    }

    fn at(picture: &GrayImage, place: Vector2<f64>, scale: f64) -> (Vec<f32>, f64) {
        let features = SurfDescriber::default().describe(&PictureForms::new(picture), &[Keypoint::round(place, scale, 1.0)]);
        let Descriptors::Vectors { length: 65, values } = features.descriptors else { panic!("65 numbers") };
        (values, features.keypoints[0].angle())
    }

    fn distance(a: &[f32], b: &[f32]) -> f32 {
        a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
    }

    fn between(a: f64, b: f64) -> f64 {
        ((a - b + std::f64::consts::PI).rem_euclid(TAU) - std::f64::consts::PI).abs()
    }

    #[test]
    fn surf_descriptors_match_under_rotation_scale_and_contrast() {
        let reference = places(&texture(0.0, 1.0, 60.0), 0.0, 1.0);
        for (values, _) in &reference {
            assert!((values[..64].iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-4);
        }
        for (angle, scale, gain) in [(0.0, 1.0, 40.0), (0.6, 1.0, 60.0), (2.5, 1.0, 60.0), (-1.2, 1.4, 50.0)] {
            let others = places(&texture(angle, scale, gain), angle, scale);
            let nearest = |values: &[f32]| {
                let distances = reference.iter().map(|r| distance(&r.0, values));
                distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).map(|(k, _)| k)
            };
            let right = others.iter().enumerate().filter(|(k, o)| nearest(&o.0) == Some(*k)).count();
            let rotated = others.iter().zip(&reference).filter(|(o, r)| between(o.1 - r.1, angle) < 0.2).count();
            assert!(right >= 23 && rotated >= 20, "{angle} {scale}: {right} {rotated}");
        }
    }

    #[test]
    fn the_orientation_follows_the_gradient() {
        for angle in [0.0f64, 0.3, 0.8, 1.7, 3.0, -0.6, -2.2] {
            let (sin, cos) = angle.sin_cos();
            let ramp = GrayImage::from_fn(200, 200, |x, y| {
                let along = cos * (f64::from(x) - 100.0) + sin * (f64::from(y) - 100.0);
                Luma([(128.0 + 3.1 * along).clamp(0.0, 255.0).round() as u8])
            });
            let error = between(at(&ramp, Vector2::new(100.0, 100.0), 3.0).1, angle);
            assert!(error < 0.01, "{angle}: {error}");
        }
    }

    #[test]
    fn bright_and_dark_blob_descriptors_differ_by_at_least_two() {
        let blob = |sign: f64| {
            GrayImage::from_fn(200, 200, |x, y| {
                let d = Vector2::new(f64::from(x) - 100.0, f64::from(y) - 100.0);
                Luma([(128.0 + sign * 90.0 * (-0.5 * d.norm_squared() / 16.0).exp()) as u8])
            })
        };
        let middle = Vector2::new(100.0, 100.0);
        let ((bright, _), (dark, _)) = (at(&blob(1.0), middle, 4.0), at(&blob(-1.0), middle, 4.0));
        assert_eq!((bright[64], dark[64]), (-1.0, 1.0));
        assert!(distance(&bright, &dark) >= 2.0);
    }

    #[test]
    fn undescribable_keypoints_are_dropped() {
        let round = |x: f64, y: f64, scale: f64| Keypoint::round(Vector2::new(x, y), scale, 1.0);
        let wild =
            [round(f64::NAN, 1.0, 1.0), round(-1.0, 1.0, 1.0), round(1.0, 1.0, 0.0), round(1.0, 1.0, f64::INFINITY), round(0.0, 0.0, 1.0)];
        for (w, h) in [(0, 0), (1, 1), (1, 50), (5000, 3), (60, 60)] {
            let even = GrayImage::from_pixel(w, h, Luma([70]));
            assert!(SurfDescriber::default().describe(&PictureForms::new(&even), &wild).keypoints.is_empty());
        }
    }
}
