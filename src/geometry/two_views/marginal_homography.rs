//! Robust homography from pairs with unknown noise and a scene that is not quite flat.
//!
//! Samples are drawn in order of match quality. They are scored and refined by the likelihood
//! marginalised over the noise ([`super::marginal_noise`]), so no threshold separates right from
//! wrong pairs. With a fixed threshold, the best plane is the one close to most pairs, which covers
//! only a part of a scene that is not quite flat. The last fits weight each pair by how correlated
//! its neighbours' errors are ([`super::shared_errors`]), so that a part of the scene counts by its
//! size and not by its number of pairs. The generator is seeded, so the same matches give the same
//! result.

use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2};

use super::distances::squared_sampson_of_homography;
use super::marginal_noise::{MarginalNoise, QUANTILE};
use super::shared_errors::Patches;
use crate::geometry::homography::{Homography, PointPair};
use crate::geometry::least_squares::{Damping, MIN_GAIN_OF_PAIRS, Options, Problem, minimise};
use crate::geometry::noise::between_points;
use crate::geometry::normalisation::normalising;
use crate::geometry::ransac::{self, Estimator};
use crate::geometry::robust::{self, RobustModel, RobustOptions};
use crate::geometry::transfer_refinement::{damped_step, with_pinned_scale};

/// Minimum score of a homography. A sample's own four pairs score 4, so this rejects only
/// numerically bad samples; raised above 4, it demands support beyond the sample.
const MIN_SCORE: f64 = 3.5;
/// Refinement iterations during the search, and in the last refinement, which has converged by
/// then. Raised, the search takes longer.
const STEPS_IN_SEARCH: usize = 4;
const LAST_STEPS: usize = 30;
/// Distance, in standard deviations, that 95 % of two-dimensional noise stays within. Raised, wrong
/// pairs agree; lowered, right ones do not.
const INLIER_SIGMAS: f64 = 2.45;
/// In the last step, the maximum standard deviation is at least this multiple of the observed one;
/// any closer, true pairs would lose weight just for their noise. Raised, large noise is handled
/// better, and pairs of another plane pull more.
const ROOM: f64 = 3.0;
/// Maximum number of fits with correlation weights, and the change of correlation that ends them.
/// More rounds or a smaller change take longer.
const ROUNDS: usize = 6;
const MIN_CHANGE: f64 = 0.01;

/// Finds the homography with the most support, or `None` if fewer than four pairs agree.
/// `most_noise` is the maximum standard deviation of a coordinate's noise, pixels. Distances are
/// Sampson distances in both pictures; those beyond three times `most_noise` have no weight.
///
/// Inliers are within 95 % of the observed noise; pairs within `options.threshold` are always
/// inliers.
pub fn homography_of_unknown_noise(pairs: &[PointPair], most_noise: f64, options: &RobustOptions) -> Option<RobustModel<Homography>> {
    let RobustOptions { threshold, max_samples, confidence, order, seed, .. } = *options;
    if !(robust::is_sound(options) && most_noise.is_finite() && most_noise > 0.0) {
        return None;
    }
    let indices = robust::usable(pairs);
    let pairs: Vec<PointPair> = indices.iter().map(|&k| pairs[k]).collect();
    let search = ransac::Options { samples: max_samples, confidence: Some(confidence), order, least_score: MIN_SCORE, keep: 1, seed };
    let widest = QUANTILE * most_noise;
    let plane = Plane { pairs: &pairs, noise: MarginalNoise::up_to(widest) };
    let (score, homography) = ransac::search(&plane, &search).pop()?;
    let (homography, score) = plane.refined(homography, score, LAST_STEPS);
    let judged = |homography: &Homography, threshold| {
        let squared = pairs.iter().map(|p| squared_sampson_of_homography(homography, p));
        RobustModel { score, ..RobustModel::judged(*homography, squared, threshold, between_points) }
    };
    let widest = widest.max(QUANTILE * ROOM * judged(&homography, widest).sigma);
    let plane = Plane { pairs: &pairs, noise: MarginalNoise::up_to(widest) };
    let homography = plane.fitted_by_patches(homography, 2.0 * threshold);
    let found = judged(&homography, (INLIER_SIGMAS * judged(&homography, widest).sigma).max(threshold));
    (found.inliers.len() >= 4).then(|| found.among(&indices))
}

