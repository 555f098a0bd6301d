//! Robust estimation of the fundamental matrix: seven-point samples scored by truncated squared
//! (MSAC) Sampson distances in pixels, refined on the inliers whenever a better one is found.

use nalgebra::Matrix3;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::eight_point::eight_point;
use super::fundamental_refinement::refine_fundamental;
use super::line_noise::from_line;
use super::seven_point::{is_oriented, seven_point};
use crate::geometry::correspondence::Correspondence;
use crate::geometry::distances::squared_sampson;
use crate::geometry::ransac::{self, Estimator};
use crate::geometry::robust::{self, RobustModel, RobustOptions};
use crate::geometry::scoring::Scorer;

/// Minimum score of a relation: its own seven pairs always score 7, so this demands support beyond
/// the sample. Raised, more support is required.
const MIN_SCORE: f64 = 7.5;
/// Refinement iterations during the search, and in the last refinement, which has converged by
/// then. Raised, the search takes longer.
const STEPS_IN_SEARCH: usize = 4;
const LAST_STEPS: usize = 20;

/// Number of pairs per inner sample of inliers, and number of such samples, as in the paper. Larger
/// samples are less often free of wrong pairs; smaller ones are less accurate.
const INNER_SAMPLE: usize = 14;
const INNER_SAMPLES: usize = 20;

/// Finds the fundamental matrix (pixels to pixels, rank two, norm 1) with the most support; `None`
/// if no more pairs than a sample agree.
///
/// If all pairs are on one plane, or the camera only rotated, F is not determined: the result
/// explains the pairs but no motion. `choose_model` detects this.
pub fn robust_fundamental<C: Correspondence + Copy>(pairs: &[C], options: &RobustOptions) -> Option<RobustModel<Matrix3<f64>>> {
    let RobustOptions { threshold, max_samples, confidence, order, seed, .. } = *options;
    if !robust::is_sound(options) {
        return None;
    }
    let indices = robust::usable(pairs);
    let pairs: Vec<C> = indices.iter().map(|&k| pairs[k]).collect();
    let search = ransac::Options { samples: max_samples, confidence: Some(confidence), order, least_score: MIN_SCORE, keep: 1, seed };
    let views = Views { pairs: &pairs, scorer: Scorer::new(&pairs, threshold), threshold };
    let (score, f) = ransac::search(&views, &search).pop()?;
    let (f, score) = views.resampled(f, score, seed);
    let (f, _) = views.refined(f, score, LAST_STEPS);
    let found = RobustModel::judged(f, pairs.iter().map(|p| squared_sampson(&f, p)), threshold, from_line);
    (found.inliers.len() > 7).then(|| found.among(&indices))
}

/// Pairs in two views; seven of them give up to three fundamental matrices.
struct Views<'a, C> {
    pairs: &'a [C],
    scorer: Scorer,
    threshold: f64,
}

impl<C: Correspondence + Copy> Estimator<7> for Views<'_, C> {
    type Model = Matrix3<f64>;

    fn count(&self) -> usize {
        self.pairs.len()
    }

    fn models(&self, sample: [usize; 7]) -> impl Iterator<Item = Matrix3<f64>> {
        let sample = sample.map(|k| self.pairs[k]);
        seven_point(&sample).into_iter().filter(move |f| is_oriented(f, &sample))
    }

    fn score(&self, f: &Matrix3<f64>, bar: f64) -> Option<f64> {
        self.scorer.epipolar(f, bar)
    }

    fn improved(&self, f: Matrix3<f64>, score: f64) -> (Matrix3<f64>, f64) {
        let linear = eight_point(&self.near(&f, 2.0), None).and_then(|f| Some((f, self.scorer.epipolar(&f, score)?)));
        let (f, score) = linear.unwrap_or((f, score));
        self.refined(f, score, STEPS_IN_SEARCH)
    }

    fn agrees(&self, f: &Matrix3<f64>, datum: usize) -> bool {
        squared_sampson(f, &self.pairs[datum]) < self.threshold.powi(2)
    }
}

