//! Scores an epipolar relation over all pairs, as `scoring` does a homography.

use nalgebra::Matrix3;

use crate::geometry::scoring::{Block, LANES, Scorer, row_major};
use crate::simd::multiversion;

/// Blocks between two checks against the bar. Raised, hopeless models are scored longer; lowered,
/// summing the lanes costs more than it saves.
const BLOCKS_BETWEEN_LOOKS: usize = 4;

impl Scorer {
    /// Scores a fundamental matrix by Sampson distances; `None` if not above `bar`.
    pub fn epipolar(&self, f: &Matrix3<f64>, bar: f64) -> Option<f64> {
        let score = epipolar_score(&row_major(f), &self.blocks, self.t2, self.hopeless(bar));
        Some(score).filter(|score| *score > bar)
    }
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
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::geometry::distances::squared_sampson;
    use crate::geometry::scoring::tests::pairs;
    use crate::geometry::{PointPair, skew};

    fn plain_epipolar(f: &Matrix3<f64>, pairs: &[PointPair], t2: f64) -> f64 {
        pairs.iter().map(|p| (1.0 - squared_sampson(f, p) / t2).max(0.0)).sum()
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
        let (f, scorer) = (skew(&Vector3::new(1.0, 0.3, 1e-3)), Scorer::new(&pairs(300, 5), 60.0));
        let free = scorer.epipolar(&f, f64::NEG_INFINITY).expect("above nothing");
        assert!(free > 1.0);
        for (below, above) in [(-1e-12, 1e-12), (-1e-6, 1e-6), (-0.5, 0.5), (-100.0, 100.0)] {
            assert_eq!(scorer.epipolar(&f, free * (1.0 + below)), Some(free));
            assert_eq!(scorer.epipolar(&f, free * (1.0 + above)), None);
        }
    }
}
