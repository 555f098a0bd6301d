//! Robust kernels, which reduce a residual's cost and weight so that outliers do not pull (Zhang
//! 1997, table 1); and the median, which tolerates up to half of arbitrary values.
//!
//! Residuals are squared and whitened: in units of their noise variance.

/// Tukey's biweight: residuals beyond this many sigmas have no weight. At 4.685, here rounded, it
/// is 95 % as efficient as least squares under normal noise. Raised, outliers pull more; lowered,
/// good residuals are lost.
pub const TUKEY: f64 = 4.7;

/// Returns Tukey's weight of a squared residual (in sigmas of `scale`).
pub fn tukey_weight(squared: f64, scale: f64) -> f64 {
    let u = squared / (TUKEY * scale).powi(2);
    if u < 1.0 { (1.0 - u).powi(2) } else { 0.0 }
}

/// Returns Tukey's cost of a squared residual; `None` costs as much as an outlier.
pub fn tukey_cost(squared: Option<f64>, scale: f64) -> f64 {
    let c2 = (TUKEY * scale).powi(2);
    match squared {
        Some(s) if s < c2 => c2 / 6.0 * (1.0 - (1.0 - s / c2).powi(3)),
        _ => c2 / 6.0,
    }
}

/// Returns the Geman-McClure cost, which approaches 1; one half at `c2`.
pub fn geman_mcclure_cost(squared: f64, c2: f64) -> f64 {
    squared / (squared + c2)
}

/// Returns the Geman-McClure weight, 1 at a zero residual.
pub fn geman_mcclure_weight(squared: f64, c2: f64) -> f64 {
    (c2 / (squared + c2)).powi(2)
}

/// Returns the median, or `None` for no values; reorders in place.
pub fn median(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let (_, median, _) = values.select_nth_unstable_by(values.len() / 2, f64::total_cmp);
    Some(*median)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A weight is twice the derivative of the cost by the squared residual, up to a common factor.
    #[test]
    fn weights_are_the_derivatives_of_the_costs() {
        const STEP: f64 = 1e-6;
        for squared in [0.01, 0.5, 2.0, 7.0, 20.0, 21.9] {
            let slope = (tukey_cost(Some(squared + STEP), 1.0) - tukey_cost(Some(squared - STEP), 1.0)) / (2.0 * STEP);
            assert!((2.0 * slope - tukey_weight(squared, 1.0)).abs() < 1e-6, "{squared}");
            let slope = (geman_mcclure_cost(squared + STEP, 9.0) - geman_mcclure_cost(squared - STEP, 9.0)) / (2.0 * STEP);
            assert!((9.0 * slope - geman_mcclure_weight(squared, 9.0)).abs() < 1e-6, "{squared}");
        }
        assert_eq!((tukey_weight(30.0, 1.0), tukey_cost(Some(30.0), 1.0)), (0.0, tukey_cost(None, 1.0)));
    }
}
