//! Robust homography estimation: samples drawn in the order of match quality (PROSAC, Chum & Matas 2005),
//! scored by truncated squares (MSAC), improved locally whenever a better one is found.
//!
//! Matches must come sorted, best first. The generator is seeded, so the same matches give the same answer.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::homography::{Homography, PointPair};

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
    if pairs.len() < 4 {
        return None;
    }
    let t2 = options.threshold * options.threshold;
    let mut rng = Pcg64Mcg::seed_from_u64(options.seed);
    let mut best: Option<(Homography, f64)> = None;
    let mut wanted = options.max_samples;
    let mut sampler = Prosac::new(pairs.len(), options.max_samples);
    let mut drawn = 0;
    while drawn < wanted {
        drawn += 1;
        let sample = sampler.next(&mut rng).map(|k| pairs[k]);
        let Some(h) = Homography::from_four(&sample) else { continue };
        let s = score(&h, pairs, t2);
        if s <= best.as_ref().map_or(3.5, |b| b.1) {
            continue;
        }
        let (h, s) = locally_optimised(h, s, pairs, options.threshold);
        best = Some((h, s));
        let share = pairs.iter().filter(|p| h.squared_error(p) < t2).count() as f64 / pairs.len() as f64;
        let miss = (1.0 - share.powi(4)).clamp(1e-12, 1.0 - 1e-12).ln();
        let needed = ((1.0 - options.confidence).ln() / miss).ceil();
        wanted = options.max_samples.min(drawn.max(needed.min(1e9) as usize));
    }
    let (homography, _) = best?;
    let homography = homography.refined(&inliers_of(&homography, pairs, t2), options.threshold / 3.0, 15).unwrap_or(homography);
    let inliers: Vec<usize> = (0..pairs.len()).filter(|&k| homography.squared_error(&pairs[k]) < t2).collect();
    let score = score(&homography, pairs, t2);
    (inliers.len() >= 4).then_some(RobustHomography { homography, inliers, score })
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

/// PROSAC's growing sample pool.
struct Prosac {
    total: usize,
    pool: usize,
    /// T_n of the paper: expected samples from the first n of `max_samples` drawn from all.
    average: f64,
    /// T'_n: the draw after which the pool grows.
    grow_at: usize,
    drawn: usize,
}

impl Prosac {
    fn new(total: usize, max_samples: usize) -> Self {
        let average = (0..4).fold(max_samples as f64, |t, i| t * (4 - i) as f64 / (total - i) as f64);
        Self { total, pool: 4, average, grow_at: 1, drawn: 0 }
    }

    fn next(&mut self, rng: &mut Pcg64Mcg) -> [usize; 4] {
        self.drawn += 1;
        while self.drawn > self.grow_at && self.pool < self.total {
            let next = self.average * (self.pool + 1) as f64 / (self.pool + 1 - 4) as f64;
            self.grow_at += (next - self.average).ceil().max(1.0) as usize;
            self.average = next;
            self.pool += 1;
        }
        let mut sample = [0; 4];
        // While the pool grows, its newest match is always part of the sample.
        let from_rest = if self.pool < self.total && self.drawn <= self.grow_at { 3 } else { 4 };
        let range = if from_rest == 3 { self.pool - 1 } else { self.pool };
        for k in 0..from_rest {
            sample[k] = loop {
                let pick = rng.random_range(0..range);
                if !sample[..k].contains(&pick) {
                    break pick;
                }
            };
        }
        if from_rest == 3 {
            sample[3] = self.pool - 1;
        }
        sample
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector2};

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
