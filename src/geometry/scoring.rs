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
pub(super) const LANES: usize = 8;
/// Pairs as coordinates in the first picture (x, y) and in the second (u, v). The last block is
/// padded with NaN, which agrees with nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Block {
    pub x: [f64; LANES],
    pub y: [f64; LANES],
    pub u: [f64; LANES],
    pub v: [f64; LANES],
}

/// Pairs, laid out for scoring.
#[derive(Debug, Clone, PartialEq)]
pub struct Scorer {
    pub(super) blocks: Vec<Block>,
    count: usize,
    /// Squared threshold.
    pub(super) t2: f64,
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

    /// Returns the limit of score minus processed pairs below which the remaining pairs cannot lift
    /// the score above the bar.
    pub(super) fn hopeless(&self, bar: f64) -> f64 {
        // More than the rounding error of a sum of that many numbers up to 1.
        let rounding = 1e-9 * self.count as f64;
        bar - rounding - (self.blocks.len() * LANES) as f64
    }
}

pub(super) fn row_major(m: &Matrix3<f64>) -> [f64; 9] {
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

#[cfg(test)]
pub(super) mod tests {
    use nalgebra::Vector2;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::homography::PointPair;

    pub(in crate::geometry) fn pairs(n: usize, seed: u64) -> Vec<PointPair> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut at = || Vector2::new(random.random_range(0.0..640.0), random.random_range(0.0..480.0));
        (0..n).map(|_| PointPair { from: at(), to: at() }).collect()
    }

    fn plain_homography(h: &Homography, pairs: &[PointPair], t2: f64) -> f64 {
        pairs.iter().map(|p| (1.0 - h.squared_error(p) / t2).max(0.0)).sum()
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
    fn a_minimum_score_only_hides_lower_scores() {
        let (h, scorer) = (Homography(Matrix3::identity()), Scorer::new(&pairs(300, 5), 60.0));
        let free = scorer.homography(&h, f64::NEG_INFINITY).expect("above nothing");
        assert!(free > 1.0);
        for (below, above) in [(-1e-12, 1e-12), (-1e-6, 1e-6), (-0.5, 0.5), (-100.0, 100.0)] {
            assert_eq!(scorer.homography(&h, free * (1.0 + below)), Some(free));
            assert_eq!(scorer.homography(&h, free * (1.0 + above)), None);
        }
        assert_eq!(scorer.homography(&h, free), None);
    }
}
