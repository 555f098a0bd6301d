//! Scores a relation over all pairs: truncated squares (MSAC, Torr and Zisserman, CVIU 2000), eight
//! pairs at a time.
//!
//! The score is the sum of 1 - d²/t² over the pairs within the threshold t. Scoring stops once the
//! remaining pairs cannot lift the score above the bar; this changes no result.

use nalgebra::Matrix3;

use super::correspondence::Correspondence;
use super::homography::Homography;
use crate::simd::multiversion;

/// Pairs scored together: one, two or four registers of doubles, depending on the processor.
const LANES: usize = 8;
/// Blocks between two checks against the bar. Raised, hopeless models are scored longer; lowered,
/// summing the lanes costs more than it saves.
const BLOCKS_BETWEEN_LOOKS: usize = 4;

/// Pairs as coordinates in the first picture (x, y) and in the second (u, v). The last block is
/// padded with NaN, which agrees with nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Block {
    x: [f64; LANES],
    y: [f64; LANES],
    u: [f64; LANES],
    v: [f64; LANES],
}

/// Pairs, laid out for scoring.
#[derive(Debug, Clone, PartialEq)]
pub struct Scorer {
    blocks: Vec<Block>,
    count: usize,
    /// Squared threshold.
    t2: f64,
}

impl Scorer {
    /// Lays out the pairs. `threshold`: distance from which a pair no longer agrees, in the pairs'
    /// units.
    pub fn new<C: Correspondence>(pairs: &[C], threshold: f64) -> Self {
        let block = |pairs: &[C]| {
            let of = |coordinate: fn(&C) -> f64| std::array::from_fn(|k| pairs.get(k).map_or(f64::NAN, coordinate));
            Block { x: of(|p| p.first().x), y: of(|p| p.first().y), u: of(|p| p.second().x), v: of(|p| p.second().y) }
        };
        Self { blocks: pairs.chunks(LANES).map(block).collect(), count: pairs.len(), t2: threshold * threshold }
    }

    /// Scores a homography by transfer errors in the second picture; `None` if not above `bar`.
    pub fn homography(&self, h: &Homography, bar: f64) -> Option<f64> {
        let score = homography_score(&row_major(&h.0), &self.blocks, self.t2, self.hopeless(bar));
        Some(score).filter(|score| *score > bar)
    }

    /// Scores a fundamental matrix by Sampson distances; `None` if not above `bar`.
    pub fn epipolar(&self, f: &Matrix3<f64>, bar: f64) -> Option<f64> {
        let score = epipolar_score(&row_major(f), &self.blocks, self.t2, self.hopeless(bar));
        Some(score).filter(|score| *score > bar)
    }

    /// Returns the limit of score minus processed pairs below which the remaining pairs cannot lift
    /// the score above the bar.
    fn hopeless(&self, bar: f64) -> f64 {
        // More than the rounding error of a sum of that many numbers up to 1.
        let rounding = 1e-9 * self.count as f64;
        bar - rounding - (self.blocks.len() * LANES) as f64
    }
}

fn row_major(m: &Matrix3<f64>) -> [f64; 9] {
    std::array::from_fn(|k| m[(k / 3, k % 3)])
}

multiversion! {
    /// Returns the score, or negative infinity once score minus processed pairs is below
    /// `hopeless`.
    fn homography_score(h: &[f64; 9], blocks: &[Block], t2: f64, hopeless: f64) -> f64;
    ["avx2"] => homography_score_lanes, else homography_score_lanes
}

/// Divides only for pairs that are close by a division-free test, in order and as
/// [`Homography::squared_error`] does, so that the sum is bit-identical to that over all pairs one
/// by one.
#[inline(always)]
fn homography_score_lanes(h: &[f64; 9], blocks: &[Block], t2: f64, hopeless: f64) -> f64 {
    // The tolerance exceeds the rounding difference between the two forms, for coordinates up to a
    // million thresholds.
    let reach = t2 * (1.0 + 1e-9);
    let (mut score, mut done) = (0.0, 0.0);
    for block in blocks {
        let mut is_near = [0_u64; LANES];
        for (k, is_near) in is_near.iter_mut().enumerate() {
            let (x, y) = (block.x[k], block.y[k]);
            let w = h[6] * x + h[7] * y + h[8];
            let dx = h[0] * x + h[1] * y + h[2] - block.u[k] * w;
            let dy = h[3] * x + h[4] * y + h[5] - block.v[k] * w;
            *is_near = u64::from((dx * dx + dy * dy < reach * (w * w)) & (w > 1e-12));
        }
        if is_near.iter().sum::<u64>() > 0 {
            for k in (0..LANES).filter(|&k| is_near[k] > 0) {
                let (x, y) = (block.x[k], block.y[k]);
                let w = h[6] * x + h[7] * y + h[8];
                let dx = (h[0] * x + h[1] * y + h[2]) / w - block.u[k];
                let dy = (h[3] * x + h[4] * y + h[5]) / w - block.v[k];
                score += (1.0 - (dx * dx + dy * dy) / t2).max(0.0);
            }
        }
        done += LANES as f64;
        if score - done < hopeless {
            return f64::NEG_INFINITY;
        }
    }
    score
}

multiversion! {
    /// Returns the score, or negative infinity once it falls behind, as above.
    fn epipolar_score(f: &[f64; 9], blocks: &[Block], t2: f64, hopeless: f64) -> f64;
    ["avx2"] => epipolar_score_lanes, else epipolar_score_lanes
}

