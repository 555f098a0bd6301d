//! Robust homography of pairs whose noise is not known: samples drawn in the order of match quality, scored and refined by the likelihood that is
//! marginalised over the noise ([`super::marginal_noise`]), so that no threshold says which pairs are right.
//!
//! With a fixed threshold the best plane is the one that most pairs lie nearest to: of a scene that is not quite flat, a part of it. The generator is
//! seeded, so the same matches give the same answer.

use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2};

use super::distances::squared_sampson_of_homography;
use super::homography::{Homography, PointPair};
use super::least_squares::{Damping, LEAST_GAIN_OF_PAIRS, Options, Problem, minimise};
use super::marginal_noise::{MarginalNoise, QUANTILE};
use super::noise::Dimensions;
use super::normalisation::normalising;
use super::ransac::{self, Estimator};
use super::robust::{self, RobustModel, RobustOptions};

/// A homography that little more than its own sample agrees with is none.
const LEAST_SCORE: f64 = 3.5;
/// Steps of a refinement in the search, and of the last one. Raised, the search takes longer; the last one has converged by then.
const STEPS_IN_SEARCH: usize = 4;
const LAST_STEPS: usize = 30;
/// Distance that 95 % of noise in two coordinates is within, standard deviations. Raised, wrong pairs agree; lowered, right ones do not.
const INLIER_SIGMAS: f64 = 2.45;
/// Largest deviation over the one that shows, at the least, in the last step: so near to the largest, true pairs would lose weight by being as far as they
/// are. Raised, noise of that size is borne better and pairs of another plane pull more.
const ROOM: f64 = 3.0;

/// Finds the homography that the pairs speak for most, or `None` when fewer than four ever agree. `most_noise` is the largest standard deviation that
/// the noise of a coordinate may have, pixels; distances are Sampson's in both pictures, those beyond three of it count nothing.
///
/// Inliers are within 95 % of the noise that the pairs show, and those within `options.threshold` are inliers in any case.
pub fn homography_of_unknown_noise(pairs: &[PointPair], most_noise: f64, options: &RobustOptions) -> Option<RobustModel<Homography>> {
    let RobustOptions { threshold, max_samples, confidence, order, seed, .. } = *options;
    if !(robust::is_sound(options) && most_noise.is_finite() && most_noise > 0.0) {
        return None;
    }
    let indices = robust::usable(pairs);
    let pairs: Vec<PointPair> = indices.iter().map(|&k| pairs[k]).collect();
    let search = ransac::Options { samples: max_samples, confidence: Some(confidence), order, least_score: LEAST_SCORE, keep: 1, seed };
    let widest = QUANTILE * most_noise;
    let plane = Plane { pairs: &pairs, noise: MarginalNoise::up_to(widest) };
    let (score, homography) = ransac::search(&plane, &search).pop()?;
    let (mut homography, score) = plane.refined(homography, score, LAST_STEPS);
    let judged = |homography: &Homography, threshold| {
        let squared = pairs.iter().map(|p| squared_sampson_of_homography(homography, p));
        RobustModel { score, ..RobustModel::judged(*homography, squared, threshold, Dimensions::Two) }
    };
    let sigma = judged(&homography, widest).sigma;
    if ROOM * sigma > most_noise {
        let wider = Plane { pairs: &pairs, noise: MarginalNoise::up_to(QUANTILE * ROOM * sigma) };
        homography = wider.refined(homography, f64::NEG_INFINITY, LAST_STEPS).0;
    }
    let found = judged(&homography, (INLIER_SIGMAS * sigma).max(threshold));
    (found.inliers.len() >= 4).then(|| found.among(&indices))
}

/// Pairs of points on two planes, of which four make a homography.
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

    /// Refined on all that counts, unless that makes it worse.
    fn refined(&self, h: Homography, score: f64, steps: usize) -> (Homography, f64) {
        let next = refined(&h, &self.near(&h), &self.noise, steps).and_then(|next| Some((next, self.score(&next, score)?)));
        next.unwrap_or((h, score))
    }
}

/// Levenberg's and Marquardt's method on the Sampson distances in both pictures, by the weights of the marginal likelihood.
fn refined(start: &Homography, pairs: &[PointPair], noise: &MarginalNoise, iterations: usize) -> Option<Homography> {
    let (from, to) = (normalising(pairs.iter().map(|p| p.from))?, normalising(pairs.iter().map(|p| p.to))?);
    let (from_inverse, to_inverse) = (from.try_inverse()?, to.try_inverse()?);
    let scaled = |by: &Matrix3<f64>, p: Vector2<f64>| (by * p.push(1.0)).xy();
    let mut errors = SampsonErrors {
        pairs: pairs.iter().map(|p| PointPair { from: scaled(&from, p.from), to: scaled(&to, p.to) }).collect(),
        pixel: [from[(0, 0)], to[(0, 0)]],
        noise,
    };
    let options = Options { iterations, damping: Damping { now: 1e-6, least: 1e-12, most: 1e3 }, least_gain: LEAST_GAIN_OF_PAIRS };
    let start = to * start.0 * from_inverse;
    let (h, _) = minimise(&mut errors, start / start.norm(), &options);
    let h = to_inverse * h * from;
    let front = pairs.iter().map(|p| (h * p.from.push(1.0)).z.signum()).sum::<f64>();
    let h = h * (front.signum() / h.norm());
    h.iter().all(|v| v.is_finite()).then_some(Homography(h))
}

/// Sampson distances, pixels, of pairs that are normalised.
struct SampsonErrors<'a> {
    pairs: Vec<PointPair>,
    /// Size of a pixel of the first and of the second picture.
    pixel: [f64; 2],
    noise: &'a MarginalNoise,
}

/// One pair's transfer error, its derivative by the entries of H (row by row), and the inverse of its covariance for noise of a pixel.
struct Row {
    error: Vector2<f64>,
    by_h: SMatrix<f64, 2, 9>,
    information: Matrix2<f64>,
}

impl SampsonErrors<'_> {
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
        let [first, second] = self.pixel.map(|pixel| pixel * pixel);
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
        self.pairs.iter().map(|p| self.row(h, p).map_or(1.0, |row| 1.0 - self.noise.agreement(Self::squared(&row)))).sum()
    }

    fn linearised(&self, h: &Matrix3<f64>) -> Self::Normal {
        let (mut normal, mut gradient) = (SMatrix::<f64, 9, 9>::zeros(), SVector::<f64, 9>::zeros());
        for row in self.pairs.iter().filter_map(|p| self.row(h, p)) {
            let weighted = row.information * self.noise.weight(Self::squared(&row));
            let transposed = row.by_h.transpose() * weighted;
            normal += transposed * row.by_h;
            gradient += transposed * row.error;
        }
        // The scale of H is free: pin it by a unit constraint along h itself.
        let along = SVector::<f64, 9>::from_iterator(h.transpose().iter().copied());
        let trace = normal.trace();
        (normal + along * along.transpose() * trace, gradient)
    }

    fn stepped(&self, h: &Matrix3<f64>, (normal, gradient): &Self::Normal, damping: f64) -> Option<Matrix3<f64>> {
        // The constraint adds the trace once: half of it is the data's.
        let share = damping * 0.5 * normal.trace() / 9.0;
        let damped = normal + SMatrix::<f64, 9, 9>::identity() * share;
        let next = h - Matrix3::from_row_slice(damped.cholesky()?.solve(gradient).as_slice());
        Some(next / next.norm())
    }
}

#[cfg(test)]
#[path = "marginal_homography_tests.rs"]
mod tests;
