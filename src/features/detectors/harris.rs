//! Corners: places whose second-moment matrix has two large eigenvalues. Three measures of that: Harris & Stephens, A Combined Corner and Edge
//! Detector, 1988 (section 4); Noble, Finding Corners, 1988; Shi & Tomasi, Good Features to Track, 1994 (section 4).
//!
//! A place is found as a local maximum of the measure, which lies inside of the corner by an amount that grows with the smoothing. It is then
//! moved to the point that the lines along the window's edges meet in (Förstner & Gülch 1987), which does not.

use nalgebra::{Matrix2, Vector2};

use super::{Detector, strongest_first};
use crate::features::float_image::FloatImage;
use crate::features::keypoint::{Keypoint, PictureForms};
use crate::features::second_moments::{SecondMoments, gradients, within};
use crate::simd::multiversion;

/// How distinctive a second-moment matrix is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CornerMeasure {
    /// Determinant less `k` times the squared trace.
    #[default]
    Harris,
    /// Determinant by trace.
    Noble,
    /// Smaller eigenvalue.
    ShiTomasi,
}

/// Finds corners of one size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HarrisDetector {
    /// Default Harris.
    pub measure: CornerMeasure,
    /// Weight of the squared trace in the Harris measure. Default 0.04 (Harris & Stephens leave it open; this is what is in use). Raised, corners
    /// must be nearer to a right angle.
    pub k: f64,
    /// Sigma of the window that gradients are gathered in, pixels. Default 2. Raised, corners are fewer, steadier, and found less exactly.
    pub sigma: f64,
    /// Sigma that the picture is smoothed by before its gradients are taken, pixels. Default 2. Raised, noise counts less and detail too.
    pub derivative_sigma: f64,
    /// Corners at most, strongest first. Default: no limit.
    pub count: usize,
    /// Least strength, in the measure's own unit. Default 0.
    pub least_strength: f64,
    /// Least strength as a share of the strongest. Default 0.
    pub least_share: f64,
    /// Pixels at the border where no corner is looked for. Default 2.
    pub edge_gap: usize,
    /// Pixels around a corner where no weaker one is kept. Default 0: all are kept.
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

/// The measure's rounding errors, as a share of the strongest corner: what is below is an even surface or a straight edge. Raised, faint corners
/// beside a very strong one are lost.
const ROUNDING: f64 = 1e-6;
/// Sigma at most that the picture is smoothed by for the point that edges meet in, pixels. Smoothing rounds a corner off, and the edges of a round
/// one meet inside of it: at 2 pixels by 0.6 pixels, at 0.7 by 0.16 to 0.29 (the corners of the test below). Lowered, noise counts more.
const EDGE_SIGMA: f64 = 0.7;
/// Steps of the window after the point that its edges meet in. It seldom moves after the third.
const STEPS: usize = 5;
/// Sigmas at most from the maximum to the point. What is farther is another corner or none; the maximum itself is taken then.
const MOST_SIGMAS: f64 = 2.0;
/// Least ratio of the eigenvalues for a point: below, the window shows one line, along which the point could be anywhere.
const LEAST_RATIO: f64 = 0.02;

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
    /// The measure of each pixel.
    fn strength(&self, moments: &SecondMoments) -> FloatImage {
        let mut out = FloatImage::new(moments.xx.width, moments.xx.height);
        measure_all(self.measure, self.k as f32, moments, &mut out.values);
        out
    }

    /// Where the edges within the window about `start` meet: the point with the least sum of squared distances from the lines through the
    /// window's pixels across their gradients, each weighted by the squared gradient and the window.
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
            if eigen.min() <= LEAST_RATIO * eigen.max() {
                return None;
            }
            let step = normal.try_inverse()? * right;
            place += step;
            if (place - start).norm().is_nan() || (place - start).norm() > MOST_SIGMAS * sigma {
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
                // The smallest positive number takes the place of a trace of 0, of which the determinant is 0 too.
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

/// Pixels above `least` that none of their eight neighbours exceeds, and none of those before them in the order of rows equals.
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

/// The peak of the parabolas through a maximum and its neighbours across and down.
pub(super) fn parabola_peak(image: &FloatImage, x: usize, y: usize) -> Vector2<f64> {
    let at = |dx: isize, dy: isize| f64::from(image.at(x as isize + dx, y as isize + dy));
    let peak = |before: f64, here: f64, after: f64| {
        let bend = before - 2.0 * here + after;
        if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
    };
    Vector2::new(x as f64 + peak(at(-1, 0), at(0, 0), at(1, 0)), y as f64 + peak(at(0, -1), at(0, 0), at(0, 1)))
}

/// At most `count` keypoints, each at least `radius` pixels from all before it. Cells of that size are sorted in, so that only neighbouring ones
/// are compared.
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

    /// A bright square with its middle at `middle`, half a side of `half` pixels, turned; each pixel the mean of 8 x 8 samples.
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
    fn the_four_corners_of_a_square_are_found_between_the_pixels() {
        for (measure, (dx, angle)) in MEASURES.iter().flat_map(|m| [(0.0, 0.0), (0.3, 0.0), (0.5, 0.4), (0.8, 1.1)].map(|p| (*m, p))) {
            let middle = Vector2::new(50.0 + dx, 44.0 - 0.7 * dx);
            let found = detect(HarrisDetector { measure, count: 4, ..Default::default() }, &square(middle, 20.0, angle));
            assert_eq!(found.len(), 4);
            for k in 0..4 {
                let turn = angle + std::f64::consts::FRAC_PI_4 * f64::from(2 * k + 1);
                let corner = middle + 20.0 * 2f64.sqrt() * Vector2::new(turn.cos(), turn.sin());
                let nearest = found.iter().map(|f| (f.position - corner).norm()).fold(f64::MAX, f64::min);
                assert!(nearest < 0.35, "{measure:?} {dx} {angle}: {nearest}");
            }
        }
    }

    #[test]
    fn the_measures_are_those_of_their_formulas() {
        let one = |v: f32| FloatImage { width: 1, height: 1, values: vec![v] };
        let moments = SecondMoments { xx: one(5.0), yy: one(2.0), xy: one(2.0) };
        // Eigenvalues 6 and 1.
        for (measure, expected) in MEASURES.iter().zip([6.0 - 0.04 * 49.0, 6.0 / 7.0, 1.0]) {
            let detector = HarrisDetector { measure: *measure, ..Default::default() };
            assert!((detector.strength(&moments).values[0] - expected).abs() < 1e-5, "{measure:?}");
        }
    }

    #[test]
    fn suppression_ends_and_keeps_the_strongest_of_each_neighbourhood() {
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
    fn limits_on_count_strength_share_and_border_hold() {
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
    fn pictures_without_corners_have_none_and_none_is_too_small() {
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
