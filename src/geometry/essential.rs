//! Candidates for the essential matrix; several, because a flat scene allows two motions.

use nalgebra::Matrix3;

use super::distances::squared_sampson;
use super::five_point::five_point;
use super::ransac::{self, Estimator, Order};
use super::relative_pose::RayPair;

/// Searches robustly with `samples` five-point samples, scored by truncated squared (MSAC) Sampson
/// distances. Returns every distinct good model, best first (at most `keep`), because a flat scene
/// allows two. `threshold` is in the pairs' units. `robust_essential` instead returns the single
/// best motion, refined, with a threshold in pixels.
pub fn essential_candidates(pairs: &[RayPair], threshold: f64, samples: usize, keep: usize, seed: u64) -> Vec<Matrix3<f64>> {
    if pairs.len() < 6 {
        return Vec::new();
    }
    let options = ransac::Options { samples, confidence: None, order: Order::Even, least_score: f64::NEG_INFINITY, keep, seed };
    ransac::search(&TwoViews { pairs, t2: threshold * threshold }, &options).into_iter().map(|(_, e)| e).collect()
}

/// Rays seen in two views; five of them give up to ten essential matrices.
struct TwoViews<'a> {
    pairs: &'a [RayPair],
    /// Squared threshold.
    t2: f64,
}

impl Estimator<5> for TwoViews<'_> {
    type Model = Matrix3<f64>;

    fn count(&self) -> usize {
        self.pairs.len()
    }

    fn models(&self, sample: [usize; 5]) -> impl Iterator<Item = Matrix3<f64>> {
        five_point(&sample.map(|k| self.pairs[k])).into_iter()
    }

    fn score(&self, e: &Matrix3<f64>, bar: f64) -> Option<f64> {
        let mut cost = 0.0;
        for pair in self.pairs {
            cost += squared_sampson(e, pair).min(self.t2);
            // The cost can only grow.
            if -cost <= bar {
                return None;
            }
        }
        Some(-cost)
    }

    fn agrees(&self, e: &Matrix3<f64>, datum: usize) -> bool {
        squared_sampson(e, &self.pairs[datum]) < self.t2
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::geometry::essential_decomposition::motion_by_cheirality;
    use crate::geometry::motion_refinement::refine_motion;
    use crate::geometry::test_views::{errors_deg, scene};

    #[test]
    fn robust_search_and_refinement_tolerate_outliers() {
        let mut pairs = scene(200, 0.0005, false, 6);
        for (k, p) in pairs.iter_mut().enumerate().take(60) {
            p.second += Vector2::new(0.1, 0.05 * k as f64 / 60.0);
        }
        let found = essential_candidates(&pairs, 0.002, 100, 1, 3);
        let inliers: Vec<RayPair> = pairs.iter().filter(|p| squared_sampson(&found[0], p) < 0.002_f64.powi(2)).copied().collect();
        let (m, _) = motion_by_cheirality(&found[0], &inliers).expect("decomposes");
        let (r, t) = errors_deg(&refine_motion(&m, &pairs, 0.0005, 30));
        assert!(r < 0.1 && t < 0.5, "{r} {t}");
    }

    #[test]
    fn a_flat_scene_keeps_the_true_motion_among_the_candidates() {
        let pairs = scene(100, 0.0003, true, 9);
        let near = essential_candidates(&pairs, 0.001, 60, 20, 4).iter().any(|e| {
            motion_by_cheirality(e, &pairs).is_some_and(|(m, _)| {
                let (r, t) = errors_deg(&refine_motion(&m, &pairs, 0.0003, 30));
                r < 0.5 && t < 3.0
            })
        });
        assert!(near);
    }
}
