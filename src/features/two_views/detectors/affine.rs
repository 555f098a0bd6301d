//! Harris-Affine and Hessian-Affine: corners or blobs found at every scale, each with the ellipse
//! that is covariant under any affine map of the picture (Mikolajczyk & Schmid, Scale & Affine
//! Invariant Interest Point Detectors, IJCV 2004, sections 3 and 4).

use nalgebra::{Matrix2, Vector2};

use super::affine_measure::AffineMeasure;
use super::shape_adaptation::{Limits, ShapeAdaptation};
use super::{Detector, strongest_first};
use crate::features::float_image::FloatImage;
use crate::features::two_views::keypoint::{Keypoint, PictureForms};
use crate::features::two_views::scale_space::Octave;
use crate::features::two_views::watch::Watch;

/// Options of the affine detectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AffineDetector {
    /// Corners or blobs. Default blobs.
    pub measure: AffineMeasure,
    /// Maximum number of keypoints, strongest first. Default 5000: more than a 640x480 picture
    /// usually has. Raised, matching takes quadratically longer.
    pub count: usize,
    /// Minimum contrast of the blob or corner, as a fraction of the range from black to white.
    /// Default 0.08: about the commonly used threshold for the determinant, 16 / 3 grey levels of
    /// its root (Perďoch, Chum & Matas, Efficient Representation of Local Geometry for Large Scale
    /// Object Retrieval, CVPR 2009, their program). Raised, fewer and stronger ones remain.
    pub contrast: f64,
    /// Maximum number of shape iterations. Default 16, as in the same program; most converge before
    /// the tenth (IJCV 2004). Raised, a few more converge.
    pub steps: usize,
    /// Minimum ratio of the eigenvalues of the second moments in the ellipse's frame. Default 0.95,
    /// as in the paper. Raised, shapes are more exact and take more iterations.
    pub isotropy: f64,
    /// Maximum ratio of an ellipse's axes. Default 6, as in the paper. Raised, needles are kept,
    /// whose length is uncertain.
    pub elongation: f64,
}

impl Default for AffineDetector {
    fn default() -> Self {
        Self { measure: AffineMeasure::default(), count: 5000, contrast: 0.08, steps: 16, isotropy: 0.95, elongation: 6.0 }
    }
}

/// Grey levels from black to white.
const RANGE: f64 = 255.0;
/// Fraction of the minimum contrast that a maximum needs before its shape is known: a blob with
/// axes 4 to 1 has 0.64 of its contrast in a round window. Raised, elongated blobs are lost.
const BEFORE_SHAPE: f64 = 0.6;
/// Maximum ratio of the axes of a maximum in its round window, as a multiple of the final limit: an
/// edge, which the iterations would only find to be a needle, is dropped at once, which saves a
/// fifth of the time. Lowered to 1, a twentieth of the keypoints is lost: few structures are
/// Gaussian blobs.
const MARGIN: f64 = 2.0;
/// Number of copies between the examined one and the finer one used for its derivatives.
const FINER: usize = 2;
/// Copies of an octave whose scale is examined. Each has a finer one for its derivatives, and one
/// on either side.
const LOOKED_AT: std::ops::RangeInclusive<usize> = FINER..=4;
/// Maximum distance of duplicate keypoints, in sigmas, in the frame of the stronger one. Raised,
/// more neighbours are merged.
const SAME_PLACE: f64 = 0.5;
/// Maximum ratio of the axes of duplicate ellipses, in the frame of the stronger one. Raised, more
/// different shapes are merged.
const SAME_SHAPE: f64 = 1.25;

impl Detector for AffineDetector {
    fn detect(&self, picture: &PictureForms) -> Vec<Keypoint> {
        let limits = Limits { steps: self.steps, isotropy: self.isotropy, elongation: self.elongation };
        let (width, height) = (picture.float().width, picture.float().height);
        let space = picture.scale_space();
        let mut adaptation = ShapeAdaptation::new(space, (width, height), self.measure, limits);
        let mut found = Vec::new();
        for octave in &space.octaves {
            for level in LOOKED_AT {
                for (x, y) in picture.watch.over(self.maxima(octave, level)) {
                    let place = octave.in_picture(Vector2::new(x as f64, y as f64));
                    found.extend(adaptation.adapted(place, Octave::sigma(level as f64) * octave.step));
                }
            }
        }
        found.retain(|k| f64::from(k.response) >= self.contrast * RANGE);
        strongest_first(&mut found);
        let mut found = distinct(&found, &picture.watch);
        found.truncate(self.count);
        found
    }
}

