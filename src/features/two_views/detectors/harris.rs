//! Corners: places whose second-moment matrix has two large eigenvalues. Three measures: Harris &
//! Stephens, A Combined Corner and Edge Detector, 1988 (section 4); Noble, Finding Corners, 1988;
//! Shi & Tomasi, Good Features to Track, 1994 (section 4).
//!
//! A corner is found as a local maximum of the measure, which is inside the true corner by an
//! amount that grows with the smoothing. It is then moved to the intersection of the edges in the
//! window (Förstner & Gülch 1987), which has no such bias.

use nalgebra::{Matrix2, Vector2};

use super::{Detector, strongest_first};
use crate::features::float_image::FloatImage;
use crate::features::two_views::keypoint::{Keypoint, PictureForms};
use crate::features::two_views::second_moments::{SecondMoments, gradients, within};
use crate::simd::multiversion;

/// Measure of a second-moment matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CornerMeasure {
    /// Determinant minus `k` times the squared trace.
    #[default]
    Harris,
    /// Determinant divided by trace.
    Noble,
    /// Smaller eigenvalue.
    ShiTomasi,
}

/// Finds corners of one size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HarrisDetector {
    /// The corner measure. Default Harris.
    pub measure: CornerMeasure,
    /// Weight of the squared trace in the Harris measure. Default 0.04 (Harris & Stephens leave it
    /// open; this is commonly used). Raised, corners must be closer to a right angle.
    pub k: f64,
    /// Sigma of the window in which gradients are averaged, pixels. Default 2. Raised, corners are
    /// fewer, more stable, and less precise.
    pub sigma: f64,
    /// Sigma of the smoothing before taking gradients, pixels. Default 2. Raised, noise counts
    /// less, and so does detail.
    pub derivative_sigma: f64,
    /// Maximum number of corners, strongest first. Default: no limit.
    pub count: usize,
    /// Minimum strength, in the measure's own unit. Default 0.
    pub least_strength: f64,
    /// Minimum strength as a fraction of the strongest. Default 0.
    pub least_share: f64,
    /// Width of the border without corners, pixels. Default 2.
    pub edge_gap: usize,
    /// Radius around a corner in which weaker ones are dropped, pixels. Default 0: all are kept.
    pub suppress: f64,
}

impl Default for HarrisDetector {
    fn default() -> Self {
        Self {
            measure: CornerMeasure::Harris,
            k: 0.04,
            sigma: 2.0,
            derivative_sigma: 2.0,
            count: usize::MAX,
            least_strength: 0.0,
            least_share: 0.0,
            edge_gap: 2,
            suppress: 0.0,
        }
    }
}

/// Rounding error of the measure, relative to the strongest corner; anything below is a uniform
/// surface or a straight edge. Raised, faint corners beside a very strong one are lost.
const ROUNDING: f64 = 1e-6;
/// Maximum smoothing sigma for locating the intersection of edges, pixels. Smoothing rounds a
/// corner off, and the edges of a round one meet inside it: by 0.6 pixels at 2 pixels, by 0.16 to
/// 0.29 at 0.7 (the corners of the test below). Lowered, noise counts more.
const EDGE_SIGMA: f64 = 0.7;
/// Maximum number of iterations for the intersection; it seldom moves after the third.
const STEPS: usize = 5;
/// Maximum distance from the maximum to the intersection, sigmas. If it is farther, it is another
/// corner or none, and the maximum itself is used. Raised, wrong intersections are accepted.
const MAX_SIGMAS: f64 = 2.0;
/// Minimum ratio of the eigenvalues for an intersection: below, the window shows a single line,
/// along which the point is undetermined. Raised, more corners stay at their maximum.
const MIN_RATIO: f64 = 0.02;

