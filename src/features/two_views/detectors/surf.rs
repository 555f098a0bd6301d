//! Maxima of the determinant of the Hessian over position and scale, with box filters instead of
//! Gaussian derivatives (Bay, Ess, Tuytelaars & Van Gool, Speeded-Up Robust Features (SURF), CVIU
//! 2008, section 3): blobs with a sigma of their own.
//!
//! Box filters are not rotation invariant; the worst case is 45 degrees (section 3.2). Anything but
//! a round blob then moves by a good half pixel. Under camera roll or approach, SIFT's keypoints
//! are more repeatable; under changes of light or focus only, these are.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::{Detector, strongest_first};
use crate::features::two_views::integral_image::IntegralImage;
use crate::features::two_views::keypoint::{Keypoint, PictureForms};
use crate::features::two_views::watch::Watch;

/// Which maxima to keep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfDetector {
    /// Maximum number of keypoints, strongest first. Default 5000: more than a 640x480 picture
    /// usually has. Raised, matching takes quadratically longer.
    pub count: usize,
    /// Minimum determinant, squared grey levels, of filters divided by their squared side. Default
    /// 10, about 3 grey levels of second difference. Raised, fewer and stronger ones remain.
    pub least_determinant: f64,
    /// Number of octaves of scales. Default 4 (section 3.3), at most 8. Raised, larger blobs are
    /// found, which are few.
    pub octaves: usize,
}

impl Default for SurfDetector {
    fn default() -> Self {
        Self { count: 5000, least_determinant: 10.0, octaves: 4 }
    }
}

/// Filters per octave: two inner ones that can hold a maximum, and one on either side (section
/// 3.3).
const LAYERS: usize = 4;
/// Maximum number of octaves: the filters of the eighth are 3075 pixels wide.
const MAX_OCTAVES: usize = 8;
/// Ratio of the sigma of the Gaussian that a filter approximates to its side (section 3.2: 1.2
/// pixels at side 9).
const SIGMA_BY_SIDE: f64 = 1.2 / 9.0;
/// Squared weight of the mixed derivative, which compensates for the box approximation (section
/// 3.2, equation 3: 0.9).
const MIXED: f32 = 0.81;
/// Maximum offset from the maximum to its fit, samples or layers. The layers are coarse, and the
/// fit of a blob whose scale is between two of them may lead more than half way to the next layer,
/// which is not larger all the same: at 0.5 those blobs are lost. Raised, meaningless fits are
/// kept.
const MAX_OFFSET: f64 = 1.0;

/// Determinants for one filter side, sampled every `step` pixels.
struct Layer {
    width: usize,
    height: usize,
    /// 0 where the filter does not fit into the picture.
    values: Vec<f32>,
}

impl Detector for SurfDetector {
    fn detect(&self, picture: &PictureForms) -> Vec<Keypoint> {
        let integral = picture.integral();
        let mut found = Vec::new();
        for octave in 0..self.octaves.min(MAX_OCTAVES) {
            let (step, sides) = (1 << octave, sides(octave));
            if sides[LAYERS - 1] + 2 * step > integral.width.min(integral.height) {
                break;
            }
            let layers = sides.map(|side| layer(integral, side, step, &picture.watch));
            for middle in 1..LAYERS - 1 {
                let three = [&layers[middle - 1], &layers[middle], &layers[middle + 1]];
                let spacing = (sides[1] - sides[0]) as f64;
                for (x, y) in maxima(three, self.least_determinant as f32) {
                    let Some(offset) = fitted(three, x, y) else { continue };
                    let place = Vector2::new(x as f64 + offset.x, y as f64 + offset.y) * step as f64;
                    let sigma = (sides[middle] as f64 + offset.z * spacing) * SIGMA_BY_SIDE;
                    found.push(Keypoint::round(place, sigma, three[1].values[y * three[1].width + x]));
                }
            }
        }
        strongest_first(&mut found);
        found.truncate(self.count);
        found
    }
}

/// Returns the sides of an octave's filters: 9, 15, 21, 27; 15, 27, 39, 51; … (section 3.3, figure
/// 5).
fn sides(octave: usize) -> [usize; LAYERS] {
    std::array::from_fn(|k| 3 * ((2 << octave) * (k + 1) + 1))
}