impl AffineDetector {
    /// Returns the pixels of a copy that are maxima of the measure in their copy and at the scale
    /// of their structure, row by row.
    fn maxima(&self, octave: &Octave, level: usize) -> Vec<(usize, usize)> {
        let sigma = |level: usize| Octave::sigma(level as f64);
        let map = self.measure.strength(&octave.levels[level], &octave.levels[level - FINER], sigma(level));
        let least = self.measure.of_contrast(BEFORE_SHAPE * self.contrast * RANGE) as f32;
        let at_its_scale = |&(x, y): &(usize, usize)| {
            let [before, here, after] = [level - 1, level, level + 1].map(|l| self.measure.at_scale(&octave.levels[l], sigma(l), x, y));
            here >= before && here >= after
        };
        let bounded = |&(x, y): &(usize, usize)| self.measure.is_bounded(&octave.levels[level], x, y, MARGIN * self.elongation);
        local_maxima(&map, least).into_iter().filter(bounded).filter(at_its_scale).collect()
    }
}

/// Returns inner pixels of at least `least`, positive, and above their neighbours; on ties the
/// first.
fn local_maxima(map: &FloatImage, least: f32) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    for y in 1..map.height.saturating_sub(1) {
        let [above, here, below] = [map.row(y - 1), map.row(y), map.row(y + 1)];
        for x in 1..map.width - 1 {
            let v = here[x];
            let first = v >= least && v > 0.0 && v > here[x - 1] && v >= here[x + 1];
            if first && above[x - 1..=x + 1].iter().all(|a| v > *a) && below[x - 1..=x + 1].iter().all(|b| v >= *b) {
                found.push((x, y));
            }
        }
    }
    found
}

/// Keeps the first of keypoints for which several scales led to the same ellipse.
fn distinct(sorted: &[Keypoint], watch: &Watch) -> Vec<Keypoint> {
    let mut kept: Vec<Keypoint> = Vec::new();
    for keypoint in watch.over(sorted) {
        if !kept.iter().any(|k| is_same(k, keypoint)) {
            kept.push(*keypoint);
        }
    }
    kept
}

/// Whether two keypoints have nearly the same ellipse.
fn is_same(a: &Keypoint, b: &Keypoint) -> bool {
    let Some(frame) = a.shape.try_inverse() else { return false };
    let between = frame * (b.position - a.position);
    if between.norm() > SAME_PLACE {
        return false;
    }
    let other: Matrix2<f64> = frame * b.shape;
    let axes = other.singular_values();
    axes.max() <= SAME_SHAPE && axes.min() >= 1.0 / SAME_SHAPE
}

#[cfg(test)]
mod tests {
    use image::{GrayImage, Luma};

    use super::*;
    use crate::features::test_pictures::{DEGENERATE, Ellipse, Painting, noise, rendered, view};
    use crate::features::two_views::repeatability::repeatability;

    const MEASURES: [AffineMeasure; 2] = [AffineMeasure::Harris, AffineMeasure::Hessian];

    fn detect(measure: AffineMeasure, picture: &GrayImage) -> Vec<Keypoint> {
        AffineDetector { measure, ..AffineDetector::default() }.detect(&PictureForms::new(picture))
    }

    /// A Gaussian blob with the axes as sigmas.
    fn blob(ellipse: &Ellipse, contrast: f64) -> GrayImage {
        rendered(140, 130, |p| 128.0 + contrast * (-0.5 * ellipse.distance(p).powi(2)).exp())
    }

    #[test]
    fn elliptic_blobs_are_found_with_position_axes_and_direction() {
        for contrast in [-100.0, 100.0] {
            for (k, axes) in [[6.0, 6.0], [9.0, 4.5], [5.0, 3.0], [14.0, 4.0], [10.0, 9.0]].into_iter().enumerate() {
                let middle = Vector2::new(68.3 + 0.37 * k as f64, 64.8 - 0.21 * k as f64);
                let ellipse = Ellipse { middle, axes, angle: 0.4 + k as f64 };
                let found = detect(AffineMeasure::Hessian, &blob(&ellipse, contrast));
                assert_eq!(found.len(), 1, "{ellipse:?}: {found:?}");
                assert!((found[0].position - middle).norm() < 0.05, "{ellipse:?}: {found:?}");
                let ratio = ellipse.shape().try_inverse().unwrap() * found[0].shape;
                assert!((ratio - Matrix2::identity()).amax() < 0.1, "{ellipse:?}: {ratio}");
                // The response is its contrast, whatever its shape.
                assert!((found[0].response - 100.0).abs() < 6.0, "{}", found[0].response);
            }
        }
    }