impl Detector for HarrisDetector {
    fn detect(&self, picture: &PictureForms) -> Vec<Keypoint> {
        let float = picture.float();
        let moments = SecondMoments::of(float, self.derivative_sigma, self.sigma);
        let strength = self.strength(&moments);
        let strongest = f64::from(strength.values.iter().fold(0.0f32, |most, v| most.max(*v)));
        let least = self.least_strength.max(strongest * self.least_share.max(ROUNDING));
        let (across, down) = gradients(&float.blurred(within(self.derivative_sigma.min(EDGE_SIGMA))));
        let mut found = Vec::new();
        for (x, y) in picture.watch.over(local_maxima(&strength, self.edge_gap, least as f32)) {
            let peak = parabola_peak(&strength, x, y);
            let place = self.meeting_point(&across, &down, peak).unwrap_or(peak);
            found.push(Keypoint::round(place, within(self.sigma), strength.at(x as isize, y as isize)));
        }
        strongest_first(&mut found);
        if self.suppress > 0.0 {
            found = apart(&found, self.suppress, self.count);
        }
        found.truncate(self.count);
        found
    }
}

impl HarrisDetector {
    /// Returns the measure of each pixel.
    fn strength(&self, moments: &SecondMoments) -> FloatImage {
        let mut out = FloatImage::new(moments.xx.width, moments.xx.height);
        measure_all(self.measure, self.k as f32, moments, &mut out.values);
        out
    }

    /// Returns the intersection of the edges in the window around `start`: the point with the
    /// minimum sum of squared distances from the lines through the window's pixels perpendicular to
    /// their gradients, weighted by squared gradient and window.
    fn meeting_point(&self, across: &FloatImage, down: &FloatImage, start: Vector2<f64>) -> Option<Vector2<f64>> {
        let sigma = within(self.sigma);
        let reach = (2.5 * sigma).ceil() as isize;
        let mut place = start;
        for _ in 0..STEPS {
            let (cx, cy) = (place.x.round() as isize, place.y.round() as isize);
            let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
            for y in (cy - reach).max(0)..=(cy + reach).min(across.height as isize - 1) {
                for x in (cx - reach).max(0)..=(cx + reach).min(across.width as isize - 1) {
                    let offset = Vector2::new(x as f64, y as f64) - place;
                    let weight = (-0.5 * offset.norm_squared() / (sigma * sigma)).exp();
                    let gradient = Vector2::new(f64::from(across.at(x, y)), f64::from(down.at(x, y)));
                    let product = gradient * gradient.transpose() * weight;
                    normal += product;
                    right += product * offset;
                }
            }
            let eigen = normal.symmetric_eigenvalues();
            if eigen.min() <= MIN_RATIO * eigen.max() {
                return None;
            }
            let step = normal.try_inverse()? * right;
            place += step;
            if (place - start).norm().is_nan() || (place - start).norm() > MAX_SIGMAS * sigma {
                return None;
            }
            if step.norm() < 1e-3 {
                break;
            }
        }
        let inside = |v: f64, side: usize| (0.0..=side as f64 - 1.0).contains(&v);
        (inside(place.x, across.width) && inside(place.y, across.height)).then_some(place)
    }
}

multiversion! {
    fn measure_all(measure: CornerMeasure, k: f32, moments: &SecondMoments, out: &mut [f32]);
    ["avx2"] => measure_all_plain, else measure_all_plain
}

#[inline(always)]
fn measure_all_plain(measure: CornerMeasure, k: f32, moments: &SecondMoments, out: &mut [f32]) {
    let elements = moments.xx.values.iter().zip(&moments.yy.values).zip(&moments.xy.values);
    match measure {
        CornerMeasure::Harris => {
            for (o, ((xx, yy), xy)) in out.iter_mut().zip(elements) {
                *o = xx * yy - xy * xy - k * (xx + yy) * (xx + yy);
            }
        }
        CornerMeasure::Noble => {
            for (o, ((xx, yy), xy)) in out.iter_mut().zip(elements) {
                // The smallest positive number replaces a trace of 0, where the determinant is 0
                // too.
                *o = (xx * yy - xy * xy) / (xx + yy).max(f32::MIN_POSITIVE);
            }
        }
        CornerMeasure::ShiTomasi => {
            for (o, ((xx, yy), xy)) in out.iter_mut().zip(elements) {
                let (half, cross) = (0.5 * (xx - yy), xy);
                *o = 0.5 * (xx + yy) - (half * half + cross * cross).sqrt();
            }
        }
    }
}

