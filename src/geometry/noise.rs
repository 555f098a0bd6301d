//! Noise of inliers, from distances truncated by a threshold.

/// Estimates the standard deviation σ of one coordinate from squared distances below a threshold's
/// square. A distance has `dimensions` coordinates: 1 from an epipolar line, 2 from a transferred
/// point.
///
/// Solves for the σ whose noise, truncated at the threshold, has the distances' median; so neither
/// the truncation nor up to half of wrong pairs biases it much. If the distances fill the range up
/// to the threshold evenly, the noise cannot be determined and the threshold is returned. Returns 0
/// for no distances.
pub fn of_inliers(squared: &mut [f64], threshold: f64, dimensions: Dimensions) -> f64 {
    let Some(median) = super::robust_kernel::median(squared).map(f64::sqrt) else { return 0.0 };
    let share = |sigma: f64| dimensions.within(median / sigma) / dimensions.within(threshold / sigma);
    // The fraction of truncated noise below the median falls as σ grows.
    if median.is_nan() || median >= threshold || share(threshold) >= 0.5 {
        return threshold;
    }
    let (mut low, mut high) = (median * 0.1, threshold);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if share(middle) > 0.5 {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// Number of noisy coordinates in a distance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dimensions {
    /// Point to line.
    One,
    /// Point to point.
    Two,
}

impl Dimensions {
    /// Probability that a distance is below `u` standard deviations.
    fn within(self, u: f64) -> f64 {
        match self {
            Self::One => error_function(u / std::f64::consts::SQRT_2),
            Self::Two => -(-0.5 * u * u).exp_m1(),
        }
    }
}

/// The error function for x >= 0, accurate to 1.5e-7 (Abramowitz and Stegun, 7.1.26).
pub(super) fn error_function(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let series = t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    1.0 - series * (-x * x).exp()
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Two independent normal numbers (Box and Muller).
    fn normal(random: &mut Pcg64Mcg) -> [f64; 2] {
        let r = (-2.0 * (1.0 - random.random_range(0.0..1.0_f64)).ln()).sqrt();
        let angle = random.random_range(0.0..std::f64::consts::TAU);
        [r * angle.cos(), r * angle.sin()]
    }

    #[test]
    fn noise_is_estimated_despite_any_truncation() {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        for sigma in [0.1, 0.7, 2.0] {
            for threshold in [3.0, 4.0, 30.0] {
                let draws: Vec<[f64; 2]> = (0..40_000).map(|_| normal(&mut random).map(|v| v * sigma)).collect();
                let cut = |d: f64| Some(d).filter(|d| *d < threshold * threshold);
                let mut one: Vec<f64> = draws.iter().filter_map(|[x, _]| cut(x * x)).collect();
                let mut two: Vec<f64> = draws.iter().filter_map(|[x, y]| cut(x * x + y * y)).collect();
                for found in [of_inliers(&mut one, threshold, Dimensions::One), of_inliers(&mut two, threshold, Dimensions::Two)] {
                    assert!((found / sigma - 1.0).abs() < 0.05, "{sigma} cut at {threshold}: {found}");
                }
            }
        }
    }

    #[test]
    fn uniform_residuals_report_noise_at_the_threshold() {
        let mut even: Vec<f64> = (0..1000).map(|k| (f64::from(k) / 1000.0 * 3.0).powi(2)).collect();
        assert_eq!(of_inliers(&mut even, 3.0, Dimensions::One), 3.0);
        assert_eq!(of_inliers(&mut [], 3.0, Dimensions::One), 0.0);
        assert_eq!(of_inliers(&mut [f64::NAN], 3.0, Dimensions::Two), 3.0);
        assert!(of_inliers(&mut [0.0; 9], 3.0, Dimensions::Two) <= 1e-12);
    }
}
