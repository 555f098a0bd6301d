//! Refinement of a fundamental matrix on Sampson distances: seven degrees of freedom, rank two by
//! construction.
//!
//! F = U diag(cos φ, sin φ, 0) Vᵀ with orthonormal U and V. A step rotates U and V by three angles
//! each and changes φ (Bartoli and Sturm, "Nonlinear estimation of the fundamental matrix with
//! minimal parameters", PAMI 2004).

use nalgebra::{Matrix3, Rotation3, SVector, Vector3};

use super::sampson_refinement::{Relation, SampsonFit};
use crate::geometry::correspondence::Correspondence;
use crate::geometry::normalisation::normalising;
use crate::geometry::pose::skew;

/// Refines F on the Sampson distances of pairs in pixels, down-weighted beyond three `sigma`
/// (pixels). `None` if all points coincide or `start` is not a fundamental matrix.
pub fn refine_fundamental<C: Correspondence>(start: &Matrix3<f64>, pairs: &[C], sigma: f64, iterations: usize) -> Option<Matrix3<f64>> {
    let first = normalising(pairs.iter().map(Correspondence::first))?;
    let second = normalising(pairs.iter().map(Correspondence::second))?;
    let fit = SampsonFit {
        pairs: pairs.iter().map(|p| [first * p.first().push(1.0), second * p.second().push(1.0)]).collect(),
        pixel: [first[(0, 0)], second[(0, 0)]],
        sigma,
    };
    let start = second.try_inverse()?.transpose() * start * first.try_inverse()?;
    let refined = fit.refined(Orthonormal::of(&start)?, iterations);
    let f = second.transpose() * refined.matrix() * first;
    let f = f / f.norm();
    f.iter().all(|v| v.is_finite()).then_some(f)
}

#[derive(Debug, Clone, PartialEq)]
struct Orthonormal {
    u: Matrix3<f64>,
    v: Matrix3<f64>,
    angle: f64,
}

impl Orthonormal {
    /// Factorises a matrix of rank two, or nearly so, dropping its smallest singular value.
    fn of(f: &Matrix3<f64>) -> Option<Self> {
        if !f.iter().all(|v| v.is_finite()) {
            return None;
        }
        let svd = f.svd(true, true);
        let (large, small) = (svd.singular_values[0], svd.singular_values[1]);
        (large > 0.0).then_some(Self { u: svd.u?, v: svd.v_t?.transpose(), angle: small.atan2(large) })
    }

    fn singular_values(&self) -> Matrix3<f64> {
        Matrix3::from_diagonal(&Vector3::new(self.angle.cos(), self.angle.sin(), 0.0))
    }
}

impl Relation<7> for Orthonormal {
    fn matrix(&self) -> Matrix3<f64> {
        self.u * self.singular_values() * self.v.transpose()
    }

    fn stepped(&self, step: &SVector<f64, 7>) -> Self {
        let rotation = |k: usize| Rotation3::from_scaled_axis(step.fixed_rows::<3>(k).into_owned()).into_inner();
        Self { u: self.u * rotation(0), v: self.v * rotation(3), angle: self.angle + step[6] }
    }

    fn derivatives(&self) -> [Matrix3<f64>; 7] {
        let (s, axes) = (self.singular_values(), [Vector3::x(), Vector3::y(), Vector3::z()]);
        std::array::from_fn(|k| match k {
            0..=2 => self.u * skew(&axes[k]) * s * self.v.transpose(),
            3..=5 => -self.u * s * skew(&axes[k - 3]) * self.v.transpose(),
            _ => self.u * Matrix3::from_diagonal(&Vector3::new(-self.angle.sin(), self.angle.cos(), 0.0)) * self.v.transpose(),
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::geometry::distances::squared_sampson;
    use crate::geometry::test_views::{pixels, scene, true_fundamental};
    use crate::geometry::two_views::eight_point::eight_point;
    use crate::geometry::two_views::sampson_refinement::tests::derivatives_agree_with_differences;

    #[test]
    fn seven_parameter_derivatives_agree_with_differences() {
        for (pairs, seed) in [(pixels(&scene(40, 0.002, false, 8)), 0.0), (pixels(&scene(40, 0.01, true, 9)), 0.4)] {
            let (first, second) = (normalising(pairs.iter().map(|p| p.from)), normalising(pairs.iter().map(|p| p.to)));
            let (first, second) = (first.expect("spread"), second.expect("spread"));
            let fit = SampsonFit {
                pairs: pairs.iter().map(|p| [first * p.from.push(1.0), second * p.to.push(1.0)]).collect(),
                pixel: [first[(0, 0)], second[(0, 0)]],
                sigma: 1.0,
            };
            let f = second.try_inverse().expect("regular").transpose() * true_fundamental() * first.try_inverse().expect("regular");
            let state = Orthonormal::of(&f).expect("rank 2").stepped(&SVector::from_fn(|k, _| 0.02 * (k as f64 - seed)));
            derivatives_agree_with_differences(&state, &fit);
        }
    }

    #[test]
    fn refinement_lowers_the_distances_of_the_linear_solution() {
        for seed in 0..10 {
            let pairs = pixels(&scene(60, 0.002, false, seed));
            let linear = eight_point(&pairs, None).expect("regular");
            let refined = refine_fundamental(&linear, &pairs, 10.0, 30).expect("regular");
            let sum = |f: &Matrix3<f64>| pairs.iter().map(|p| squared_sampson(f, p)).sum::<f64>();
            assert!(sum(&refined) <= sum(&linear) * (1.0 + 1e-9), "{} {}", sum(&refined), sum(&linear));
            assert!(refined.determinant().abs() < 1e-14 && (refined.norm() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn outliers_do_not_pull() {
        let mut pairs = pixels(&scene(200, 0.0005, false, 5));
        for (k, p) in pairs.iter_mut().enumerate().take(40) {
            p.to += Vector2::new(25.0, 60.0 + k as f64);
        }
        let near = true_fundamental() + Matrix3::new(0.0, 1e-7, 0.0, -1e-7, 0.0, 1e-5, 0.0, 0.0, 1e-3);
        let refined = refine_fundamental(&near, &pairs, 0.4, 50).expect("regular");
        let rms = (pairs.iter().skip(40).map(|p| squared_sampson(&refined, p)).sum::<f64>() / 160.0).sqrt();
        assert!(rms < 0.3, "{rms}");
    }

    #[test]
    fn invalid_matrices_are_not_refined() {
        let pairs = pixels(&scene(20, 0.0, false, 5));
        assert_eq!(refine_fundamental(&Matrix3::zeros(), &pairs, 1.0, 5), None);
        assert_eq!(refine_fundamental(&Matrix3::repeat(f64::NAN), &pairs, 1.0, 5), None);
        assert_eq!(refine_fundamental(&true_fundamental(), &pairs[..0], 1.0, 5), None);
    }
}
