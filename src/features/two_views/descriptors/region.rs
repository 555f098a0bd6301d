//! The pixels around a keypoint, smoothed to its scale. For a round region it is a copy of the
//! scale space itself; for an ellipse, a patch of the picture in which the ellipse becomes a circle
//! (Mikolajczyk & Schmid, Scale & Affine Invariant Interest Point Detectors, IJCV 2004, section
//! 4.1).

use nalgebra::{Matrix2, Vector2};

use crate::features::two_views::FloatImage;
use crate::features::two_views::keypoint::{Keypoint, PictureForms};
use crate::features::two_views::scale_space::SmoothedCopy;

/// A region as a descriptor reads it.
#[derive(Debug, Clone, Copy)]
pub struct Region<'a> {
    /// Picture, smoothed by about `sigma`.
    pub image: &'a FloatImage,
    /// Position of the keypoint in it.
    pub middle: Vector2<f64>,
    /// Sigma of the region in it, pixels.
    pub sigma: f64,
}

/// Sigma of an elliptic region in its patch, pixels. Raised, patches are finer and take longer;
/// below 1.5 they lose detail.
const PATCH_SIGMA: f64 = 2.0;
/// Half the side of a patch in sigmas: what SIFT reads, five bins of three sigmas rotated by 45
/// degrees, plus a pixel for the gradient. Lowered, SIFT's corners are cut off.
const PATCH_REACH: f64 = 11.5;
/// Half the side of a patch, pixels.
const HALF: usize = (PATCH_REACH * PATCH_SIGMA) as usize;
/// Samples of a copy per sigma of its own smoothing. Raised, patches take proportionally longer
/// along either axis; below 1, detail between samples is lost.
const SAMPLES_PER_SIGMA: f64 = 1.5;
/// Maximum number of samples for a patch. Only a region far larger than its picture, or a needle,
/// needs more. Raised, such a region may take very long.
const MAX_SAMPLES: f64 = 1e6;

/// Reusable buffers for elliptic regions.
#[derive(Debug, Default)]
pub struct Patch {
    samples: FloatImage,
    row: Vec<f32>,
    patch: FloatImage,
}

impl Patch {
    /// Returns the region of a keypoint, and the keypoint in that region's frame: the same ellipse
    /// without its previous orientation. `None` for regions outside the picture, not finite or far
    /// too large, and for pictures too small to be smoothed.
    pub fn region<'a>(&'a mut self, picture: &'a PictureForms, keypoint: &Keypoint) -> Option<(Region<'a>, Keypoint)> {
        let [width, height] = [picture.grey.width(), picture.grey.height()].map(f64::from);
        let [x, y] = [keypoint.position.x, keypoint.position.y];
        let inside = (0.0..=width - 1.0).contains(&x) && (0.0..=height - 1.0).contains(&y);
        if !inside || !keypoint.shape.iter().all(|v| v.is_finite()) || keypoint.shape.determinant() <= 0.0 {
            return None;
        }
        if keypoint.is_round() {
            let copy = picture.scale_space().nearest(keypoint.scale())?;
            let (middle, sigma) = (copy.octave.in_octave(keypoint.position), keypoint.scale() / copy.octave.step);
            let keypoint = Keypoint::round(keypoint.position, keypoint.scale(), keypoint.response);
            return Some((Region { image: copy.image, middle, sigma }, keypoint));
        }
        let (axes, sigmas) = short_and_long_axis(&keypoint.shape)?;
        self.warp(picture, keypoint.position, axes, sigmas)?;
        let keypoint = Keypoint { shape: axes * Matrix2::from_diagonal(&sigmas), ..*keypoint };
        Some((Region { image: &self.patch, middle: Vector2::from_element(HALF as f64), sigma: PATCH_SIGMA }, keypoint))
    }

    /// Fills the patch; its columns run along the short axis, its rows along the long one. Samples
    /// the copy smoothed nearly as much as the short axis requires, as densely as that copy needs,
    /// so that the time depends only on the ratio of the axes.
    fn warp(&mut self, picture: &PictureForms, position: Vector2<f64>, axes: Matrix2<f64>, sigmas: Vector2<f64>) -> Option<()> {
        let copy = picture.scale_space().at_most(sigmas.min())?;
        // Samples per patch pixel along either axis.
        let finer = sigmas.map(|sigma| (SAMPLES_PER_SIGMA / PATCH_SIGMA * sigma / copy.sigma).ceil().max(1.0));
        let side = (2 * HALF + 1) as f64;
        if finer.product() * side * side > MAX_SAMPLES {
            return None;
        }
        let spacing = sigmas.component_div(&finer) / PATCH_SIGMA;
        self.sample(&copy, position, axes * Matrix2::from_diagonal(&spacing), [finer.x as usize, finer.y as usize]);
        // The smoothing missing from the copy along either axis.
        let missing = [0, 1].map(|k| (sigmas[k].powi(2) - copy.sigma.powi(2)).max(0.0).sqrt() / spacing[k]);
        self.samples.blur_and_thin_into(missing, [finer.x as usize, finer.y as usize], &mut self.patch, &mut self.row);
        Some(())
    }

    /// Samples a copy around a position of the picture; `steps` has the picture pixels from one
    /// sample to the next in its row and in its column.
    fn sample(&mut self, copy: &SmoothedCopy, position: Vector2<f64>, steps: Matrix2<f64>, finer: [usize; 2]) {
        let [across, down] = finer.map(|n| n * HALF);
        let (width, height) = (2 * across + 1, 2 * down + 1);
        (self.samples.width, self.samples.height) = (width, height);
        self.samples.values.resize(width * height, 0.0);
        let (middle, steps) = (copy.octave.in_octave(position), steps / copy.octave.step);
        for (y, row) in self.samples.values.chunks_exact_mut(width).enumerate() {
            let start = middle + steps * Vector2::new(-(across as f64), y as f64 - down as f64);
            copy.image.sample_line([start.x, start.y].map(|v| v as f32), [steps.m11, steps.m21].map(|v| v as f32), row);
        }
    }
}

