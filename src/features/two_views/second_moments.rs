//! Products of a picture's gradients averaged in a Gaussian window: the second-moment matrix of
//! each pixel, also called its structure tensor (Förstner & Gülch 1987; Harris & Stephens 1988).

use crate::features::float_image::FloatImage;
use crate::simd::multiversion;

/// Limits of sigmas, pixels: below, a Gaussian is a single pixel; above, it is wider than any
/// corner and takes seconds.
const SIGMAS: (f64, f64) = (0.01, 100.0);

/// The three distinct elements of the matrix of each pixel, in squared grey levels per squared
/// pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct SecondMoments {
    /// Mean square of the horizontal gradient.
    pub xx: FloatImage,
    /// Mean square of the vertical gradient.
    pub yy: FloatImage,
    /// Mean product of both.
    pub xy: FloatImage,
}

impl SecondMoments {
    /// Computes the moments of the picture smoothed by `derivative_sigma` pixels, in a window of
    /// `sigma` pixels.
    pub fn of(picture: &FloatImage, derivative_sigma: f64, sigma: f64) -> Self {
        Self::of_smoothed(&picture.blurred(within(derivative_sigma)), sigma)
    }

    /// Computes the moments of a picture without further smoothing, in a window of `sigma` pixels.
    pub fn of_smoothed(smooth: &FloatImage, sigma: f64) -> Self {
        let (across, down) = gradients(smooth);
        let gathered = |a: &FloatImage, b: &FloatImage| {
            let values = a.values.iter().zip(&b.values).map(|(a, b)| a * b).collect();
            FloatImage { width: a.width, height: a.height, values }.blurred(within(sigma))
        };
        Self { xx: gathered(&across, &across), yy: gathered(&down, &down), xy: gathered(&across, &down) }
    }
}

/// Clamps a sigma to the usable range.
pub fn within(sigma: f64) -> f64 {
    if sigma.is_nan() { SIGMAS.0 } else { sigma.clamp(SIGMAS.0, SIGMAS.1) }
}

/// Returns the horizontal and vertical gradients of each pixel, grey levels per pixel: half the
/// difference of its neighbours; at the border, of the pixel itself and its only neighbour.
pub fn gradients(picture: &FloatImage) -> (FloatImage, FloatImage) {
    let (mut across, mut down) = (FloatImage::new(picture.width, picture.height), FloatImage::new(picture.width, picture.height));
    if !picture.values.is_empty() {
        differences(picture, &mut across.values, &mut down.values);
    }
    (across, down)
}

multiversion! {
    fn differences(picture: &FloatImage, across: &mut [f32], down: &mut [f32]); ["avx2"] => differences_plain, else differences_plain
}

#[inline(always)]
fn differences_plain(picture: &FloatImage, across: &mut [f32], down: &mut [f32]) {
    let (w, h) = (picture.width, picture.height);
    for (y, (across, down)) in across.chunks_exact_mut(w).zip(down.chunks_exact_mut(w)).enumerate() {
        let (row, above, below) = (picture.row(y), picture.row(y.saturating_sub(1)), picture.row((y + 1).min(h - 1)));
        for ((d, a), b) in down.iter_mut().zip(above).zip(below) {
            *d = 0.5 * (b - a);
        }
        if w > 1 {
            across[0] = 0.5 * (row[1] - row[0]);
            across[w - 1] = 0.5 * (row[w - 1] - row[w - 2]);
            for ((d, a), b) in across[1..w - 1].iter_mut().zip(row).zip(&row[2..]) {
                *d = 0.5 * (b - a);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn second_moments_of_a_ramp_are_its_slope_products() {
        let values = (0..900).map(|k| 3.0 * (k % 30) as f32 - 2.0 * (k / 30) as f32).collect();
        let moments = SecondMoments::of(&FloatImage { width: 30, height: 30, values }, 1.0, 1.0);
        let middle = 15 * 30 + 15;
        for (image, expected) in [(&moments.xx, 9.0), (&moments.yy, 4.0), (&moments.xy, -6.0)] {
            assert!((image.values[middle] - expected).abs() < 1e-3, "{} not {expected}", image.values[middle]);
        }
    }

    #[test]
    fn second_moments_exist_for_every_size_and_sigma() {
        for (width, height) in [(0, 0), (1, 1), (1, 9), (9, 1), (2, 2)] {
            for sigma in [f64::NAN, -1.0, 0.0, 2.0] {
                let moments = SecondMoments::of(&FloatImage::new(width, height), sigma, sigma);
                assert!(moments.xx.values.iter().all(|v| *v == 0.0));
            }
        }
    }
}