/// Returns the Hessian's elements [xx, yy, xy] for a filter `side` pixels wide centred at a pixel,
/// as far as it is inside the picture; divided by the squared side.
fn hessian(integral: &IntegralImage, x: isize, y: isize, side: usize) -> [f32; 3] {
    let (lobe, half) = ((side / 3) as isize, (side / 2) as isize);
    let (inner, third) = (lobe / 2, lobe - 1);
    let whole = |x: (isize, isize), y: (isize, isize)| integral.sum((x.0, x.1 + 1), (y.0, y.1 + 1));
    let xx = whole((x - half, x + half), (y - third, y + third)) - 3.0 * whole((x - inner, x + inner), (y - third, y + third));
    let yy = whole((x - third, x + third), (y - half, y + half)) - 3.0 * whole((x - third, x + third), (y - inner, y + inner));
    let xy = whole((x - lobe, x - 1), (y - lobe, y - 1)) + whole((x + 1, x + lobe), (y + 1, y + lobe))
        - whole((x + 1, x + lobe), (y - lobe, y - 1))
        - whole((x - lobe, x - 1), (y + 1, y + lobe));
    let area = (side * side) as f32;
    [xx / area, yy / area, xy / area]
}

/// Returns the Hessian's elements [xx, yy, xy] at a keypoint, for the filter whose side fits its
/// scale.
pub fn surf_hessian(integral: &IntegralImage, place: Vector2<f64>, scale: f64) -> [f32; 3] {
    // Sides are odd multiples of 3 and at least 9.
    let lobe = (scale / SIGMA_BY_SIDE / 3.0).clamp(3.0, 1e6) as usize | 1;
    hessian(integral, place.x.round() as isize, place.y.round() as isize, 3 * lobe)
}

/// Computes a filter's determinants over the whole picture.
fn layer(integral: &IntegralImage, side: usize, step: usize, watch: &Watch) -> Layer {
    let (width, height) = (integral.width.div_ceil(step), integral.height.div_ceil(step));
    let mut values = vec![0.0; width * height];
    let half = side / 2;
    for y in watch.over(half.div_ceil(step)..(integral.height - half).div_ceil(step)) {
        for x in half.div_ceil(step)..(integral.width - half).div_ceil(step) {
            let [xx, yy, xy] = hessian(integral, (x * step) as isize, (y * step) as isize, side);
            values[y * width + x] = xx * yy - MIXED * xy * xy;
        }
    }
    Layer { width, height, values }
}

/// Returns samples of the middle layer above `least` and all 26 neighbours; on ties, the first.
fn maxima(three: [&Layer; 3], least: f32) -> Vec<(usize, usize)> {
    let middle = three[1];
    let mut found = Vec::new();
    for y in 1..middle.height.saturating_sub(1) {
        for x in 1..middle.width.saturating_sub(1) {
            let at = y * middle.width + x;
            let value = middle.values[at];
            // The two neighbours in its row reject most.
            if value <= least.max(0.0) || value <= middle.values[at - 1] || value < middle.values[at + 1] {
                continue;
            }
            let before = |k: usize, dy: usize| k == 0 || (k == 1 && dy == 0);
            let row = |k: usize, dy: usize| &three[k].values[at + dy * middle.width - middle.width - 1..][..3];
            let rows = (0..3).flat_map(|k| (0..3).map(move |dy| (k, dy))).filter(|r| *r != (1, 1));
            let is_largest = rows.clone().all(|(k, dy)| row(k, dy).iter().all(|v| if before(k, dy) { value > *v } else { value >= *v }));
            if is_largest {
                found.push((x, y));
            }
        }
    }
    found
}

