//! Refinement of a two-view motion on Sampson distances in pixels, by exact derivatives.

use nalgebra::{Matrix3, SVector};

use super::sampson_refinement::{Relation, SampsonFit};
use crate::geometry::motion_refinement::{derivatives, moved};
use crate::geometry::relative_pose::{RayPair, TwoViewMotion};

/// Refines a motion on Sampson distances in pixels of two pictures with these focal lengths (first,
/// second), by exact derivatives. Pairs beyond three `sigma` (pixels) lose weight.
pub fn refine_motion_in_pixels(start: &TwoViewMotion, pairs: &[RayPair], focals: [f64; 2], sigma: f64, iterations: usize) -> TwoViewMotion {
    let fit = SampsonFit {
        pairs: pairs.iter().map(|p| [p.first.push(1.0), p.second.push(1.0)]).collect(),
        pixel: focals.map(|focal| 1.0 / focal),
        sigma,
    };
    fit.refined(*start, iterations)
}

impl Relation<5> for TwoViewMotion {
    fn matrix(&self) -> Matrix3<f64> {
        self.essential()
    }

    fn stepped(&self, step: &SVector<f64, 5>) -> Self {
        moved(self, step)
    }

    fn derivatives(&self) -> [Matrix3<f64>; 5] {
        derivatives(self)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Vector2, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::distances::squared_sampson;
    use crate::geometry::test_views::{scene, truth};
    use crate::geometry::two_views::sampson_refinement::tests::derivatives_agree_with_differences;

    #[test]
    fn exact_derivatives_agree_with_differences() {
        let fit = SampsonFit {
            pairs: scene(30, 0.003, false, 3).iter().map(|p| [p.first.push(1.0), p.second.push(1.0)]).collect(),
            pixel: [1.0 / 700.0, 1.0 / 1100.0],
            sigma: 1.0,
        };
        for motion in [truth(), moved(&truth(), &SVector::from_fn(|k, _| 0.1 * (k as f64 - 2.0)))] {
            derivatives_agree_with_differences(&motion, &fit);
        }
    }

    #[test]
    fn distances_are_counted_in_the_pixels_of_each_picture() {
        // The second picture is ten times as coarse: one pixel of noise is ten times the first's in
        // rays.
        let (mut random, focals) = (Pcg64Mcg::seed_from_u64(4), [1000.0, 100.0]);
        let mut pairs = scene(80, 0.0, false, 4);
        for p in &mut pairs {
            let mut noise = || Vector2::new(random.random_range(-1.0..1.0), random.random_range(-1.0..1.0));
            (p.first, p.second) = (p.first + noise() / focals[0], p.second + noise() / focals[1]);
        }
        let squares = |m: &TwoViewMotion| {
            let [first, second] = focals.map(|f| Matrix3::from_diagonal(&Vector3::new(1.0 / f, 1.0 / f, 1.0)));
            let f = second * m.essential() * first;
            let pixels = pairs.iter().map(|p| RayPair { first: p.first * focals[0], second: p.second * focals[1] });
            pixels.map(|p| squared_sampson(&f, &p)).sum::<f64>()
        };
        let [right, wrong] = [focals, [1000.0, 1000.0]].map(|f| squares(&refine_motion_in_pixels(&truth(), &pairs, f, 1e3, 50)));
        // 80 pairs with five fitted parameters; uniform noise over ±1 has a variance of a third.
        assert!(right < wrong - 1e-6 && (15.0..40.0).contains(&right), "{right} {wrong}");
    }
}
