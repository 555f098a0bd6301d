//! Robust homography estimation: samples drawn in order of match quality, scored by truncated
//! squares (MSAC), and locally optimised whenever a better one is found.
//!
//! The generator is seeded, so the same matches give the same result.

use super::homography::{Homography, PointPair};
use super::noise::between_points;
use super::ransac::{self, Estimator};
use super::robust::{self, RobustModel, RobustOptions};
use super::scoring::Scorer;

/// Minimum score of a homography. A sample's own four pairs score 4, so this rejects only
/// numerically bad samples; raised above 4, it demands support beyond the sample.
const MIN_SCORE: f64 = 3.5;

/// Noise, in thresholds, at which the robust kernel weights all inliers equally, to a millionth.
/// Lowered, far inliers lose weight.
const ALL_ALIKE: f64 = 1e3;

/// Finds the homography with the most support, or `None` if fewer than four pairs agree. Distances
/// are transfer errors in the second picture.
pub fn robust_homography(pairs: &[PointPair], options: &RobustOptions) -> Option<RobustModel<Homography>> {
    let RobustOptions { threshold, max_samples, confidence, order, seed, .. } = *options;
    if !robust::is_sound(options) {
        return None;
    }
    let indices = robust::usable(pairs);
    let pairs: Vec<PointPair> = indices.iter().map(|&k| pairs[k]).collect();
    let t2 = threshold * threshold;
    let search = ransac::Options { samples: max_samples, confidence: Some(confidence), order, least_score: MIN_SCORE, keep: 1, seed };
    let plane = Plane { pairs: &pairs, scorer: Scorer::new(&pairs, threshold), threshold };
    let (_, homography) = ransac::search(&plane, &search).pop()?;
    let homography = homography.refined(&inliers_of(&homography, &pairs, t2), threshold / 3.0, 15).unwrap_or(homography);
    let alike = options.weighs_alike.then(|| homography.refined(&inliers_of(&homography, &pairs, t2), ALL_ALIKE * threshold, 10));
    let homography = alike.flatten().unwrap_or(homography);
    let found = RobustModel::judged(homography, pairs.iter().map(|p| homography.squared_error(p)), threshold, between_points);
    (found.inliers.len() >= 4).then(|| found.among(&indices))
}

/// Pairs of points on two planes; four of them define a homography.
struct Plane<'a> {
    pairs: &'a [PointPair],
    scorer: Scorer,
    threshold: f64,
}

impl Estimator<4> for Plane<'_> {
    type Model = Homography;

    fn count(&self) -> usize {
        self.pairs.len()
    }

    fn models(&self, sample: [usize; 4]) -> impl Iterator<Item = Homography> {
        Homography::from_four(&sample.map(|k| self.pairs[k])).into_iter()
    }

    fn score(&self, h: &Homography, bar: f64) -> Option<f64> {
        self.scorer.homography(h, bar)
    }

    fn improved(&self, h: Homography, score: f64) -> (Homography, f64) {
        self.locally_optimised(h, score)
    }

    fn agrees(&self, h: &Homography, datum: usize) -> bool {
        h.squared_error(&self.pairs[datum]) < self.threshold.powi(2)
    }
}

fn inliers_of(h: &Homography, pairs: &[PointPair], t2: f64) -> Vec<PointPair> {
    pairs.iter().filter(|p| h.squared_error(p) < t2).copied().collect()
}

impl Plane<'_> {
    /// Refits to the inliers, first with wider thresholds so that a rough model can grow.
    fn locally_optimised(&self, mut h: Homography, mut s: f64) -> (Homography, f64) {
        let t2 = self.threshold * self.threshold;
        for widen in [3.0, 2.0, 1.0] {
            let near = inliers_of(&h, self.pairs, t2 * widen * widen);
            let Some(next) = Homography::from_pairs(&near, None) else { continue };
            if let Some(next_score) = self.scorer.homography(&next, s).filter(|_| near.len() >= 5) {
                (h, s) = (next, next_score);
            }
        }
        (h, s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector2};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use crate::geometry::ransac::Order;

    /// `good` true pairs mixed with random ones; true ones tend to come first, as a ratio test
    /// sorts them.
    fn mixture(n: usize, good: usize, seed: u64) -> (Homography, Vec<PointPair>, Vec<bool>) {
        let truth = Homography(Matrix3::new(0.9, -0.1, 200.0, 0.15, 0.8, 90.0, 5e-5, -1e-4, 1.0));
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut rows: Vec<(f64, PointPair, bool)> = (0..n)
            .map(|k| {
                let mut random = |w: f64, h: f64| Vector2::new(rng.random_range(0.0..w), rng.random_range(0.0..h));
                let from = random(1000.0, 800.0);
                let is_good = k < good;
                let noise = (random(1.0, 1.0) + random(1.0, 1.0) + random(1.0, 1.0) - Vector2::new(1.5, 1.5)) * 1.4;
                let to = if is_good { truth.map(from).expect("in front") + noise } else { random(1280.0, 720.0) };
                let quality = rng.random_range(0.0_f64..1.0).powi(if is_good { 2 } else { 1 }) + if is_good { 0.0 } else { 0.25 };
                (quality, PointPair { from, to }, is_good)
            })
            .collect();
        rows.sort_by(|a, b| a.0.total_cmp(&b.0));
        (truth, rows.iter().map(|r| r.1).collect(), rows.iter().map(|r| r.2).collect())
    }

    #[test]
    fn a_plane_is_found_with_only_a_tenth_inliers() {
        for (good, seed) in [(250, 1), (100, 2), (50, 3), (50, 4)] {
            let (truth, pairs, labels) = mixture(500, good, seed);
            let options = RobustOptions { max_samples: 4000, order: Order::PROSAC, seed: 7, ..RobustOptions::default() };
            let found = robust_homography(&pairs, &options).expect("a plane");
            let right = found.inliers.iter().filter(|&&k| labels[k]).count();
            assert!(right as f64 > 0.9 * good as f64, "{right} of {good}");
            for corner in [(0.0, 0.0), (1000.0, 0.0), (1000.0, 800.0), (0.0, 800.0)] {
                let c = Vector2::new(corner.0, corner.1);
                let e = (found.model.map(c).expect("in front") - truth.map(c).expect("in front")).norm();
                assert!(e < 2.0, "corner error {e} with {good} inliers");
            }
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_answer() {
        let (_, pairs, _) = mixture(300, 100, 9);
        let options = RobustOptions { max_samples: 1000, order: Order::PROSAC, seed: 5, ..RobustOptions::default() };
        assert_eq!(robust_homography(&pairs, &options), robust_homography(&pairs, &options));
    }

    #[test]
    fn three_matches_are_no_homography() {
        let (_, pairs, _) = mixture(3, 3, 1);
        let options = RobustOptions { max_samples: 100, ..RobustOptions::default() };
        assert!(robust_homography(&pairs, &options).is_none());
    }
}