impl<C: Correspondence + Copy> Views<'_, C> {
    /// Returns pairs within this multiple of the threshold.
    fn near(&self, f: &Matrix3<f64>, thresholds: f64) -> Vec<C> {
        let within = (thresholds * self.threshold).powi(2);
        self.pairs.iter().filter(|p| squared_sampson(f, *p) < within).copied().collect()
    }

    /// Returns the best result of samples drawn from the inliers alone (the inner search of Chum,
    /// Matas and Kittler 2003). A few wrong pairs that agree by chance can trap the refinement in a
    /// poor optimum; samples without them escape it.
    fn resampled(&self, mut f: Matrix3<f64>, mut score: f64, seed: u64) -> (Matrix3<f64>, f64) {
        let mut inliers = self.near(&f, 1.0);
        let size = INNER_SAMPLE.min(inliers.len() / 2);
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        for _ in 0..INNER_SAMPLES {
            // A partial Fisher-Yates shuffle: no pair is drawn twice.
            for k in 0..size {
                let other = rng.random_range(k..inliers.len());
                inliers.swap(k, other);
            }
            let sample = &inliers[..size];
            let Some(start) = eight_point(sample, None) else { continue };
            let (next, next_score) = self.refined(start, 0.0, STEPS_IN_SEARCH);
            if next_score > score {
                (f, score) = (next, next_score);
            }
        }
        (f, score)
    }

    /// Refines on nearby pairs, first within twice the threshold; keeps the best model.
    fn refined(&self, mut f: Matrix3<f64>, mut score: f64, steps: usize) -> (Matrix3<f64>, f64) {
        for thresholds in [2.0, 1.0] {
            let next = refine_fundamental(&f, &self.near(&f, thresholds), self.threshold / 3.0, steps);
            if let Some((next, next_score)) = next.and_then(|next| Some((next, self.scorer.epipolar(&next, score)?))) {
                (f, score) = (next, next_score);
            }
        }
        (f, score)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::homography::PointPair;
    use crate::geometry::ransac::Order;
    use crate::geometry::test_views::{pixels, scene, true_fundamental};

    /// True pairs with half a pixel of noise, mixed with wrong ones.
    pub fn mixture(good: usize, wrong: usize, seed: u64) -> (Vec<PointPair>, Vec<bool>) {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut rows: Vec<(f64, PointPair, bool)> =
            pixels(&scene(good, 0.001, false, seed)).into_iter().map(|p| (random.random_range(0.0..1.0), p, true)).collect();
        for _ in 0..wrong {
            let mut at = || Vector2::new(random.random_range(0.0..1000.0), random.random_range(0.0..800.0));
            let pair = PointPair { from: at(), to: at() };
            rows.push((random.random_range(0.3..1.3), pair, false));
        }
        rows.sort_by(|a, b| a.0.total_cmp(&b.0));
        (rows.iter().map(|r| r.1).collect(), rows.iter().map(|r| r.2).collect())
    }

    /// RMS distance of exact pairs from an estimate.
    fn error(f: &Matrix3<f64>) -> f64 {
        let exact = pixels(&scene(300, 0.0, false, 99));
        (exact.iter().map(|p| squared_sampson(f, p)).sum::<f64>() / 300.0).sqrt()
    }

    #[test]
    fn the_fundamental_matrix_is_found_despite_outliers() {
        for (good, wrong, order) in [(200, 100, Order::Even), (150, 150, Order::Even), (100, 300, Order::PROSAC)] {
            for seed in 0..5 {
                let (pairs, labels) = mixture(good, wrong, seed);
                let found = robust_fundamental(&pairs, &RobustOptions { threshold: 2.0, order, seed, ..RobustOptions::default() });
                let found = found.expect("a relation");
                let right = found.inliers.iter().filter(|&&k| labels[k]).count();
                assert!(right as f64 > 0.95 * good as f64, "{right} of {good}");
                let of_truth: Vec<PointPair> = pairs.iter().zip(&labels).filter(|(_, good)| **good).map(|(p, _)| *p).collect();
                let oracle = error(&refine_fundamental(&true_fundamental(), &of_truth, 100.0, 50).expect("regular"));
                assert!(error(&found.model) < 1.5 * oracle + 0.2, "{good} of {wrong}, {seed}: {} {oracle}", error(&found.model));
                // The noise is uniform over ±0.8 px.
                assert!((0.25..0.75).contains(&found.sigma), "{}", found.sigma);
            }
        }
        assert!(error(&true_fundamental()) < 1e-9);
    }

    /// Thesis error E22: thresholds without a unit, whose meaning changed from pair to pair.
    #[test]
    fn e22_thresholds_are_in_pixels_in_any_coordinate_unit() {
        let (pairs, _) = mixture(150, 100, 3);
        let options = RobustOptions { threshold: 2.0, ..RobustOptions::default() };
        let plain = robust_fundamental(&pairs, &options).expect("a relation");
        assert!(pairs.iter().enumerate().all(|(k, p)| (squared_sampson(&plain.model, p) < 4.0) == plain.inliers.contains(&k)));
        for unit in [1e-3, 1e3] {
            let scaled: Vec<PointPair> = pairs.iter().map(|p| PointPair { from: p.from * unit, to: p.to * unit }).collect();
            let found = robust_fundamental(&scaled, &RobustOptions { threshold: 2.0 * unit, ..options }).expect("a relation");
            assert_eq!(found.inliers, plain.inliers);
            assert!((found.sigma / unit - plain.sigma).abs() < 1e-6);
        }
    }

    #[test]
    fn the_search_is_repeatable_and_needs_enough_pairs() {
        let (pairs, _) = mixture(60, 60, 1);
        let options = RobustOptions::default();
        assert_eq!(robust_fundamental(&pairs, &options), robust_fundamental(&pairs, &options));
        for few in [&pairs[..0], &pairs[..7]] {
            assert_eq!(robust_fundamental(few, &options), None);
        }
        assert_eq!(robust_fundamental(&[pairs[0]; 40], &options), None);
        for threshold in [0.0, -1.0, f64::NAN] {
            assert_eq!(robust_fundamental(&pairs, &RobustOptions { threshold, ..options }), None);
        }
    }

    #[test]
    fn invalid_pairs_are_skipped_and_indices_preserved() {
        let (pairs, _) = mixture(80, 20, 2);
        let mut with_holes = vec![PointPair { from: Vector2::new(f64::NAN, 1.0), to: Vector2::zeros() }; 3];
        with_holes.extend(&pairs);
        let options = RobustOptions::default();
        let (plain, holes) = (robust_fundamental(&pairs, &options), robust_fundamental(&with_holes, &options));
        let (plain, holes) = (plain.expect("a relation"), holes.expect("a relation"));
        assert_eq!(holes.inliers, plain.inliers.iter().map(|k| k + 3).collect::<Vec<_>>());
    }
}
