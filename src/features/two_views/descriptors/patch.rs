//! The pixels around a keypoint as grey levels of zero mean and unit norm. The dot product of two
//! patches is their normalised cross-correlation (ZNCC), and half their squared distance is 1 -
//! ZNCC.
//!
//! Upright and of fixed size: not invariant to rotation or scale, but to any change of brightness
//! and contrast.

use super::Describer;
use crate::features::two_views::keypoint::{Descriptors, Features, Keypoint, PictureForms};

/// Describes a keypoint by the surrounding pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PatchDescriber {
    /// Pixels from the centre to the border: a patch has (2 `half_width` + 1)² values. Default 20:
    /// 41 x 41 = 1681. Raised, patches are more distinctive, differ more between two views, and are
    /// compared more slowly. Limited to 100.
    pub half_width: usize,
}

impl Default for PatchDescriber {
    fn default() -> Self {
        Self { half_width: 20 }
    }
}

/// Maximum half-width used, pixels: 40401 values each. Raised, a few thousand patches fill the
/// memory of a small computer.
const MAX_HALF_WIDTH: usize = 100;
/// Minimum standard deviation of a patch, grey levels: half a rounding step. Patches with less are
/// uniform except for rounding; raised, faint ones are dropped too.
const MIN_DEVIATION: f64 = 0.5;

impl Describer for PatchDescriber {
    fn describe(&self, picture: &PictureForms, keypoints: &[Keypoint]) -> Features {
        let reach = self.half_width.min(MAX_HALF_WIDTH) as isize;
        let side = 2 * reach as usize + 1;
        let float = picture.float();
        let mut kept = Vec::new();
        let mut values = Vec::new();
        let mut patch = Vec::with_capacity(side * side);
        for keypoint in picture.watch.over(keypoints) {
            let (x, y) = (keypoint.position.x, keypoint.position.y);
            let inside = |v: f64, size: usize| v >= reach as f64 && v <= size as f64 - 1.0 - reach as f64;
            if !inside(x, float.width) || !inside(y, float.height) {
                continue;
            }
            patch.clear();
            for dy in -reach..=reach {
                patch.extend((-reach..=reach).map(|dx| float.bilinear((x + dx as f64) as f32, (y + dy as f64) as f32)));
            }
            if normalise(&mut patch) {
                kept.push(*keypoint);
                values.extend_from_slice(&patch);
            }
        }
        Features { keypoints: kept, descriptors: Descriptors::Vectors { length: side * side, values } }
    }
}

/// Normalises a patch to zero mean and unit norm; returns false if it is uniform.
fn normalise(patch: &mut [f32]) -> bool {
    let count = patch.len() as f64;
    let mean = patch.iter().map(|v| f64::from(*v)).sum::<f64>() / count;
    let squares = patch.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>();
    if squares < count * MIN_DEVIATION * MIN_DEVIATION {
        return false;
    }
    let factor = 1.0 / squares.sqrt();
    patch.iter_mut().for_each(|v| *v = ((f64::from(*v) - mean) * factor) as f32);
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, Luma};
    use nalgebra::Vector2;

    fn waves(gain: f64, offset: f64) -> GrayImage {
        GrayImage::from_fn(80, 60, |x, y| {
            let (x, y) = (f64::from(x), f64::from(y));
            Luma([(offset + gain * ((0.31 * x + 0.1 * y).sin() + (0.23 * y - 0.05 * x).cos())).round() as u8])
        })
    }

    fn describe(describer: PatchDescriber, picture: &GrayImage, places: &[(f64, f64)]) -> (usize, Vec<f32>) {
        let keypoints: Vec<_> = places.iter().map(|(x, y)| Keypoint::round(Vector2::new(*x, *y), 2.0, 1.0)).collect();
        let features = describer.describe(&PictureForms::new(picture), &keypoints);
        let Descriptors::Vectors { length, values } = features.descriptors else { panic!("a patch is a vector") };
        assert_eq!(values.len(), length * features.keypoints.len());
        (features.keypoints.len(), values)
    }

    #[test]
    fn a_half_width_20_patch_has_1681_zero_mean_unit_norm_values() {
        let (count, values) = describe(PatchDescriber::default(), &waves(50.0, 120.0), &[(40.0, 30.0)]);
        assert_eq!((count, values.len()), (1, 1681));
        assert!(values.iter().sum::<f32>().abs() < 1e-3);
        assert!((values.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-4);
    }

    #[test]
    fn the_dot_product_ignores_brightness_and_contrast() {
        let describer = PatchDescriber { half_width: 8 };
        let (_, a) = describe(describer, &waves(50.0, 120.0), &[(40.3, 30.6), (25.0, 20.0)]);
        let (_, b) = describe(describer, &waves(20.0, 60.0), &[(40.3, 30.6)]);
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        assert!(dot(&a[..289], &b) > 0.998, "{}", dot(&a[..289], &b));
        assert!(dot(&a[289..], &b) < 0.9, "{}", dot(&a[289..], &b));
    }

    #[test]
    fn patches_are_sampled_at_subpixel_positions() {
        // A step of 100 grey levels: half a pixel further, the step moves along.
        let describer = PatchDescriber { half_width: 3 };
        let picture = GrayImage::from_fn(40, 40, |x, _| Luma([if x < 20 { 50 } else { 150 }]));
        let (_, values) = describe(describer, &picture, &[(19.5, 20.0)]);
        // Columns 16.5 … 22.5: three dark, one halfway, three bright.
        assert!((values[3]).abs() < 1e-4 && (values[0] + values[6]).abs() < 1e-4 && values[2] < 0.0 && values[4] > 0.0);
    }

    #[test]
    fn uniform_patches_and_those_across_the_border_are_dropped() {
        let places = [(40.0, 30.0), (19.9, 30.0), (40.0, 39.1), (f64::NAN, 3.0), (f64::INFINITY, 9.0)];
        assert_eq!(describe(PatchDescriber::default(), &waves(50.0, 120.0), &places).0, 1);
        assert_eq!(describe(PatchDescriber::default(), &GrayImage::from_pixel(80, 60, Luma([9])), &places).0, 0);
        for (w, h) in [(0, 0), (1, 1), (50, 1)] {
            let empty = GrayImage::new(w, h);
            assert_eq!(describe(PatchDescriber { half_width: usize::MAX }, &empty, &places).0, 0);
            assert_eq!(describe(PatchDescriber { half_width: 0 }, &empty, &[(0.0, 0.0)]).0, 0);
        }
    }
}
