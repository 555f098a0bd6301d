//! Renders views of a picture with known homographies, for measuring detectors when no photographs
//! with ground truth are available.

use image::GrayImage;
use nalgebra::{Matrix3, Vector2};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::features::two_views::FloatImage;
use crate::geometry::Homography;

/// A change of view or light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Change {
    /// Camera roll, degrees.
    Roll(f64),
    /// Camera distance: above 1 is nearer.
    Zoom(f64),
    /// Oblique view, degrees from head-on.
    Tilt(f64),
    /// Defocus, sigma in pixels.
    Blur(f64),
    /// Dimmed to this fraction, with noise of this standard deviation, grey levels.
    Light(f64, f64),
}

/// The changes in the table of detectors, one per column.
pub const CHANGES: [(&str, Change); 7] = [
    ("roll 30", Change::Roll(30.0)),
    ("zoom 0.6", Change::Zoom(0.6)),
    ("tilt 30", Change::Tilt(30.0)),
    ("tilt 50", Change::Tilt(50.0)),
    ("tilt 65", Change::Tilt(65.0)),
    ("blur 2.5", Change::Blur(2.5)),
    ("dim 0.4", Change::Light(0.4, 4.0)),
];

/// Camera distance for oblique views, in picture widths: that of a common lens. Lowered,
/// perspective grows.
const DISTANCE: f64 = 1.3;
/// Samples per pixel along each side. Raised, reduced pictures are smoother and take longer.
const SAMPLES: usize = 4;
/// Grey level outside the picture.
const BESIDE: f32 = 90.0;
/// Noise added to every rendered view, grey levels, so that no two pixels are computed equal.
const NOISE: f64 = 1.0;

/// Renders the view after a change, at the same size; returns it with the homography to it.
pub fn changed(picture: &GrayImage, change: Change, seed: u64) -> (GrayImage, Homography) {
    let homography = homography_of(change, picture.dimensions());
    let source = FloatImage::from_grey(picture);
    let mut view = warped(&source, &homography);
    let (mut gain, mut noise) = (1.0, NOISE);
    match change {
        Change::Blur(sigma) => view = view.blurred(sigma),
        Change::Light(share, sigma) => (gain, noise) = (share as f32, sigma),
        _ => {}
    }
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    // A sum of four uniform numbers is nearly normal; its standard deviation is twice that of one.
    let width = noise * 3.0_f64.sqrt();
    let mut scatter = || if width > 0.0 { (0..4).map(|_| random.random_range(-0.5..0.5)).sum::<f64>() * width } else { 0.0 };
    let grey = view.values.iter().map(|v| (gain * v + scatter() as f32).round().clamp(0.0, 255.0) as u8).collect();
    let image = GrayImage::from_raw(view.width as u32, view.height as u32, grey).unwrap_or_default();
    (image, homography)
}

/// Returns the map from the picture to its changed view, about the centre.
fn homography_of(change: Change, (width, height): (u32, u32)) -> Homography {
    let middle = Vector2::new((f64::from(width) - 1.0) / 2.0, (f64::from(height) - 1.0) / 2.0);
    let focal = DISTANCE * f64::from(width.max(1));
    let (to_middle, back) = (Matrix3::new_translation(&-middle), Matrix3::new_translation(&middle));
    let about_middle = match change {
        Change::Roll(degrees) => Matrix3::new_rotation(degrees.to_radians()),
        Change::Zoom(factor) => Matrix3::new_scaling(factor),
        Change::Tilt(degrees) => {
            // A plane at distance f rotated about the vertical axis through its centre: x' = f x
            // cos / (f + x sin).
            let (sin, cos) = degrees.to_radians().sin_cos();
            Matrix3::new(cos, 0.0, 0.0, 0.0, 1.0, 0.0, sin / focal, 0.0, 1.0)
        }
        Change::Blur(_) | Change::Light(..) => Matrix3::identity(),
    };
    Homography(back * about_middle * to_middle)
}

/// Warps the picture by the homography, averaging over each pixel's square.
fn warped(source: &FloatImage, homography: &Homography) -> FloatImage {
    let mut view = FloatImage::new(source.width, source.height);
    let Some(inverse) = homography.0.try_inverse().map(Homography) else { return view };
    let inside = |p: &Vector2<f64>| p.x > -0.5 && p.y > -0.5 && p.x < source.width as f64 - 0.5 && p.y < source.height as f64 - 0.5;
    let offset = |k: usize| (k as f64 + 0.5) / SAMPLES as f64 - 0.5;
    for y in 0..view.height {
        for x in 0..view.width {
            let mut sum = 0.0;
            for sample in 0..SAMPLES * SAMPLES {
                let p = Vector2::new(x as f64 + offset(sample % SAMPLES), y as f64 + offset(sample / SAMPLES));
                sum += inverse.map(p).filter(inside).map_or(BESIDE, |q| source.bilinear(q.x as f32, q.y as f32));
            }
            view.values[y * source.width + x] = sum / (SAMPLES * SAMPLES) as f32;
        }
    }
    view
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rendered_points_match_the_homography() {
        let spot = |at: Vector2<f64>| {
            GrayImage::from_fn(160, 120, |x, y| {
                let d2 = (f64::from(x) - at.x).powi(2) + (f64::from(y) - at.y).powi(2);
                image::Luma([(40.0 + 200.0 * (-0.5 * d2 / 9.0).exp()) as u8])
            })
        };
        for change in [Change::Roll(30.0), Change::Zoom(0.7), Change::Tilt(50.0), Change::Blur(2.0), Change::Light(0.5, 0.0)] {
            let at = Vector2::new(95.0, 52.0);
            let (view, homography) = changed(&spot(at), change, 1);
            let expected = homography.map(at).expect("in front");
            let (mut sum, mut mean) = (0.0, Vector2::zeros());
            for (x, y, v) in view.enumerate_pixels() {
                let p = Vector2::new(f64::from(x), f64::from(y));
                let level = if matches!(change, Change::Light(..)) { 60.0 } else { 120.0 };
                let weight = (f64::from(v[0]) - level).max(0.0) * f64::from((p - expected).norm() < 12.0);
                (sum, mean) = (sum + weight, mean + weight * p);
            }
            assert!(sum > 0.0 && (mean / sum - expected).norm() < 0.3, "{change:?}: {} for {expected}", mean / sum);
        }
    }

    #[test]
    fn empty_and_tiny_pictures_keep_their_size() {
        let (view, _) = changed(&GrayImage::new(0, 0), Change::Tilt(50.0), 1);
        assert_eq!(view.dimensions(), (0, 0));
        assert_eq!(changed(&GrayImage::new(3, 1), Change::Roll(30.0), 1).0.dimensions(), (3, 1));
    }
}
