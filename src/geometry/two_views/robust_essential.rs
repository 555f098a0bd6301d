//! Robust estimation of the motion between two calibrated views: five-point samples scored by
//! truncated squared (MSAC) Sampson distances in pixels, refined on the inliers whenever a better
//! one is found.

use nalgebra::{Matrix3, Vector3};

use super::judged_motion::{JudgedMotion, judged_motion};
use super::line_noise::from_line;
use super::motion_in_pixels::refine_motion_in_pixels;
use crate::geometry::distances::squared_sampson;
use crate::geometry::five_point::five_point;
use crate::geometry::homography::PointPair;
use crate::geometry::ransac::{self, Estimator};
use crate::geometry::relative_pose::RayPair;
use crate::geometry::robust::{self, RobustModel, RobustOptions};
use crate::geometry::scoring::Scorer;

/// Minimum score of a motion: its own five pairs always score 5, so this demands support beyond the
/// sample. Raised, more support is required.
const MIN_SCORE: f64 = 5.5;
/// Refinement iterations during the search and at its end, as for the fundamental matrix.
const STEPS_IN_SEARCH: usize = 4;
const LAST_STEPS: usize = 20;

/// Finds the motion with the most support; `None` if no more pairs than a sample agree.
///
/// `focals` are the focal lengths of the first and the second picture in pixels. They scale the
/// rays' distances to pixels, so the options' threshold is in pixels as everywhere. The motion's
/// [`essential`](crate::geometry::relative_pose::TwoViewMotion::essential) is the matrix. A flat
/// scene allows a second motion with equal distances; `decompose_homography` returns both.
pub fn robust_essential(pairs: &[RayPair], focals: [f64; 2], options: &RobustOptions) -> Option<RobustModel<JudgedMotion>> {
    let RobustOptions { threshold, max_samples, confidence, order, seed, .. } = *options;
    if !robust::is_sound(options) || !focals.iter().all(|f| f.is_finite() && *f > 0.0) {
        return None;
    }
    let indices = robust::usable(pairs);
    let rays: Vec<RayPair> = indices.iter().map(|&k| pairs[k]).collect();
    let pixels: Vec<PointPair> = rays.iter().map(|r| PointPair { from: r.first * focals[0], to: r.second * focals[1] }).collect();
    let views = Views { scorer: Scorer::new(&pixels, threshold), rays: &rays, pixels: &pixels, focals, threshold };
    let search = ransac::Options { samples: max_samples, confidence: Some(confidence), order, least_score: MIN_SCORE, keep: 1, seed };
    let (score, e) = ransac::search(&views, &search).pop()?;
    let (e, _) = views.refined(e, score, LAST_STEPS);
    let f = views.in_pixels(&e);
    let found = RobustModel::judged((), pixels.iter().map(|p| squared_sampson(&f, p)), threshold, from_line);
    let inliers: Vec<RayPair> = found.inliers.iter().map(|&k| rays[k]).collect();
    let motion = judged_motion(&e, &inliers, views.ray_noise())?;
    (found.inliers.len() > 5).then(|| found.map(|()| motion).among(&indices))
}

/// Rays seen in two views, five of which give up to ten essential matrices, and the same in pixels
/// relative to the principal points.
struct Views<'a> {
    rays: &'a [RayPair],
    pixels: &'a [PointPair],
    scorer: Scorer,
    focals: [f64; 2],
    threshold: f64,
}

impl Estimator<5> for Views<'_> {
    type Model = Matrix3<f64>;

    fn count(&self) -> usize {
        self.rays.len()
    }

    fn models(&self, sample: [usize; 5]) -> impl Iterator<Item = Matrix3<f64>> {
        five_point(&sample.map(|k| self.rays[k])).into_iter()
    }

    fn score(&self, e: &Matrix3<f64>, bar: f64) -> Option<f64> {
        self.scorer.epipolar(&self.in_pixels(e), bar)
    }

    fn improved(&self, e: Matrix3<f64>, score: f64) -> (Matrix3<f64>, f64) {
        self.refined(e, score, STEPS_IN_SEARCH)
    }

    fn agrees(&self, e: &Matrix3<f64>, datum: usize) -> bool {
        squared_sampson(&self.in_pixels(e), &self.pixels[datum]) < self.threshold.powi(2)
    }
}