#[inline(always)]
fn epipolar_score_lanes(f: &[f64; 9], blocks: &[Block], t2: f64, hopeless: f64) -> f64 {
    let mut sums = [0.0; LANES];
    let mut done = 0.0;
    for some in blocks.chunks(BLOCKS_BETWEEN_LOOKS) {
        for block in some {
            for (k, sum) in sums.iter_mut().enumerate() {
                let (x, y, u, v) = (block.x[k], block.y[k], block.u[k], block.v[k]);
                let (lx, ly, lz) = (f[0] * x + f[1] * y + f[2], f[3] * x + f[4] * y + f[5], f[6] * x + f[7] * y + f[8]);
                let (mx, my) = (f[0] * u + f[3] * v + f[6], f[1] * u + f[4] * v + f[7]);
                let c = u * lx + v * ly + lz;
                let agreement = 1.0 - c * c / ((lx * lx + ly * ly + mx * mx + my * my) * t2);
                // Written so that NaN (padding) counts nothing.
                *sum += if agreement > 0.0 { agreement } else { 0.0 };
            }
        }
        done += (LANES * some.len()) as f64;
        if sums.iter().sum::<f64>() - done < hopeless {
            return f64::NEG_INFINITY;
        }
    }
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector2, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::distances::squared_sampson;
    use crate::geometry::homography::PointPair;
    use crate::geometry::skew;

    fn pairs(n: usize, seed: u64) -> Vec<PointPair> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut at = || Vector2::new(random.random_range(0.0..640.0), random.random_range(0.0..480.0));
        (0..n).map(|_| PointPair { from: at(), to: at() }).collect()
    }

    fn plain_homography(h: &Homography, pairs: &[PointPair], t2: f64) -> f64 {
        pairs.iter().map(|p| (1.0 - h.squared_error(p) / t2).max(0.0)).sum()
    }

    fn plain_epipolar(f: &Matrix3<f64>, pairs: &[PointPair], t2: f64) -> f64 {
        pairs.iter().map(|p| (1.0 - squared_sampson(f, p) / t2).max(0.0)).sum()
    }

    #[test]
    fn simd_homography_scores_equal_scalar_scores_bit_for_bit() {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        for n in [0, 1, 7, 8, 9, 100, 403] {
            for trial in 0..50 {
                let mut all = pairs(n, trial);
                let m = Matrix3::from_fn(|r, c| {
                    random.random_range(-1.0..1.0) * [[1.0, 1.0, 300.0], [1.0, 1.0, 300.0], [1e-3, 1e-3, 1.0]][r][c]
                });
                let h = Homography(m / m.norm());
                for p in all.iter_mut().step_by(3) {
                    p.to = h.map(p.from).unwrap_or(p.to) + Vector2::new(random.random_range(-4.0..4.0), random.random_range(-4.0..4.0));
                }
                let expected = plain_homography(&h, &all, 9.0);
                let found = Scorer::new(&all, 3.0).homography(&h, f64::NEG_INFINITY).expect("above nothing");
                assert_eq!(found + 0.0, expected + 0.0, "{n} {trial}");
            }
        }
    }

    #[test]
    fn simd_epipolar_scores_equal_scalar_scores() {
        let r = UnitQuaternion::from_euler_angles(0.1, -0.2, 0.05).to_rotation_matrix().into_inner();
        let k = Matrix3::new(1.0 / 500.0, 0.0, -0.6, 0.0, 1.0 / 500.0, -0.5, 0.0, 0.0, 1.0);
        for (trial, n) in [0, 1, 8, 37, 400].into_iter().enumerate() {
            let f = k.transpose() * skew(&Vector3::new(1.0, 0.1 * trial as f64, 0.2)) * r * k;
            let all = pairs(n, trial as u64);
            let expected = plain_epipolar(&f, &all, 400.0);
            let found = Scorer::new(&all, 20.0).epipolar(&f, f64::NEG_INFINITY).expect("above nothing");
            assert!((found - expected).abs() < 1e-9 * (1.0 + expected) && (n < 400 || expected > 5.0), "{n} {found} {expected}");
        }
    }

    #[test]
    fn a_minimum_score_only_hides_lower_scores() {
        let all = pairs(300, 5);
        let h = Homography(Matrix3::identity());
        let f = skew(&Vector3::new(1.0, 0.3, 1e-3));
        let scorer = Scorer::new(&all, 60.0);
        let free = [scorer.homography(&h, f64::NEG_INFINITY), scorer.epipolar(&f, f64::NEG_INFINITY)].map(|s| s.expect("above nothing"));
        assert!(free.iter().all(|s| *s > 1.0));
        for (below, above) in [(-1e-12, 1e-12), (-1e-6, 1e-6), (-0.5, 0.5), (-100.0, 100.0)] {
            assert_eq!(scorer.homography(&h, free[0] * (1.0 + below)), Some(free[0]));
            assert_eq!(scorer.epipolar(&f, free[1] * (1.0 + below)), Some(free[1]));
            assert_eq!(scorer.homography(&h, free[0] * (1.0 + above)), None);
            assert_eq!(scorer.epipolar(&f, free[1] * (1.0 + above)), None);
        }
        assert_eq!(scorer.homography(&h, free[0]), None);
    }
}