    #[test]
    fn keypoints_and_shapes_repeat_across_views() {
        let painting = Painting::new();
        for measure in MEASURES {
            let first = detect(measure, &painting.seen(&view(0.0, 0.0, 1.0)));
            assert!(first.len() > 40, "{measure:?}: {}", first.len());
            for (rotation, tilt, scale, share) in [(0.7, 0.0, 1.0, 0.6), (0.0, 0.7, 1.0, 0.4), (1.9, 0.52, 0.8, 0.3), (0.3, 1.05, 1.2, 0.2)]
            {
                let known = view(rotation, tilt, scale);
                let found = repeatability(&first, &detect(measure, &painting.seen(&known)), &known, [(300, 300); 2]);
                assert!(found.share > share && found.error_px.unwrap() < 0.6, "{measure:?} {rotation} {tilt} {scale}: {found:?}");
            }
        }
    }

    #[test]
    fn shapes_move_with_the_picture() {
        let painting = Painting::new();
        let first = detect(AffineMeasure::Hessian, &painting.seen(&view(0.0, 0.0, 1.0)));
        for (rotation, tilt, scale) in [(0.0, 0.0, 1.0), (0.8, 0.0, 0.9), (0.3, 0.8, 1.0), (2.0, 1.05, 1.2)] {
            let known = view(rotation, tilt, scale);
            let map = known.0.fixed_view::<2, 2>(0, 0).into_owned();
            let second = detect(AffineMeasure::Hessian, &painting.seen(&known));
            // Ratio of the axes of one ellipse in the frame of the other, for the most similar
            // shape at the same place.
            let mut ratios: Vec<f64> = Vec::new();
            for k in &first {
                let (place, shape) = (known.map(k.position).unwrap(), (map * k.shape).try_inverse().unwrap());
                let same = second.iter().filter(|s| (s.position - place).norm() < 1.0);
                let axes = same.map(|s| (shape * s.shape).singular_values()).map(|axes| axes.max() / axes.min());
                ratios.extend(axes.min_by(f64::total_cmp));
            }
            ratios.sort_by(f64::total_cmp);
            let median = ratios[ratios.len() / 2];
            // Circles would have a ratio of 1.43 at the third view, and of 2 at the last.
            assert!(ratios.len() > 50 && median < 1.1, "{rotation} {tilt} {scale}: {median} of {}", ratios.len());
        }
    }

    #[test]
    fn the_strongest_keypoints_are_kept_without_duplicates() {
        let picture = Painting::new().seen(&view(0.0, 0.0, 1.0));
        for measure in MEASURES {
            let all = detect(measure, &picture);
            assert!(all.windows(2).all(|pair| pair[0].response >= pair[1].response));
            let seven = AffineDetector { measure, count: 7, ..AffineDetector::default() }.detect(&PictureForms::new(&picture));
            assert_eq!(seven, all[..7]);
            for (n, a) in all.iter().enumerate() {
                assert!(all[..n].iter().all(|b| !is_same(b, a)));
                let axes = a.shape.singular_values();
                assert!(axes.max() <= 6.0 * axes.min() && a.shape.determinant() > 0.0, "{a:?}");
            }
            let faint = AffineDetector { measure, contrast: 0.4, ..AffineDetector::default() }.detect(&PictureForms::new(&picture));
            assert!(faint.len() < all.len() && faint.iter().all(|k| k.response >= 0.4 * 255.0));
        }
    }

    #[test]
    fn detection_is_repeatable_and_finds_nothing_in_blank_pictures() {
        let picture = noise(160, 120);
        for measure in MEASURES {
            assert_eq!(detect(measure, &picture), detect(measure, &picture));
            for (width, height) in DEGENERATE {
                for level in [0, 128, 255] {
                    assert!(detect(measure, &GrayImage::from_pixel(width, height, Luma([level]))).is_empty());
                }
                detect(measure, &noise(width, height)).iter().for_each(|k| assert!(k.shape.iter().all(|v| v.is_finite())));
            }
            let edge = GrayImage::from_fn(90, 90, |x, y| Luma([if 2 * x + y > 135 { 200 } else { 40 }]));
            assert!(detect(measure, &edge).iter().all(|k| !k.position.iter().all(|c| (25.0..65.0).contains(c))));
            let odd = AffineDetector { contrast: f64::NAN, isotropy: f64::NAN, elongation: f64::NAN, steps: 3, measure, count: 9 };
            assert!(odd.detect(&PictureForms::new(&picture)).is_empty());
            let all = AffineDetector { contrast: -1.0, isotropy: 0.0, elongation: 1e9, steps: 40, measure, count: usize::MAX };
            assert!(all.detect(&PictureForms::new(&noise(60, 50))).iter().all(|k| k.shape.determinant() > 0.0));
        }
    }
}
