//! The three distinct elements of a keypoint's second-moment matrix: mean squares of the horizontal
//! and vertical gradient, and the mean of their product.
//!
//! Three numbers distinguish few corners: it exists for comparison, not for matching. It is not
//! invariant to rotation or contrast.

use super::Describer;
use crate::features::two_views::keypoint::{Descriptors, Features, Keypoint, PictureForms};
use crate::features::two_views::second_moments::SecondMoments;

/// Describes a keypoint by its second-moment matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StructureTensorDescriber {
    /// Sigma of the window in which gradients are averaged, pixels. Default 2. Raised, more of the
    /// surroundings count.
    pub sigma: f64,
    /// Sigma of the smoothing before taking gradients, pixels. Default 2. Raised, noise counts
    /// less, and so does detail.
    pub derivative_sigma: f64,
}

impl Default for StructureTensorDescriber {
    fn default() -> Self {
        Self { sigma: 2.0, derivative_sigma: 2.0 }
    }
}

/// Minimum sum of the mean squares, squared grey levels per squared pixel; less is uniform except
/// for rounding. Raised, faint places are dropped.
const MIN_TRACE: f32 = 1e-3;

impl Describer for StructureTensorDescriber {
    fn describe(&self, picture: &PictureForms, keypoints: &[Keypoint]) -> Features {
        let float = picture.float();
        let moments = SecondMoments::of(float, self.derivative_sigma, self.sigma);
        let mut kept = Vec::new();
        let mut values = Vec::new();
        for keypoint in picture.watch.over(keypoints) {
            let (x, y) = (keypoint.position.x, keypoint.position.y);
            let inside = |v: f64, size: usize| v >= 0.0 && v <= size as f64 - 1.0;
            if !inside(x, float.width) || !inside(y, float.height) {
                continue;
            }
            let [xx, yy, xy] = [&moments.xx, &moments.yy, &moments.xy].map(|image| image.bilinear(x as f32, y as f32));
            if xx + yy >= MIN_TRACE {
                kept.push(*keypoint);
                values.extend([xx, yy, xy]);
            }
        }
        Features { keypoints: kept, descriptors: Descriptors::Vectors { length: 3, values } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, Luma};
    use nalgebra::Vector2;

    #[test]
    fn structure_tensor_of_a_ramp_is_its_slope_products() {
        let ramp = GrayImage::from_fn(40, 40, |x, y| Luma([(2 * x + 3 * y) as u8]));
        let at = |x: f64, y: f64| Keypoint::round(Vector2::new(x, y), 2.0, 1.0);
        let keypoints = [at(20.3, 19.6), at(-1.0, 3.0), at(3.0, f64::NAN)];
        let features = StructureTensorDescriber::default().describe(&PictureForms::new(&ramp), &keypoints);
        assert_eq!(features.keypoints, keypoints[..1]);
        let Descriptors::Vectors { length: 3, values } = features.descriptors else { panic!("three numbers") };
        for (value, expected) in values.iter().zip([4.0, 9.0, 6.0]) {
            assert!((value - expected).abs() < 0.05, "{values:?}");
        }
        for even in [GrayImage::from_pixel(40, 40, Luma([200])), GrayImage::new(0, 0), GrayImage::new(1, 30)] {
            let features = StructureTensorDescriber::default().describe(&PictureForms::new(&even), &keypoints);
            assert!(features.keypoints.is_empty() && features.descriptors.is_empty());
        }
    }
}
