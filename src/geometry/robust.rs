//! Common parts of the robust estimators: options and results.

use super::correspondence::Correspondence;
use super::noise::{self, Within};
use super::ransac::Order;

/// Search limits and the inlier threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobustOptions {
    /// Maximum distance of an inlier, pixels: transfer error in the second picture for a
    /// homography, Sampson distance for epipolar relations. Default 3, about three to four times
    /// the noise of a corner found at a coarse scale. Raised, more wrong pairs agree.
    pub threshold: f64,
    /// Maximum number of samples; default 20,000. Raised, fewer inliers suffice and failures take
    /// longer.
    pub max_samples: usize,
    /// Stop when the chance of having missed a better model is below 1 - this; default 0.9999.
    pub confidence: f64,
    /// Order in which samples are drawn; default [`Order::Even`]. Use [`Order::PROSAC`] for pairs
    /// sorted best first.
    pub order: Order,
    /// Whether the last step of a homography is ordinary least squares over the inliers instead of
    /// down-weighting far ones; default true. A fiftieth more precise if the inliers are true, less
    /// precise if many are not.
    pub weighs_alike: bool,
    /// Seed of the sampler; default 1.
    pub seed: u64,
}

impl Default for RobustOptions {
    fn default() -> Self {
        Self { threshold: 3.0, max_samples: 20_000, confidence: 0.9999, order: Order::Even, weighs_alike: true, seed: 1 }
    }
}

/// A model and the pairs that agree with it.
#[derive(Debug, Clone, PartialEq)]
pub struct RobustModel<M> {
    /// The refined model.
    pub model: M,
    /// Indices of the inliers, ascending.
    pub inliers: Vec<usize>,
    /// Sum of 1 - d²/t² over the inliers; higher is better. (`homography_of_unknown_noise` reports
    /// its own marginal score instead.)
    pub score: f64,
    /// Standard deviation of one coordinate of the inliers' distances, pixels.
    pub sigma: f64,
}

impl<M> RobustModel<M> {
    /// Builds the result for a model from the squared distances of all pairs.
    pub(super) fn judged(model: M, squared: impl Iterator<Item = f64>, threshold: f64, within: Within) -> Self {
        let t2 = threshold * threshold;
        let (mut inliers, mut distances, mut score) = (Vec::new(), Vec::new(), 0.0);
        for (k, d2) in squared.enumerate().filter(|(_, d2)| *d2 < t2) {
            inliers.push(k);
            distances.push(d2);
            score += (1.0 - d2 / t2).max(0.0);
        }
        Self { model, inliers, score, sigma: noise::of_inliers(&mut distances, threshold, within) }
    }

    /// Converts inlier indices from a subset of the pairs to indices among all.
    pub(super) fn among(mut self, indices: &[usize]) -> Self {
        self.inliers.iter_mut().for_each(|k| *k = indices[*k]);
        self
    }
}

/// Returns the indices of the usable pairs.
pub(super) fn usable<C: Correspondence>(pairs: &[C]) -> Vec<usize> {
    (0..pairs.len()).filter(|&k| pairs[k].is_usable()).collect()
}

/// Whether the options' threshold is finite and positive.
pub(super) fn is_sound(options: &RobustOptions) -> bool {
    options.threshold.is_finite() && options.threshold > 0.0
}