/// Returns pixels above `least` that no neighbour exceeds and no earlier neighbour in reading order
/// equals.
pub(super) fn local_maxima(image: &FloatImage, gap: usize, least: f32) -> Vec<(usize, usize)> {
    let gap = gap.max(1);
    let mut found = Vec::new();
    for y in gap..image.height.saturating_sub(gap) {
        let (above, row, below) = (image.row(y - 1), image.row(y), image.row(y + 1));
        for x in gap..image.width.saturating_sub(gap) {
            let value = row[x];
            if value <= least || value <= row[x - 1] || value < row[x + 1] {
                continue;
            }
            if above[x - 1..x + 2].iter().all(|v| value > *v) && below[x - 1..x + 2].iter().all(|v| value >= *v) {
                found.push((x, y));
            }
        }
    }
    found
}

/// Returns the peak of the parabolas through a maximum and its horizontal and vertical neighbours.
pub(super) fn parabola_peak(image: &FloatImage, x: usize, y: usize) -> Vector2<f64> {
    let at = |dx: isize, dy: isize| f64::from(image.at(x as isize + dx, y as isize + dy));
    let peak = |before: f64, here: f64, after: f64| {
        let bend = before - 2.0 * here + after;
        if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
    };
    Vector2::new(x as f64 + peak(at(-1, 0), at(0, 0), at(1, 0)), y as f64 + peak(at(0, -1), at(0, 0), at(0, 1)))
}

