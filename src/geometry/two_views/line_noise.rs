//! Noise of distances from a line, which have one noisy coordinate.

/// Probability that a distance from a line is below `u` standard deviations.
pub fn from_line(u: f64) -> f64 {
    error_function(u / std::f64::consts::SQRT_2)
}

/// The error function for x >= 0, accurate to 1.5e-7 (Abramowitz and Stegun, 7.1.26).
pub(super) fn error_function(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let series = t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    1.0 - series * (-x * x).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::noise::of_inliers;
    use crate::geometry::noise::tests::assert_noise_is_found_despite_any_truncation;

    #[test]
    fn noise_of_lines_is_estimated_despite_any_truncation() {
        assert_noise_is_found_despite_any_truncation(from_line, |[x, _]| x * x);
    }

    #[test]
    fn uniform_residuals_report_noise_at_the_threshold() {
        let mut even: Vec<f64> = (0..1000).map(|k| (f64::from(k) / 1000.0 * 3.0).powi(2)).collect();
        assert_eq!(of_inliers(&mut even, 3.0, from_line), 3.0);
        assert_eq!(of_inliers(&mut [], 3.0, from_line), 0.0);
    }
}
