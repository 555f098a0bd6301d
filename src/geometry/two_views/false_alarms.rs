//! Expected number of equally good models by chance, which separates unrelated pictures from
//! related ones.
//!
//! A contrario (Moisan and Stival, "A probabilistic criterion to detect rigid point matches between
//! two images", IJCV 2004): if all n pairs were wrong, a pair would agree with a sample's model
//! with some chance p; all samples of s pairs and all k agreeing pairs count as trials. Their
//! formula (11): ln NFA = ln m (n - s) + ln C(n, k) + ln C(k, s) + (k - s) ln p.

/// Computes the natural logarithm of the expected number of models with at least `inliers` of
/// `pairs` agreeing if all pairs were wrong. Below 0, chance gives less than one; below -5 a
/// relation is certain.
///
/// `sample` pairs give up to `models` models. `chance` is a wrong pair's chance to agree:
/// [`chance_at_a_point`] or [`chance_at_a_line`].
pub fn ln_false_alarms(pairs: usize, inliers: usize, sample: usize, models: usize, chance: f64) -> f64 {
    if inliers <= sample || pairs < inliers {
        return f64::INFINITY;
    }
    let tries = (models as f64 * (pairs - sample) as f64).ln();
    tries + ln_choices(pairs, inliers) + ln_choices(inliers, sample) + (inliers - sample) as f64 * chance.clamp(1e-12, 1.0).ln()
}

/// Returns the chance that a wrong point in a picture of this size is within `threshold` pixels of
/// a given point.
pub fn chance_at_a_point([width, height]: [u32; 2], threshold: f64) -> f64 {
    (std::f64::consts::PI * threshold * threshold / (f64::from(width) * f64::from(height))).min(1.0)
}

/// Returns the chance that a wrong point in a picture of this size is within `threshold` pixels of
/// a line through it; uses the longest line, the diagonal.
pub fn chance_at_a_line([width, height]: [u32; 2], threshold: f64) -> f64 {
    let (width, height) = (f64::from(width), f64::from(height));
    (2.0 * threshold * width.hypot(height) / (width * height)).min(1.0)
}

/// Computes ln of the binomial coefficient n over k.
fn ln_choices(n: usize, k: usize) -> f64 {
    let k = k.min(n - k);
    (0..k).map(|i| ((n - i) as f64 / (k - i) as f64).ln()).sum()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::homography::PointPair;
    use crate::geometry::robust::RobustOptions;
    use crate::geometry::robust_homography::robust_homography;
    use crate::geometry::two_views::robust_fundamental::robust_fundamental;
    use crate::geometry::{test_planes, test_views};

    #[test]
    fn log_binomials_are_right_and_false_alarms_fall() {
        assert!(
            (ln_choices(10, 3) - 120.0_f64.ln()).abs() < 1e-12
                && ln_choices(7, 7) == 0.0
                && (ln_choices(5, 4) - 5.0_f64.ln()).abs() < 1e-12
        );
        assert_eq!(ln_false_alarms(100, 4, 4, 1, 0.001), f64::INFINITY);
        assert!(ln_false_alarms(100, 20, 4, 1, 0.001) < ln_false_alarms(100, 10, 4, 1, 0.001));
    }

    #[test]
    fn chance_agreement_is_distinguished_from_real_structure() {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        let size = [800, 600];
        let (at_a_point, at_a_line) = (chance_at_a_point(size, 3.0), chance_at_a_line(size, 3.0));
        let wrong = |random: &mut Pcg64Mcg| {
            let mut at = || Vector2::new(random.random_range(0.0..800.0), random.random_range(0.0..600.0));
            PointPair { from: at(), to: at() }
        };
        for (seed, n) in [30, 100, 300].into_iter().enumerate() {
            let options = RobustOptions { max_samples: 10_000, seed: seed as u64, ..RobustOptions::default() };
            let none: Vec<PointPair> = (0..n).map(|_| wrong(&mut random)).collect();
            let plane = |pairs: &[PointPair]| robust_homography(pairs, &options).map_or(0, |m| m.inliers.len());
            let lines = |pairs: &[PointPair]| robust_fundamental(pairs, &options).map_or(0, |m| m.inliers.len());
            assert!(ln_false_alarms(n, plane(&none), 4, 1, at_a_point) > 0.0, "{n}: {}", plane(&none));
            assert!(ln_false_alarms(n, lines(&none), 7, 3, at_a_line) > 0.0, "{n}: {}", lines(&none));
            let some = |true_ones: Vec<PointPair>| [true_ones, none.clone()].concat();
            let (flat, deep) = (some(test_planes::pairs(40, 0.5)), some(test_views::pixels(&test_views::scene(150, 0.001, false, 2))));
            assert!(ln_false_alarms(flat.len(), plane(&flat), 4, 1, at_a_point) < -5.0, "{n}");
            assert!(ln_false_alarms(deep.len(), lines(&deep), 7, 3, at_a_line) < -5.0, "{n}");
        }
    }
}
