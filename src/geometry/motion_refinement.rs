//! Refinement of a two-view motion on Sampson distances: five degrees of freedom, always a valid
//! essential matrix.

use nalgebra::{Matrix3, Matrix5, SVector, UnitQuaternion, Vector3};

use super::distances::squared_sampson;
use super::least_squares::{Damping, MIN_GAIN_OF_PAIRS, Options, Problem, minimise};
use super::pose::skew;
use super::relative_pose::{RayPair, TwoViewMotion};
use super::robust_kernel::{geman_mcclure_cost, geman_mcclure_weight};

/// Refines a motion on Sampson distances of all pairs (5 degrees of freedom, Geman-McClure at
/// `sigma`, normalised units).
pub fn refine_motion(start: &TwoViewMotion, pairs: &[RayPair], sigma: f64, iterations: usize) -> TwoViewMotion {
    let options = Options { iterations, damping: Damping { now: 1e-4, least: 1e-12, most: 1e6 }, least_gain: MIN_GAIN_OF_PAIRS };
    minimise(&mut SampsonDistances { pairs, c2: (3.0 * sigma).powi(2) }, *start, &options).0
}

struct SampsonDistances<'a> {
    pairs: &'a [RayPair],
    /// Squared distance at which the cost is one half.
    c2: f64,
}

impl Problem for SampsonDistances<'_> {
    type State = TwoViewMotion;
    type Normal = (Matrix5<f64>, SVector<f64, 5>);

    fn cost(&self, motion: &TwoViewMotion) -> f64 {
        let e = motion.essential();
        self.pairs.iter().map(|p| geman_mcclure_cost(squared_sampson(&e, p), self.c2)).sum()
    }

    fn linearised(&self, motion: &TwoViewMotion) -> Self::Normal {
        motion_normal_equations(motion, self.pairs, self.c2)
    }

    fn stepped(&self, motion: &TwoViewMotion, (normal, gradient): &Self::Normal, damping: f64) -> Option<TwoViewMotion> {
        let damped = normal + Matrix5::from_diagonal(&(normal.diagonal() * damping)) + Matrix5::identity() * 1e-14;
        Some(moved(motion, &-damped.cholesky()?.solve(gradient)))
    }
}

/// Returns two directions perpendicular to t; they define the step [δθ (3), δt (2)]: R <- Exp(δθ)
/// R, t <- t + B δt, normalised.
fn tangent(t: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let least = t.abs().imin();
    let mut axis = Vector3::zeros();
    axis[least] = 1.0;
    let a = t.cross(&axis).normalize();
    [a, t.cross(&a)]
}

/// Moves a motion by a step.
pub(super) fn moved(m: &TwoViewMotion, step: &SVector<f64, 5>) -> TwoViewMotion {
    let [a, b] = tangent(&m.direction);
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
    TwoViewMotion { rotation: rotation * m.rotation, direction: (m.direction + a * step[3] + b * step[4]).normalize() }
}

/// Returns the derivatives of the essential matrix by the step.
pub(super) fn derivatives(m: &TwoViewMotion) -> [Matrix3<f64>; 5] {
    let r = m.rotation.to_rotation_matrix().into_inner();
    let [ta, tb] = tangent(&m.direction);
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    std::array::from_fn(|k| match k {
        0..=2 => skew(&m.direction) * skew(&axes[k]) * r,
        3 => skew(&ta) * r,
        _ => skew(&tb) * r,
    })
}

fn motion_normal_equations(m: &TwoViewMotion, pairs: &[RayPair], c2: f64) -> (Matrix5<f64>, SVector<f64, 5>) {
    let r = m.rotation.to_rotation_matrix().into_inner();
    let e = skew(&m.direction) * r;
    let derivatives = derivatives(m);
    let mut normal = Matrix5::zeros();
    let mut gradient = SVector::<f64, 5>::zeros();
    for p in pairs {
        let (a, b) = (p.first.push(1.0), p.second.push(1.0));
        let denominator = ((e * a).xy().norm_squared() + (e.transpose() * b).xy().norm_squared()).max(1e-300).sqrt();
        let residual = b.dot(&(e * a)) / denominator;
        let w = geman_mcclure_weight(residual * residual, c2);
        // Gauss-Newton with the denominator held constant, as usual for Sampson distances.
        let j = SVector::<f64, 5>::from_iterator(derivatives.iter().map(|d| b.dot(&(d * a)) / denominator));
        normal += w * j * j.transpose();
        gradient += w * j * residual;
    }
    (normal, gradient)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::test_views::{scene, truth};

    #[test]
    fn motion_derivative_agrees_with_differences() {
        let pairs = scene(40, 0.001, false, 8);
        let m = TwoViewMotion { rotation: UnitQuaternion::from_euler_angles(0.12, -0.28, 0.06), ..truth() };
        let residual = |m: &TwoViewMotion, p: &RayPair, fixed: f64| p.second.push(1.0).dot(&(m.essential() * p.first.push(1.0))) / fixed;
        let e = m.essential();
        let c2 = 1.0;
        let (_, gradient) = motion_normal_equations(&m, &pairs, c2);
        for k in 0..5 {
            let mut step = SVector::<f64, 5>::zeros();
            step[k] = 1e-6;
            let mut sum = 0.0;
            for p in &pairs {
                let d = ((e * p.first.push(1.0)).xy().norm_squared() + (e.transpose() * p.second.push(1.0)).xy().norm_squared()).sqrt();
                let r = residual(&m, p, d);
                let w = (c2 / (r * r + c2)).powi(2);
                sum += w * r * (residual(&moved(&m, &step), p, d) - residual(&moved(&m, &-step), p, d)) / 2e-6;
            }
            assert!((sum - gradient[k]).abs() < 1e-5 * (1.0 + sum.abs()), "{k}: {sum} {}", gradient[k]);
        }
    }
}
