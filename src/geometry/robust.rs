//! Robust homography estimation: samples drawn in the order of match quality, scored by truncated squares (MSAC), improved
//! locally whenever a better one is found.
//!
//! Matches must come sorted, best first. The generator is seeded, so the same matches give the same answer.

use super::homography::{Homography, PointPair};
use super::ransac::{self, Estimator};

/// Score that a homography must exceed to be kept. Its own four points alone score close to 4, so this only passes over
/// samples that are numerically unsound. Raised above 4, a homography needs support from outside its sample.
const LEAST_SCORE: f64 = 3.5;

/// What the search may spend and what counts as agreement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobustOptions {
    /// Largest transfer error of an inlier, in the units of the second plane.
    pub threshold: f64,
    /// Samples at most.
    pub max_samples: usize,
    /// Stop when the chance of having missed a better model is below 1 - this.
    pub confidence: f64,
    /// Seed of the sampler.
    pub seed: u64,
}

/// A homography and the matches that agree with it.
#[derive(Debug, Clone, PartialEq)]
pub struct RobustHomography {
    /// The refined map.
    pub homography: Homography,
    /// Indices of the inliers, ascending.
    pub inliers: Vec<usize>,
    /// MSAC score: sum of 1 - e²/t² over the inliers; higher is better.
    pub score: f64,
}

/// Finds the homography that most matches agree with, or `None` when fewer than four ever do.
pub fn robust_homography(pairs: &[PointPair], options: &RobustOptions) -> Option<RobustHomography> {
    let RobustOptions { threshold, max_samples, confidence, seed } = *options;
    let t2 = threshold * threshold;
    let search = ransac::Options {
        samples: max_samples,
        confidence: Some(confidence),
        is_progressive: true,
        least_score: LEAST_SCORE,
        keep: 1,
        seed,
    };
    let (_, homography) = ransac::search(&Plane { pairs, threshold }, &search).pop()?;
    let homography = homography.refined(&inliers_of(&homography, pairs, t2), options.threshold / 3.0, 15).unwrap_or(homography);
    let inliers: Vec<usize> = (0..pairs.len()).filter(|&k| homography.squared_error(&pairs[k]) < t2).collect();
    let score = score(&homography, pairs, t2);
    (inliers.len() >= 4).then_some(RobustHomography { homography, inliers, score })
}

/// Pairs of points on two planes, of which four make a homography.
struct Plane<'a> {
    pairs: &'a [PointPair],
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

    fn score(&self, h: &Homography) -> f64 {
        score(h, self.pairs, self.threshold.powi(2))
    }

    fn improved(&self, h: Homography, score: f64) -> (Homography, f64) {
        locally_optimised(h, score, self.pairs, self.threshold)
    }

    fn inlier_share(&self, h: &Homography) -> f64 {
        let t2 = self.threshold.powi(2);
        self.pairs.iter().filter(|p| h.squared_error(p) < t2).count() as f64 / self.pairs.len() as f64
    }
}

fn score(h: &Homography, pairs: &[PointPair], t2: f64) -> f64 {
    pairs.iter().map(|p| (1.0 - h.squared_error(p) / t2).max(0.0)).sum()
}

fn inliers_of(h: &Homography, pairs: &[PointPair], t2: f64) -> Vec<PointPair> {
    pairs.iter().filter(|p| h.squared_error(p) < t2).copied().collect()
}

/// Refits to the inliers, widening the net first so that a rough sample can grow.
fn locally_optimised(mut h: Homography, mut s: f64, pairs: &[PointPair], threshold: f64) -> (Homography, f64) {
    let t2 = threshold * threshold;
    for widen in [3.0, 2.0, 1.0] {
        let near = inliers_of(&h, pairs, t2 * widen * widen);
        let Some(next) = Homography::from_pairs(&near, None) else { continue };
        let next_score = score(&next, pairs, t2);
        if near.len() >= 5 && next_score > s {
            (h, s) = (next, next_score);
        }
    }
    (h, s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector2};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    /// `good` true pairs mixed into random ones; the true ones tend to come first, as a ratio test orders them.
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
    fn finds_the_plane_down_to_a_tenth_of_inliers() {
        for (good, seed) in [(250, 1), (100, 2), (50, 3), (50, 4)] {
            let (truth, pairs, labels) = mixture(500, good, seed);
            let options = RobustOptions { threshold: 3.0, max_samples: 4000, confidence: 0.9999, seed: 7 };
            let found = robust_homography(&pairs, &options).expect("a plane");
            let right = found.inliers.iter().filter(|&&k| labels[k]).count();
            assert!(right as f64 > 0.9 * good as f64, "{right} of {good}");
            for corner in [(0.0, 0.0), (1000.0, 0.0), (1000.0, 800.0), (0.0, 800.0)] {
                let c = Vector2::new(corner.0, corner.1);
                let e = (found.homography.map(c).expect("in front") - truth.map(c).expect("in front")).norm();
                assert!(e < 2.0, "corner error {e} with {good} inliers");
            }
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_answer() {
        let (_, pairs, _) = mixture(300, 100, 9);
        let options = RobustOptions { threshold: 3.0, max_samples: 1000, confidence: 0.999, seed: 5 };
        assert_eq!(robust_homography(&pairs, &options), robust_homography(&pairs, &options));
    }

    #[test]
    fn three_matches_are_no_homography() {
        let (_, pairs, _) = mixture(3, 3, 1);
        let options = RobustOptions { threshold: 3.0, max_samples: 100, confidence: 0.99, seed: 5 };
        assert!(robust_homography(&pairs, &options).is_none());
    }
}