/// Returns at most `count` keypoints, each at least `radius` pixels from all before it. Uses a grid
/// of cells of that size, so that only neighbouring cells are compared.
fn apart(sorted: &[Keypoint], radius: f64, count: usize) -> Vec<Keypoint> {
    let mut kept: Vec<Keypoint> = Vec::new();
    let mut cells: std::collections::BTreeMap<(i64, i64), Vec<usize>> = std::collections::BTreeMap::new();
    let cell = |v: f64| (v / radius.max(1.0)).floor() as i64;
    for keypoint in sorted {
        if kept.len() >= count {
            break;
        }
        let (cx, cy) = (cell(keypoint.position.x), cell(keypoint.position.y));
        let near = (cy - 1..=cy + 1).flat_map(|y| (cx - 1..=cx + 1).map(move |x| (x, y)));
        let mut others = near.filter_map(|at| cells.get(&at)).flatten();
        if others.all(|k| (kept[*k].position - keypoint.position).norm() >= radius) {
            cells.entry((cx, cy)).or_default().push(kept.len());
            kept.push(*keypoint);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, Luma};

    const MEASURES: [CornerMeasure; 3] = [CornerMeasure::Harris, CornerMeasure::Noble, CornerMeasure::ShiTomasi];

    /// A bright square centred at `middle`, with half side `half` pixels, rotated; each pixel is
    /// the mean of 8 x 8 samples.
    fn square(middle: Vector2<f64>, half: f64, angle: f64) -> GrayImage {
        let (sin, cos) = angle.sin_cos();
        GrayImage::from_fn(100, 90, |x, y| {
            let inside = (0..64).filter(|k| {
                let sample = Vector2::new(f64::from(x) + f64::from(k % 8) / 8.0 - 0.4375, f64::from(y) + f64::from(k / 8) / 8.0 - 0.4375);
                let d = sample - middle;
                (cos * d.x + sin * d.y).abs() < half && (cos * d.y - sin * d.x).abs() < half
            });
            Luma([(40 + inside.count() * 160 / 64) as u8])
        })
    }

    fn detect(detector: HarrisDetector, picture: &GrayImage) -> Vec<Keypoint> {
        detector.detect(&PictureForms::new(picture))
    }

    fn noise(width: u32, height: u32) -> GrayImage {
        let mut state = 1u32;
        GrayImage::from_fn(width, height, |_, _| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            Luma([(state >> 24) as u8])
        })
    }

    #[test]
    fn square_corners_are_located_to_subpixels() {
        for (measure, (dx, angle)) in MEASURES.iter().flat_map(|m| [(0.0, 0.0), (0.3, 0.0), (0.5, 0.4), (0.8, 1.1)].map(|p| (*m, p))) {
            let middle = Vector2::new(50.0 + dx, 44.0 - 0.7 * dx);
            let found = detect(HarrisDetector { measure, count: 4, ..Default::default() }, &square(middle, 20.0, angle));
            assert_eq!(found.len(), 4);
            for k in 0..4 {
                let rotation = angle + std::f64::consts::FRAC_PI_4 * f64::from(2 * k + 1);
                let corner = middle + 20.0 * 2f64.sqrt() * Vector2::new(rotation.cos(), rotation.sin());
                let nearest = found.iter().map(|f| (f.position - corner).norm()).fold(f64::MAX, f64::min);
                assert!(nearest < 0.35, "{measure:?} {dx} {angle}: {nearest}");
            }
        }
    }

    #[test]
    fn corner_measures_match_their_formulas() {
        let one = |v: f32| FloatImage { width: 1, height: 1, values: vec![v] };
        let moments = SecondMoments { xx: one(5.0), yy: one(2.0), xy: one(2.0) };
        // Eigenvalues 6 and 1.
        for (measure, expected) in MEASURES.iter().zip([6.0 - 0.04 * 49.0, 6.0 / 7.0, 1.0]) {
            let detector = HarrisDetector { measure: *measure, ..Default::default() };
            assert!((detector.strength(&moments).values[0] - expected).abs() < 1e-5, "{measure:?}");
        }
    }

    #[test]
    fn suppression_keeps_the_strongest_of_each_neighbourhood() {
        let picture = noise(160, 120);
        let all = detect(HarrisDetector::default(), &picture);
        let kept = detect(HarrisDetector { suppress: 12.0, ..Default::default() }, &picture);
        assert!(kept.len() > 20 && kept.len() < all.len(), "{} of {}", kept.len(), all.len());
        for (k, a) in kept.iter().enumerate() {
            assert!(kept[..k].iter().all(|b| (a.position - b.position).norm() >= 12.0));
        }
        for lost in all.iter().filter(|a| !kept.contains(a)) {
            assert!(kept.iter().any(|k| k.response >= lost.response && (k.position - lost.position).norm() < 12.0));
        }
    }

    #[test]
    fn limits_on_count_strength_and_border_hold() {
        let picture = noise(160, 120);
        let all = detect(HarrisDetector::default(), &picture);
        let middle = f64::from(all[all.len() / 2].response);
        let few = detect(HarrisDetector { count: 7, ..Default::default() }, &picture);
        assert_eq!(few, all[..7]);
        let strong = detect(HarrisDetector { least_strength: middle, ..Default::default() }, &picture);
        assert_eq!(strong, all[..all.len() / 2]);
        let share = detect(HarrisDetector { least_share: 0.5, ..Default::default() }, &picture);
        assert!(share.len() < all.len() && share.iter().all(|k| k.response >= 0.5 * all[0].response));
        let inner = detect(HarrisDetector { edge_gap: 30, ..Default::default() }, &picture);
        assert!(!inner.is_empty() && inner.iter().all(|k| k.position.x > 25.0 && k.position.y > 25.0 && k.position.x < 134.0));
    }

    #[test]
    fn cornerless_and_tiny_pictures_have_no_corners() {
        let ramp = GrayImage::from_fn(60, 50, |x, _| Luma([(3 * x) as u8]));
        let edge = GrayImage::from_fn(60, 50, |x, _| Luma([if x < 30 { 20 } else { 220 }]));
        let sizes = [(0, 0), (1, 1), (40, 1), (1, 40), (3, 3)].map(|(w, h)| noise(w, h));
        for measure in MEASURES {
            let detector = HarrisDetector { measure, ..Default::default() };
            for even in [&GrayImage::from_pixel(50, 40, Luma([77])), &ramp, &edge] {
                assert_eq!(detect(detector, even), [], "{measure:?}");
            }
            for small in &sizes {
                assert!(detect(detector, small).len() < 5);
            }
            assert_eq!(detect(detector, &noise(80, 60)), detect(detector, &noise(80, 60)));
            let wild = HarrisDetector { sigma: f64::NAN, derivative_sigma: -3.0, suppress: 1e-9, edge_gap: usize::MAX, ..detector };
            assert_eq!(detect(wild, &noise(40, 30)), []);
        }
    }
}