/// Pairs of points on two planes; four of them define a homography.
struct Plane<'a> {
    pairs: &'a [PointPair],
    noise: MarginalNoise,
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
        let (mut score, mut left) = (0.0, self.pairs.len() as f64);
        for pair in self.pairs {
            left -= 1.0;
            score += self.noise.agreement(squared_sampson_of_homography(h, pair));
            if score + left < bar {
                return None;
            }
        }
        Some(score).filter(|score| *score > bar)
    }

    fn improved(&self, h: Homography, score: f64) -> (Homography, f64) {
        let near = self.near(&h);
        let linear = Homography::from_pairs(&near, None).and_then(|h| Some((h, self.score(&h, score)?)));
        let (h, score) = linear.unwrap_or((h, score));
        self.refined(h, score, STEPS_IN_SEARCH)
    }

    fn agrees(&self, h: &Homography, datum: usize) -> bool {
        squared_sampson_of_homography(h, &self.pairs[datum]) < self.noise.t2()
    }
}

impl Plane<'_> {
    fn near(&self, h: &Homography) -> Vec<PointPair> {
        self.pairs.iter().filter(|p| squared_sampson_of_homography(h, *p) < self.noise.t2()).copied().collect()
    }

    /// Refines on all pairs with weight, unless that lowers the score.
    fn refined(&self, h: Homography, score: f64, steps: usize) -> (Homography, f64) {
        let near = self.near(&h);
        let next = SampsonErrors::new(&near, vec![1.0; near.len()], &self.noise).and_then(|mut errors| errors.refined(&h, steps));
        next.and_then(|next| Some((next, self.score(&next, score)?))).unwrap_or((h, score))
    }

    /// Fits to all pairs with weight, each scaled by its share in its neighbours' correlated
    /// errors. `same`: distance in pixels within which two positions count as one.
    fn fitted_by_patches(&self, mut h: Homography, same: f64) -> Homography {
        let near = self.near(&h);
        let patches = Patches::new(near.iter().map(|p| p.from).collect(), same);
        let Some(mut errors) = SampsonErrors::new(&near, vec![1.0; near.len()], &self.noise) else { return h };
        let mut correlation = 0.0;
        for round in 0..ROUNDS {
            let Some(next) = errors.refined(&h, LAST_STEPS) else { break };
            h = next;
            let before = std::mem::replace(&mut correlation, patches.correlation(&errors.whitened(&h)));
            if round > 0 && (correlation - before).abs() < MIN_CHANGE {
                break;
            }
            errors.shares = patches.shares(correlation);
        }
        h
    }
}

/// Sampson distances in pixels, of normalised pairs.
struct SampsonErrors<'a> {
    pairs: Vec<PointPair>,
    /// Weight of each pair.
    shares: Vec<f64>,
    /// Normalisations of the first and the second picture.
    scales: [Matrix3<f64>; 2],
    noise: &'a MarginalNoise,
}

/// One pair's transfer error, its derivative by the entries of H (row by row), and its inverse
/// covariance for noise of one pixel.
struct Row {
    error: Vector2<f64>,
    by_h: SMatrix<f64, 2, 9>,
    information: Matrix2<f64>,
}

impl<'a> SampsonErrors<'a> {
    /// `None` if all positions coincide.
    fn new(pairs: &[PointPair], shares: Vec<f64>, noise: &'a MarginalNoise) -> Option<Self> {
        let scales = [normalising(pairs.iter().map(|p| p.from))?, normalising(pairs.iter().map(|p| p.to))?];
        let scaled = |by: &Matrix3<f64>, p: Vector2<f64>| (by * p.push(1.0)).xy();
        let of = |p: &PointPair| PointPair { from: scaled(&scales[0], p.from), to: scaled(&scales[1], p.to) };
        Some(Self { pairs: pairs.iter().map(of).collect(), shares, scales, noise })
    }