/// Returns the offset from a sample to the maximum of the quadratic through it and its neighbours:
/// samples across and down, and layers (Brown & Lowe 2002). `None` if it is too far away, or a
/// layer has no filter there.
fn fitted(three: [&Layer; 3], x: usize, y: usize) -> Option<Vector3<f64>> {
    let width = three[1].width;
    let at = |dx: usize, dy: usize, k: usize| f64::from(three[k].values[(y + dy - 1) * width + x + dx - 1]);
    let middle = at(1, 1, 1);
    let slope = Vector3::new(at(2, 1, 1) - at(0, 1, 1), at(1, 2, 1) - at(1, 0, 1), at(1, 1, 2) - at(1, 1, 0)) * 0.5;
    let xx = at(2, 1, 1) + at(0, 1, 1) - 2.0 * middle;
    let yy = at(1, 2, 1) + at(1, 0, 1) - 2.0 * middle;
    let ss = at(1, 1, 2) + at(1, 1, 0) - 2.0 * middle;
    let xy = 0.25 * (at(2, 2, 1) - at(0, 2, 1) - at(2, 0, 1) + at(0, 0, 1));
    let xs = 0.25 * (at(2, 1, 2) - at(0, 1, 2) - at(2, 1, 0) + at(0, 1, 0));
    let ys = 0.25 * (at(1, 2, 2) - at(1, 0, 2) - at(1, 2, 0) + at(1, 0, 0));
    let curvature = Matrix3::new(xx, xy, xs, xy, yy, ys, xs, ys, ss);
    let fits = at(1, 1, 2) != 0.0 && at(1, 1, 0) != 0.0;
    curvature.lu().solve(&-slope).filter(|offset| fits && offset.iter().all(|v| v.abs() <= MAX_OFFSET))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::test_pictures::rendered;
    use image::{GrayImage, Luma};

    fn detect(picture: &GrayImage) -> Vec<Keypoint> {
        SurfDetector::default().detect(&PictureForms::new(picture))
    }

    fn blob(middle: Vector2<f64>, sigma: f64, height: f64) -> GrayImage {
        GrayImage::from_fn(160, 140, |x, y| {
            let d = Vector2::new(f64::from(x), f64::from(y)) - middle;
            Luma([(128.0 + height * (-0.5 * d.norm_squared() / (sigma * sigma)).exp()).round() as u8])
        })
    }

    #[test]
    fn blobs_are_found_at_their_place_and_scale() {
        for (sigma, height) in [(2.5, 100.0), (4.0, -100.0), (7.0, 110.0), (12.0, -120.0)] {
            let middle = Vector2::new(79.3, 68.6);
            let found = detect(&blob(middle, sigma, height));
            let first = found.first().expect("a blob is found");
            assert!((first.position - middle).norm() < 0.1 * sigma + 0.2, "{sigma}: {}", first.position);
            // Lobes of a third of the side have a sigma of half that, 1.5 at side 9, which the
            // paper calls 1.2.
            assert!((first.scale() / (0.8 * sigma)).log2().abs() < 0.3, "{sigma}: {}", first.scale());
        }
    }

    #[test]
    fn blobs_of_every_scale_are_found_at_any_subsample_offset() {
        let mut ratios = Vec::new();
        for sigma in [2.2, 2.6, 3.5, 4.5, 6.279, 9.0, 12.64] {
            for k in 0..8 {
                let middle = Vector2::new(75.0 + 0.37 * f64::from(k), 70.0 - 0.71 * f64::from(k));
                let found = detect(&rendered(160, 140, |p| 128.0 + 100.0 * (-0.5 * (p - middle).norm_squared() / (sigma * sigma)).exp()));
                assert!(!found.is_empty(), "{sigma}, {k}");
                assert!((found[0].position - middle).norm() < 0.05 + 0.06 * sigma, "{sigma}, {k}: {}", found[0].position - middle);
                ratios.push(found[0].scale() / sigma);
            }
        }
        // The same at all scales, within the resolution of the coarse layers.
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        assert!(ratios.iter().all(|r| (r / mean - 1.0).abs() < 0.1), "{mean}: {ratios:?}");
    }

    #[test]
    fn filter_sizes_match_the_paper() {
        assert_eq!(sides(0), [9, 15, 21, 27]);
        assert_eq!(sides(1), [15, 27, 39, 51]);
        assert_eq!(sides(2), [27, 51, 75, 99]);
        assert_eq!(sides(3), [51, 99, 147, 195]);
    }

    #[test]
    fn hessian_filters_respond_to_curvature_only() {
        let ramp = GrayImage::from_fn(60, 60, |x, y| Luma([(2 * x + y) as u8]));
        let bowl = GrayImage::from_fn(60, 60, |x, y| Luma([((x as i32 - 30) * (y as i32 - 30) + 128).clamp(0, 255) as u8]));
        assert!(hessian(&IntegralImage::of(&ramp), 30, 30, 15).iter().all(|v| v.abs() < 1e-4));
        let [xx, yy, xy] = hessian(&IntegralImage::of(&bowl), 30, 30, 15);
        // Four lobes of 25 pixels whose products of coordinates are 9 on average, divided by 15
        // squared.
        assert_eq!([xx, yy, xy], [0.0, 0.0, 4.0]);
    }

    #[test]
    fn no_blobs_are_found_in_blank_pictures() {
        for (w, h) in [(0, 0), (1, 1), (200, 1), (5000, 3), (12, 300), (28, 29)] {
            assert_eq!(detect(&GrayImage::from_pixel(w, h, Luma([90]))), []);
        }
        assert_eq!(detect(&GrayImage::from_pixel(300, 240, Luma([255]))), []);
        let wild = SurfDetector { least_determinant: f64::NAN, octaves: usize::MAX, count: 3 };
        assert!(wild.detect(&PictureForms::new(&blob(Vector2::new(80.0, 70.0), 5.0, 90.0))).len() <= 3);
    }
}
