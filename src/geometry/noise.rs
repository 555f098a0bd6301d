//! Noise of inliers, from distances truncated by a threshold.

/// Estimates the standard deviation σ of one coordinate from squared distances below a threshold's
/// square. `within` is the probability that a distance is below a number of standard deviations:
/// [`between_points`], or for distances from lines `two_views::line_noise::from_line`.
///
/// Solves for the σ whose noise, truncated at the threshold, has the distances' median; so neither
/// the truncation nor up to half of wrong pairs biases it much. If the distances fill the range up
/// to the threshold evenly, the noise cannot be determined and the threshold is returned. Returns 0
/// for no distances.
pub fn of_inliers(squared: &mut [f64], threshold: f64, within: Within) -> f64 {
    let Some(median) = super::robust_kernel::median(squared).map(f64::sqrt) else { return 0.0 };
    let share = |sigma: f64| within(median / sigma) / within(threshold / sigma);
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

/// Probability that a distance is below this many standard deviations.
pub type Within = fn(f64) -> f64;

/// Returns that of a distance between two points, which has two noisy coordinates.
pub fn between_points(u: f64) -> f64 {
    -(-0.5 * u * u).exp_m1()
}

#[cfg(test)]
pub(super) mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Two independent normal numbers (Box and Muller).
    fn normal(random: &mut Pcg64Mcg) -> [f64; 2] {
        let r = (-2.0 * (1.0 - random.random_range(0.0..1.0_f64)).ln()).sqrt();
        let angle = random.random_range(0.0..std::f64::consts::TAU);
        [r * angle.cos(), r * angle.sin()]
    }

    /// Checks that the noise of truncated squared distances is found; `squared` computes them from
    /// two coordinates.
    pub fn assert_noise_is_found_despite_any_truncation(within: Within, squared: fn([f64; 2]) -> f64) {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        for sigma in [0.1, 0.7, 2.0] {
            for threshold in [3.0, 4.0, 30.0] {
                let draws = (0..40_000).map(|_| squared(normal(&mut random).map(|v| v * sigma)));
                let mut distances: Vec<f64> = draws.filter(|d| *d < threshold * threshold).collect();
                let found = of_inliers(&mut distances, threshold, within);
                assert!((found / sigma - 1.0).abs() < 0.05, "{sigma} cut at {threshold}: {found}");
            }
        }
    }

    #[test]
    fn noise_of_points_is_estimated_despite_any_truncation() {
        assert_noise_is_found_despite_any_truncation(between_points, |[x, y]| x * x + y * y);
    }

    #[test]
    fn residuals_that_are_no_number_report_noise_at_the_threshold() {
        assert_eq!(of_inliers(&mut [f64::NAN], 3.0, between_points), 3.0);
        assert_eq!(of_inliers(&mut [], 3.0, between_points), 0.0);
        assert!(of_inliers(&mut [0.0; 9], 3.0, between_points) <= 1e-12);
    }
}