    /// Refines by Levenberg-Marquardt with the weights of the marginal likelihood.
    fn refined(&mut self, start: &Homography, iterations: usize) -> Option<Homography> {
        let [from, to] = self.scales;
        let (from_inverse, to_inverse) = (from.try_inverse()?, to.try_inverse()?);
        let damping = Damping { now: 1e-6, least: 1e-12, most: 1e3 };
        let options = Options { iterations, damping, least_gain: MIN_GAIN_OF_PAIRS };
        let start = to * start.0 * from_inverse;
        let (scaled, _) = minimise(self, start / start.norm(), &options);
        let front = self.pairs.iter().map(|p| (scaled * p.from.push(1.0)).z.signum()).sum::<f64>();
        let h = to_inverse * scaled * from;
        let h = h * (front.signum() / h.norm());
        h.iter().all(|v| v.is_finite()).then_some(Homography(h))
    }

    /// Returns each pair's error, whitened for noise of one pixel, and its weight by distance.
    fn whitened(&self, h: &Homography) -> Vec<(Vector2<f64>, f64)> {
        let [from, to] = self.scales;
        let nothing = (Vector2::zeros(), 0.0);
        let Some(from_inverse) = from.try_inverse() else { return vec![nothing; self.pairs.len()] };
        let scaled = to * h.0 * from_inverse;
        let of = |row: Row| {
            let root = row.information.cholesky()?.l().transpose();
            Some((root * row.error, self.noise.weight(Self::squared(&row))))
        };
        self.pairs.iter().map(|p| self.row(&scaled, p).and_then(of).unwrap_or(nothing)).collect()
    }

    fn row(&self, h: &Matrix3<f64>, pair: &PointPair) -> Option<Row> {
        let a = pair.from.push(1.0);
        let v = h * a;
        if v.z.abs() < 1e-9 {
            return None;
        }
        let q = v.xy() / v.z;
        let mut by_h = SMatrix::<f64, 2, 9>::zeros();
        for k in 0..2 {
            by_h.fixed_view_mut::<1, 3>(k, 3 * k).copy_from(&(a / v.z).transpose());
            by_h.fixed_view_mut::<1, 3>(k, 6).copy_from(&(a * (-q[k] / v.z)).transpose());
        }
        let by_point = (h.fixed_view::<2, 2>(0, 0) - q * h.fixed_view::<1, 2>(2, 0)) / v.z;
        let [first, second] = self.scales.map(|scale| scale[(0, 0)] * scale[(0, 0)]);
        let covariance = by_point * by_point.transpose() * first + Matrix2::identity() * second;
        Some(Row { error: q - pair.to, by_h, information: covariance.try_inverse()? })
    }

    fn squared(row: &Row) -> f64 {
        row.error.dot(&(row.information * row.error))
    }
}

impl Problem for SampsonErrors<'_> {
    type State = Matrix3<f64>;
    type Normal = (SMatrix<f64, 9, 9>, SVector<f64, 9>);

    fn cost(&self, h: &Matrix3<f64>) -> f64 {
        let loss = |p: &PointPair| self.row(h, p).map_or(1.0, |row| 1.0 - self.noise.agreement(Self::squared(&row)));
        self.pairs.iter().zip(&self.shares).map(|(p, share)| share * loss(p)).sum()
    }

    fn linearised(&self, h: &Matrix3<f64>) -> Self::Normal {
        let (mut normal, mut gradient) = (SMatrix::<f64, 9, 9>::zeros(), SVector::<f64, 9>::zeros());
        for (pair, share) in self.pairs.iter().zip(&self.shares) {
            let Some(row) = self.row(h, pair) else { continue };
            let weighted = row.information * (share * self.noise.weight(Self::squared(&row)));
            let transposed = row.by_h.transpose() * weighted;
            normal += transposed * row.by_h;
            gradient += transposed * row.error;
        }
        (with_pinned_scale(&normal, h), gradient)
    }

    fn stepped(&self, h: &Matrix3<f64>, (normal, gradient): &Self::Normal, damping: f64) -> Option<Matrix3<f64>> {
        damped_step(h, normal, gradient, damping)
    }
}

#[cfg(test)]
#[path = "marginal_homography_tests.rs"]
mod tests;
