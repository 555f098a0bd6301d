//! Saliency at one scale: the two measures of the affine detectors, both scale-normalised
//! (Mikolajczyk & Schmid, Scale & Affine Invariant Interest Point Detectors, IJCV 2004, sections 2
//! and 3; Lindeberg, Feature Detection with Automatic Scale Selection, IJCV 1998, for the
//! determinant over scales).

use crate::features::float_image::FloatImage;
use crate::features::two_views::second_moments::SecondMoments;
use crate::simd::multiversion;

/// The measure whose maxima are keypoints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AffineMeasure {
    /// Corners: the Harris & Stephens measure of the second-moment matrix; their scale is the
    /// Laplacian's extremum.
    Harris,
    /// Blobs: the determinant of the Hessian matrix, over position and scale.
    #[default]
    Hessian,
}

/// Weight of the squared trace in the Harris measure (IJCV 2004, section 2.1, commonly used).
/// Raised, corners must be closer to a right angle.
const HARRIS_K: f32 = 0.04;
/// Ratio of the derivatives' sigma to the window's. Two copies of a scale space with three per
/// octave are this far apart; Mikolajczyk & Schmid use 0.7 (section 2.1), and 0.5 to 0.75 for
/// shapes (section 4.2). Raised, the window holds fewer independent gradients; lowered, noise
/// counts more.
pub const DERIVATIVE_SHARE: f64 = 0.629_960_524_947_436_6;
/// Fourth root of the Harris measure of a right-angled corner of one grey level contrast, with no
/// smoothing but the measure's own (computed from such a corner of many pixels).
const CORNER: f64 = 0.1668;
/// Square root of the determinant of a round Gaussian blob of one grey level contrast at its own
/// scale, where its second derivatives are a quarter.
const BLOB: f64 = 0.25;

impl AffineMeasure {
    /// Returns the measure of each pixel of a picture smoothed by `sigma` pixels; `fine` is the
    /// same smoothed by `DERIVATIVE_SHARE` of it.
    pub fn strength(self, smooth: &FloatImage, fine: &FloatImage, sigma: f64) -> FloatImage {
        let mut out = FloatImage::new(smooth.width, smooth.height);
        if out.width < 3 || out.height < 3 {
            return out;
        }
        let squared = (sigma * sigma) as f32;
        match self {
            Self::Hessian => determinants(smooth, squared * squared, &mut out.values),
            Self::Harris => {
                let moments = SecondMoments::of_smoothed(fine, sigma);
                corners(&moments, squared * (DERIVATIVE_SHARE * DERIVATIVE_SHARE) as f32, &mut out.values);
            }
        }
        out
    }

    /// Returns the value that is maximal at the structure's scale at a pixel of a picture smoothed
    /// by `sigma` pixels: the magnitude of the normalised Laplacian, or the determinant. Zero at
    /// the border.
    pub fn at_scale(self, smooth: &FloatImage, sigma: f64, x: usize, y: usize) -> f64 {
        let Some([xx, yy, xy]) = derivatives_at(smooth, x, y) else { return 0.0 };
        let squared = sigma * sigma;
        match self {
            Self::Hessian => squared * squared * (xx * yy - xy * xy),
            Self::Harris => squared * (xx + yy).abs(),
        }
    }

    /// Whether the structure at a pixel can be a blob with axes of at most `ratio`: in the round
    /// window of its size, a Gaussian blob's second derivatives along its axes have the ratio of
    /// the axes. For corners the measure itself bounds it.
    pub fn is_bounded(self, smooth: &FloatImage, x: usize, y: usize, ratio: f64) -> bool {
        if self == Self::Harris {
            return true;
        }
        let Some([xx, yy, xy]) = derivatives_at(smooth, x, y) else { return false };
        (xx + yy).powi(2) * ratio <= (ratio + 1.0).powi(2) * (xx * yy - xy * xy)
    }

    /// Converts a strength to the contrast in grey levels of the blob or corner that would have it.
    pub fn contrast(self, strength: f64) -> f64 {
        match self {
            Self::Hessian => strength.max(0.0).sqrt() / BLOB,
            Self::Harris => strength.max(0.0).sqrt().sqrt() / CORNER,
        }
    }

    /// Converts the contrast of a blob or corner in grey levels to its strength.
    pub fn of_contrast(self, contrast: f64) -> f64 {
        match self {
            Self::Hessian => (BLOB * contrast.max(0.0)).powi(2),
            Self::Harris => (CORNER * contrast.max(0.0)).powi(4),
        }
    }
}

/// Returns the second derivatives at a pixel: horizontal, vertical and mixed; `None` at the border.
fn derivatives_at(smooth: &FloatImage, x: usize, y: usize) -> Option<[f64; 3]> {
    if x == 0 || y == 0 || x + 1 >= smooth.width || y + 1 >= smooth.height {
        return None;
    }
    let [above, here, below] = [y - 1, y, y + 1].map(|k| smooth.row(k)[x - 1..].first_chunk());
    Some(second_derivatives(above?, here?, below?).map(f64::from))
}

