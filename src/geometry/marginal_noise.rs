//! How much a distance speaks for a model where the standard deviation of the noise is not known:
//! its likelihood, marginalised over the deviation.
//!
//! After MAGSAC++ (Barath, Noskova, Ivashechkin and Matas, CVPR 2020, section 3): the deviation may
//! be anything up to a largest one, each as likely; a pair agrees with a deviation where its
//! distance is within the [`QUANTILE`] of that noise. The weight of a distance is the mean of its
//! density over the deviations that it agrees with. Distances here have two coordinates, so the
//! integrals are error functions.

use std::f64::consts::{PI, SQRT_2};

use super::noise::error_function;

/// Distance that 99 % of noise in two coordinates is within, standard deviations: the root of chi
/// square's 99 % point. Raised, wrong pairs count.
pub const QUANTILE: f64 = 3.034_854;
/// Steps of the table of agreements. Raised, it is more exact (now to 1e-5) and longer.
const STEPS: usize = 1024;

/// The kernel of distances up to a threshold.
#[derive(Debug, Clone, PartialEq)]
pub struct MarginalNoise {
    /// Largest standard deviation.
    most: f64,
    /// Square of the largest distance that counts.
    t2: f64,
    /// 1 less the loss, by the squared distance, from 0 to `t2`.
    agreements: Vec<f64>,
}

impl MarginalNoise {
    /// `threshold`: the largest distance that counts; the largest standard deviation is that over
    /// [`QUANTILE`].
    pub fn up_to(threshold: f64) -> Self {
        let whole = loss(QUANTILE);
        // One step more, which interpolation at the very end reads.
        let at = |k: usize| (1.0 - loss(QUANTILE * (k as f64 / STEPS as f64).sqrt().min(1.0)) / whole).max(0.0);
        Self { most: threshold / QUANTILE, t2: threshold * threshold, agreements: (0..=STEPS + 1).map(at).collect() }
    }

    /// How much a squared distance speaks for the model: 1 at none, 0 from the threshold on.
    pub fn agreement(&self, squared: f64) -> f64 {
        let place = squared / self.t2 * STEPS as f64;
        if place.is_nan() || place >= STEPS as f64 {
            return 0.0;
        }
        let (k, part) = (place as usize, place.fract());
        self.agreements[k] + (self.agreements[k + 1] - self.agreements[k]) * part
    }

    /// Twice the slope of the loss over the squared distance, up to a factor: 1 at no distance, 0
    /// from the threshold on.
    pub fn weight(&self, squared: f64) -> f64 {
        if squared.is_nan() || squared >= self.t2 {
            return 0.0;
        }
        weight(squared.sqrt() / self.most) / weight(0.0)
    }

    /// Square of the largest distance that counts.
    pub fn t2(&self) -> f64 {
        self.t2
    }
}

/// Mean density at a distance in largest deviations, without its factor.
fn weight(u: f64) -> f64 {
    error_function(QUANTILE / SQRT_2) - error_function(u / SQRT_2)
}

/// The integral of a distance times its weight.
fn loss(u: f64) -> f64 {
    0.5 * (u * u * weight(u) + error_function(u / SQRT_2) - u * (2.0 / PI).sqrt() * (-0.5 * u * u).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's integral, summed: over deviations from r / k to the largest, of the density of a
    /// distance in two coordinates with the factor r that its derivation drops.
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
    fn weights_are_the_slopes_of_losses() {
        let kernel = MarginalNoise::up_to(5.0);
        let slope = |squared: f64| (kernel.agreement(squared - 0.05) - kernel.agreement(squared + 0.05)) / 0.1;
        let one = kernel.weight(1.0) / slope(1.0);
        for squared in [0.3, 2.0, 9.0, 20.0] {
            assert!((kernel.weight(squared) - slope(squared) * one).abs() < 1e-3, "{squared}");
        }
    }

    #[test]
    fn what_is_far_or_no_number_counts_nothing() {
        let kernel = MarginalNoise::up_to(3.0);
        assert!((kernel.agreement(0.0) - 1.0).abs() < 1e-8 && (kernel.weight(0.0) - 1.0).abs() < 1e-8);
        for squared in [9.0, 9.1, 1e300, f64::INFINITY, f64::NAN] {
            assert_eq!((kernel.agreement(squared), kernel.weight(squared)), (0.0, 0.0), "{squared}");
        }
        assert!(kernel.agreement(9.0 - 1e-9) < 1e-6);
    }
}