/// Returns the directions of an ellipse's short and long axis as a right-handed frame, and its half
/// axes.
fn short_and_long_axis(shape: &Matrix2<f64>) -> Option<(Matrix2<f64>, Vector2<f64>)> {
    // The larger singular value comes first.
    let parts = shape.svd(true, false);
    let (axes, sigmas) = (parts.u?, parts.singular_values);
    let (short, long) = (axes.column(1), axes.column(0));
    let long = if axes.determinant() < 0.0 { long.into_owned() } else { -long };
    Some((Matrix2::from_columns(&[short.into_owned(), long]), Vector2::new(sigmas[1], sigmas[0])))
}

#[cfg(test)]
mod tests {
    use image::{GrayImage, Luma};

    use super::*;

    /// Waves of many wavelengths.
    fn texture() -> GrayImage {
        GrayImage::from_fn(400, 300, |x, y| {
            let wave = |k: u32| {
                let (angle, length) = (f64::from(k) * 2.4, 5.0 + f64::from(k * 7 % 40));
                ((f64::from(x) * angle.cos() + f64::from(y) * angle.sin()) / length * std::f64::consts::TAU + f64::from(k)).sin()
            };
            Luma([(128.0 + 14.0 * (0..20).map(wave).sum::<f64>()).round().clamp(0.0, 255.0) as u8])
        })
    }

    /// A patch pixel by definition: the mean of the copy under the missing Gaussian, densely
    /// sampled.
    fn plain_pixel(copy: &SmoothedCopy, keypoint: &Keypoint, axes: &Matrix2<f64>, offset: Vector2<f64>) -> f64 {
        let sigmas = Vector2::new(keypoint.shape.column(0).norm(), keypoint.shape.column(1).norm());
        let missing = sigmas.map(|s| (s * s - copy.sigma * copy.sigma).max(0.0).sqrt());
        let (mut sum, mut weights) = (0.0, 0.0);
        for k in 0..65 * 65 {
            let at = Vector2::new(f64::from(k % 65) - 32.0, f64::from(k / 65) - 32.0) / 8.0;
            let weight = (-0.5 * at.norm_squared()).exp();
            let place = keypoint.position + keypoint.shape * offset / PATCH_SIGMA + axes * at.component_mul(&missing);
            let place = copy.octave.in_octave(place);
            sum += weight * f64::from(copy.image.bilinear(place.x as f32, place.y as f32));
            weights += weight;
        }
        sum / weights
    }

    #[test]
    fn a_region_patch_matches_its_definition() {
        let picture = texture();
        let forms = PictureForms::new(&picture);
        let mut patch = Patch::default();
        for (middle, short, ratio, angle) in [
            ([200.0, 150.0], 1.3, 1.2, 0.4),
            ([200.4, 150.9], 1.9, 2.0, 1.9),
            ([120.7, 150.2], 2.5, 4.0, -0.7),
            ([250.7, 120.2], 5.0, 2.6, 2.7),
            ([9.1, 30.0], 3.1, 3.0, 0.2),
        ] {
            let rotation = nalgebra::Rotation2::new(angle).into_inner();
            let shape = rotation * Matrix2::new(short * ratio, 0.0, 0.0, short) * nalgebra::Rotation2::new(1.0).into_inner();
            let keypoint = Keypoint { position: Vector2::from(middle), shape, response: 1.0 };
            let (region, framed) = patch.region(&forms, &keypoint).unwrap();
            assert!((framed.shape * framed.shape.transpose() - shape * shape.transpose()).amax() < 1e-9 * short * short);
            assert!(framed.shape.determinant() > 0.0);
            let (axes, _) = short_and_long_axis(&shape).unwrap();
            let copy = forms.scale_space().at_most(short).unwrap();
            // Closer to the rim of the patch, smoothing repeats the rim.
            for k in 0..81 {
                let offset = Vector2::new(f64::from(k % 9) - 4.0, f64::from(k / 9) - 4.0) * 3.0;
                let exact = plain_pixel(&copy, &framed, &axes, offset);
                let at = (region.middle + offset).map(|v| v as usize);
                let fast = f64::from(region.image.row(at.y)[at.x]);
                assert!((fast - exact).abs() < 0.3, "{short} {ratio} {offset:?}: {fast} not {exact}");
            }
        }
    }
}
