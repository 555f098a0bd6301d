//! How strongly a distance supports a model if the noise's standard deviation is unknown: the
//! likelihood, marginalised over the deviation.
//!
//! After MAGSAC++ (Barath, Noskova, Ivashechkin and Matas, CVPR 2020, section 3): all deviations up
//! to a maximum are equally likely. A pair agrees with a deviation if its distance is within the
//! [`QUANTILE`] of that noise. The weight of a distance is the mean of its density over the
//! deviations it agrees with. Distances here have two coordinates, so the integrals are error
//! functions.

use std::f64::consts::{PI, SQRT_2};

use super::line_noise::error_function;

/// Distance, in standard deviations, that 99 % of two-dimensional noise stays within: the root of
/// chi square's 99 % point. Raised, wrong pairs gain weight.
pub const QUANTILE: f64 = 3.034_854;
/// Number of steps in the table of agreements. Raised, it is more accurate (now 1e-5) and larger.
const STEPS: usize = 1024;

/// The kernel for distances up to a threshold.
#[derive(Debug, Clone, PartialEq)]
pub struct MarginalNoise {
    /// Maximum standard deviation.
    most: f64,
    /// Square of the maximum distance with weight.
    t2: f64,
    /// 1 minus the normalised loss, tabulated by squared distance from 0 to `t2`.
    agreements: Vec<f64>,
}

impl MarginalNoise {
    /// Creates the kernel. `threshold`: maximum distance with weight; the maximum standard
    /// deviation is that divided by [`QUANTILE`].
    pub fn up_to(threshold: f64) -> Self {
        let whole = loss(QUANTILE);
        // One extra entry, which interpolation at the very end reads.
        let at = |k: usize| (1.0 - loss(QUANTILE * (k as f64 / STEPS as f64).sqrt().min(1.0)) / whole).max(0.0);
        Self { most: threshold / QUANTILE, t2: threshold * threshold, agreements: (0..=STEPS + 1).map(at).collect() }
    }

    /// Returns how strongly a squared distance supports the model: 1 at zero, 0 from the threshold
    /// on.
    pub fn agreement(&self, squared: f64) -> f64 {
        let place = squared / self.t2 * STEPS as f64;
        if place.is_nan() || place >= STEPS as f64 {
            return 0.0;
        }
        let (k, part) = (place as usize, place.fract());
        self.agreements[k] + (self.agreements[k + 1] - self.agreements[k]) * part
    }

    /// Returns the weight, proportional to the derivative of the loss by the squared distance: 1 at
    /// zero distance, 0 from the threshold on.
    pub fn weight(&self, squared: f64) -> f64 {
        if squared.is_nan() || squared >= self.t2 {
            return 0.0;
        }
        weight(squared.sqrt() / self.most) / weight(0.0)
    }

    /// Returns the square of the maximum distance with weight.
    pub fn t2(&self) -> f64 {
        self.t2
    }
}

/// Mean density at a distance in units of the maximum deviation, without its constant factor.
fn weight(u: f64) -> f64 {
    error_function(QUANTILE / SQRT_2) - error_function(u / SQRT_2)
}

/// Integral of distance times weight.
fn loss(u: f64) -> f64 {
    0.5 * (u * u * weight(u) + error_function(u / SQRT_2) - u * (2.0 / PI).sqrt() * (-0.5 * u * u).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's integral, summed numerically: over deviations from r / k to the maximum, of the
    /// density of a two-dimensional distance with the factor r that its derivation drops.
    #[test]
    fn weights_are_the_mean_of_the_densities() {
        let kernel = MarginalNoise::up_to(QUANTILE * 2.0);
        let summed = |r: f64| {
            const N: usize = 200_000;
            let from = r / QUANTILE;
            let width = (2.0 - from) / N as f64;
            (0..N).map(|k| from + (k as f64 + 0.5) * width).map(|s| r / (s * s) * (-0.5 * (r / s).powi(2)).exp() * width).sum::<f64>()
        };
        let one = kernel.weight(1.0) / summed(1.0);
        for r in [0.1, 0.5, 2.0, 4.0, 5.9] {
            assert!((kernel.weight(r * r) / summed(r) / one - 1.0).abs() < 1e-3, "{r}: {} {}", kernel.weight(r * r), summed(r));
        }
    }

    #[test]
    fn kernel_weights_are_the_derivatives_of_the_loss() {
        let kernel = MarginalNoise::up_to(5.0);
        let slope = |squared: f64| (kernel.agreement(squared - 0.05) - kernel.agreement(squared + 0.05)) / 0.1;
        let one = kernel.weight(1.0) / slope(1.0);
        for squared in [0.3, 2.0, 9.0, 20.0] {
            assert!((kernel.weight(squared) - slope(squared) * one).abs() < 1e-3, "{squared}");
        }
    }

    #[test]
    fn far_or_invalid_residuals_have_zero_weight() {
        let kernel = MarginalNoise::up_to(3.0);
        assert!((kernel.agreement(0.0) - 1.0).abs() < 1e-8 && (kernel.weight(0.0) - 1.0).abs() < 1e-8);
        for squared in [9.0, 9.1, 1e300, f64::INFINITY, f64::NAN] {
            assert_eq!((kernel.agreement(squared), kernel.weight(squared)), (0.0, 0.0), "{squared}");
        }
        assert!(kernel.agreement(9.0 - 1e-9) < 1e-6);
    }
}