/// Returns the second derivatives, horizontal, vertical and mixed, from a pixel's eight neighbours.
#[inline(always)]
fn second_derivatives(above: &[f32; 3], here: &[f32; 3], below: &[f32; 3]) -> [f32; 3] {
    let twice = 2.0 * here[1];
    [here[0] + here[2] - twice, above[1] + below[1] - twice, 0.25 * (above[0] + below[2] - above[2] - below[0])]
}

multiversion! {
    /// Computes the determinants of the Hessian matrix of the inner pixels, times `factor`.
    fn determinants(smooth: &FloatImage, factor: f32, out: &mut [f32]); ["avx2"] => determinants_plain, else determinants_plain
}

#[inline(always)]
fn determinants_plain(smooth: &FloatImage, factor: f32, out: &mut [f32]) {
    let w = smooth.width;
    for (y, out) in out.chunks_exact_mut(w).enumerate().take(smooth.height - 1).skip(1) {
        let rows = [smooth.row(y - 1), smooth.row(y), smooth.row(y + 1)];
        let n = w - 2;
        let [[a, b, c], [d, e, f], [g, h, i]] = rows.map(|row| [&row[..n], &row[1..=n], &row[2..n + 2]]);
        for (k, out) in out[1..=n].iter_mut().enumerate() {
            let [xx, yy, xy] = second_derivatives(&[a[k], b[k], c[k]], &[d[k], e[k], f[k]], &[g[k], h[k], i[k]]);
            *out = factor * (xx * yy - xy * xy);
        }
    }
}

multiversion! {
    /// Computes the Harris measure of every pixel, of moments times `factor`.
    fn corners(moments: &SecondMoments, factor: f32, out: &mut [f32]); ["avx2"] => corners_plain, else corners_plain
}

#[inline(always)]
fn corners_plain(moments: &SecondMoments, factor: f32, out: &mut [f32]) {
    let values = moments.xx.values.iter().zip(&moments.yy.values).zip(&moments.xy.values);
    for (out, ((xx, yy), xy)) in out.iter_mut().zip(values) {
        let (xx, yy, xy) = (factor * xx, factor * yy, factor * xy);
        *out = xx * yy - xy * xy - HARRIS_K * (xx + yy) * (xx + yy);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture as a function of position relative to its centre.
    fn picture(side: usize, level: impl Fn(f64, f64) -> f64) -> FloatImage {
        let half = (side / 2) as f64;
        let values = (0..side * side).map(|k| level((k % side) as f64 - half, (k / side) as f64 - half) as f32).collect();
        FloatImage { width: side, height: side, values }
    }

    #[test]
    fn a_blob_responds_most_at_its_own_scale() {
        let blob = picture(121, |x, y| 80.0 * (-0.5 * (x * x + y * y) / 36.0).exp());
        let [before, own, after] = [5.0, 6.0, 7.2].map(|sigma| AffineMeasure::Hessian.at_scale(&blob.blurred(sigma), sigma, 60, 60));
        assert!((AffineMeasure::Hessian.contrast(own) - 80.0).abs() < 2.0, "{own}");
        assert!(own > before && own > after, "{before} {own} {after}");
        let smooth = blob.blurred(6.0);
        let map = AffineMeasure::Hessian.strength(&smooth, &smooth, 6.0);
        assert!((f64::from(map.at(60, 60)) / own - 1.0).abs() < 1e-3);
        let [before, own, after] = [5.0, 6.0, 7.2].map(|sigma| AffineMeasure::Harris.at_scale(&blob.blurred(sigma), sigma, 60, 60));
        assert!(own > before && own > after && (own - 40.0).abs() < 1.0, "{before} {own} {after}");
    }

    #[test]
    fn a_right_angle_corner_responds_and_an_edge_does_not() {
        let corner = picture(161, |x, y| if x > 0.0 && y > 0.0 { 100.0 } else { 0.0 });
        let edge = picture(161, |x, _| if x > 0.0 { 100.0 } else { 0.0 });
        let most = |picture: &FloatImage| {
            let (sigma, fine) = (8.0, picture.blurred(8.0 * DERIVATIVE_SHARE));
            let map = AffineMeasure::Harris.strength(&picture.blurred(sigma), &fine, sigma);
            f64::from(map.values.iter().fold(f32::MIN, |a, b| a.max(*b)))
        };
        assert!((AffineMeasure::Harris.contrast(most(&corner)) - 100.0).abs() < 3.0);
        assert!(most(&edge) <= 0.0);
    }

    #[test]
    fn the_response_to_a_long_blob_is_bounded_by_its_axis_ratio() {
        let blob = picture(121, |x, y| 80.0 * (-0.5 * (x * x / 144.0 + y * y / 9.0)).exp()).blurred(6.0);
        assert!(AffineMeasure::Hessian.is_bounded(&blob, 60, 60, 4.3) && !AffineMeasure::Hessian.is_bounded(&blob, 60, 60, 3.7));
        assert!(!AffineMeasure::Hessian.is_bounded(&blob, 0, 60, 9.0) && AffineMeasure::Harris.is_bounded(&blob, 60, 60, 2.0));
    }

    #[test]
    fn contrast_and_strength_are_inverse() {
        for measure in [AffineMeasure::Harris, AffineMeasure::Hessian] {
            assert!((measure.contrast(measure.of_contrast(37.0)) - 37.0).abs() < 1e-9);
            assert_eq!(measure.contrast(-1.0), 0.0);
        }
    }
}