impl Views<'_> {
    /// Converts the relation to pixels.
    fn in_pixels(&self, e: &Matrix3<f64>) -> Matrix3<f64> {
        let [first, second] = self.focals.map(|focal| Matrix3::from_diagonal(&Vector3::new(1.0 / focal, 1.0 / focal, 1.0)));
        second * e * first
    }

    /// Noise of a ray, radians: a third of the threshold, over the shorter focal length.
    fn ray_noise(&self) -> f64 {
        self.threshold / 3.0 / self.focals[0].min(self.focals[1])
    }

    /// Returns pairs within this multiple of the threshold.
    fn near(&self, e: &Matrix3<f64>, thresholds: f64) -> Vec<RayPair> {
        let (f, within) = (self.in_pixels(e), (thresholds * self.threshold).powi(2));
        self.rays.iter().zip(self.pixels).filter(|(_, p)| squared_sampson(&f, *p) < within).map(|(r, _)| *r).collect()
    }

    /// Refines on nearby pairs, first within twice the threshold; keeps the best model.
    fn refined(&self, mut e: Matrix3<f64>, mut score: f64, steps: usize) -> (Matrix3<f64>, f64) {
        for thresholds in [2.0, 1.0] {
            let near = self.near(&e, thresholds);
            let Some(start) = judged_motion(&e, &near, self.ray_noise()) else { continue };
            let next = refine_motion_in_pixels(&start.motion, &near, self.focals, self.threshold / 3.0, steps).essential();
            if let Some(next_score) = self.scorer.epipolar(&self.in_pixels(&next), score) {
                (e, score) = (next, next_score);
            }
        }
        (e, score)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::test_views::{FOCALS, errors_deg, scene};

    /// True pairs with half a pixel of noise, then wrong ones.
    fn mixture(good: usize, wrong: usize, seed: u64) -> Vec<RayPair> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut pairs = scene(good, 0.001, false, seed);
        pairs.extend((0..wrong).map(|_| {
            let mut at = || Vector2::new(random.random_range(-0.6..0.6), random.random_range(-0.5..0.5));
            RayPair { first: at(), second: at() }
        }));
        pairs
    }

    /// Thesis error E9: the calibration never reached the pose. Here the calibrated rays determine
    /// it.
    #[test]
    fn e9_calibrated_rays_recover_the_motion_despite_outliers() {
        for (good, wrong, seed) in [(200, 60, 1), (150, 150, 2), (100, 150, 3)] {
            let pairs = mixture(good, wrong, seed);
            let found = robust_essential(&pairs, FOCALS, &RobustOptions { threshold: 2.0, seed, ..RobustOptions::default() });
            let found = found.expect("a motion");
            let (r, t) = errors_deg(&found.model.motion);
            assert!(r < 0.4 && t < 1.0, "{good} {wrong}: {r} {t}");
            let right = found.inliers.iter().filter(|&&k| k < good).count();
            assert!(right as f64 > 0.95 * good as f64 && found.model.is_clear() && found.model.in_front >= right * 9 / 10);
        }
    }

    /// Thesis error E22, for cameras of any focal length: pixels are pixels.
    #[test]
    fn e22_thresholds_are_in_pixels_of_each_camera() {
        let pairs = mixture(120, 60, 4);
        let options = RobustOptions { threshold: 2.0, ..RobustOptions::default() };
        let plain = robust_essential(&pairs, FOCALS, &options).expect("a motion");
        for unit in [1e-3, 1e3] {
            let other = RobustOptions { threshold: 2.0 * unit, ..options };
            let found = robust_essential(&pairs, FOCALS.map(|f| f * unit), &other).expect("a motion");
            assert_eq!(found.inliers, plain.inliers);
            assert!((found.sigma / unit - plain.sigma).abs() < 1e-6);
        }
    }

    #[test]
    fn degenerate_rays_yield_no_motion() {
        let (pairs, options) = (mixture(60, 0, 5), RobustOptions { max_samples: 50, ..RobustOptions::default() });
        assert_eq!(robust_essential(&pairs[..5], FOCALS, &options), None);
        assert_eq!(robust_essential(&pairs, [0.0, 800.0], &options), None);
        assert_eq!(robust_essential(&pairs, [800.0, f64::NAN], &options), None);
        let broken = RayPair { first: Vector2::new(f64::NAN, 0.0), second: Vector2::zeros() };
        assert_eq!(robust_essential(&[broken; 30], FOCALS, &options), None);
        // Thirty copies of one pair: no panic, whatever the result.
        let _ = robust_essential(&[pairs[0]; 30], FOCALS, &options);
        assert_eq!(robust_essential(&pairs, FOCALS, &options), robust_essential(&pairs, FOCALS, &options));
    }
}
