//! Least squares of Sampson distances in pixels for arbitrary relations; shared by the refinements
//! of F and of a motion.

use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};

use crate::geometry::least_squares::{Damping, Options, Problem, minimise};
use crate::geometry::robust_kernel::{geman_mcclure_cost, geman_mcclure_weight};

/// A relation `x2^T M x1 = 0` with `P` degrees of freedom.
pub trait Relation<const P: usize>: Clone {
    /// Returns M.
    fn matrix(&self) -> Matrix3<f64>;

    /// Returns the relation after a step.
    fn stepped(&self, step: &SVector<f64, P>) -> Self;

    /// Returns the derivatives of M by the step, at step zero.
    fn derivatives(&self) -> [Matrix3<f64>; P];
}

/// The pairs to fit a relation to, and their noise.
#[derive(Debug, Clone)]
pub struct SampsonFit {
    /// Homogeneous points of both pictures in the relation's coordinates.
    pub pairs: Vec<[Vector3<f64>; 2]>,
    /// Size of a pixel of the first and of the second picture in those coordinates.
    pub pixel: [f64; 2],
    /// Noise of a distance, pixels; pairs beyond about three times it lose weight (Geman-McClure).
    pub sigma: f64,
}

impl SampsonFit {
    /// Refines a relation by Levenberg-Marquardt.
    pub fn refined<const P: usize, R: Relation<P>>(&self, start: R, iterations: usize) -> R {
        let options = Options { iterations, damping: Damping { now: 1e-4, least: 1e-12, most: 1e6 }, least_gain: 1e-9 };
        minimise(&mut Fit { fit: self, relation: std::marker::PhantomData }, start, &options).0
    }

    fn c2(&self) -> f64 {
        (3.0 * self.sigma).powi(2)
    }
}

/// Returns the signed Sampson distance of a pair in pixels, c / g; also g, M a, and the first two
/// entries of Mᵀ b.
fn distance(m: &Matrix3<f64>, [a, b]: &[Vector3<f64>; 2], pixel: &[f64; 2]) -> (f64, f64, Vector3<f64>, Vector2<f64>) {
    let ma = m * a;
    let mtb = Vector2::new(m.column(0).dot(b), m.column(1).dot(b));
    // The derivative of bᵀ M a by the points, per pixel.
    let g = (ma.xy().norm_squared() * pixel[1] * pixel[1] + mtb.norm_squared() * pixel[0] * pixel[0]).max(1e-300).sqrt();
    (b.dot(&ma) / g, g, ma, mtb)
}

/// Returns the distance and its derivative by the nine entries of M, row by row.
fn distance_and_slope(m: &Matrix3<f64>, pair: &[Vector3<f64>; 2], pixel: &[f64; 2]) -> (f64, SVector<f64, 9>) {
    let (r, g, ma, mtb) = distance(m, pair, pixel);
    let [a, b] = pair;
    // d(c / g) = dc / g - c dg / g², with g dg = Σ (M a)_i dM_ij a_j p2² + Σ (Mᵀ b)_j dM_ij b_i
    // p1².
    let (p1, p2) = (r / g * pixel[0] * pixel[0], r / g * pixel[1] * pixel[1]);
    let slope = SVector::<f64, 9>::from_fn(|k, _| {
        let (i, j) = (k / 3, k % 3);
        let by_line = if i < 2 { p2 * ma[i] * a[j] } else { 0.0 };
        let by_other = if j < 2 { p1 * mtb[j] * b[i] } else { 0.0 };
        (b[i] * a[j] - by_line - by_other) / g
    });
    (r, slope)
}

struct Fit<'a, const P: usize, R> {
    fit: &'a SampsonFit,
    relation: std::marker::PhantomData<fn() -> R>,
}

impl<const P: usize, R: Relation<P>> Problem for Fit<'_, P, R> {
    type State = R;
    type Normal = (SMatrix<f64, P, P>, SVector<f64, P>);

    fn cost(&self, relation: &R) -> f64 {
        let (m, c2) = (relation.matrix(), self.fit.c2());
        self.fit.pairs.iter().map(|pair| geman_mcclure_cost(distance(&m, pair, &self.fit.pixel).0.powi(2), c2)).sum()
    }

    /// Sums over pairs in the nine entries of M, which all parameters share.
    fn linearised(&self, relation: &R) -> Self::Normal {
        let (m, c2) = (relation.matrix(), self.fit.c2());
        let mut normal = SMatrix::<f64, 9, 9>::zeros();
        let mut gradient = SVector::<f64, 9>::zeros();
        for pair in &self.fit.pairs {
            let (r, slope) = distance_and_slope(&m, pair, &self.fit.pixel);
            let w = geman_mcclure_weight(r * r, c2);
            let weighted = slope * w;
            normal += weighted * slope.transpose();
            gradient += weighted * r;
        }
        let derivatives = relation.derivatives();
        let chain = SMatrix::<f64, 9, P>::from_fn(|k, p| derivatives[p][(k / 3, k % 3)]);
        (chain.transpose() * normal * chain, chain.transpose() * gradient)
    }

    fn stepped(&self, relation: &R, (normal, gradient): &Self::Normal, damping: f64) -> Option<R> {
        let damped = normal + SMatrix::<f64, P, P>::from_diagonal(&(normal.diagonal() * damping)) + SMatrix::identity() * 1e-14;
        let step = -damped.cholesky()?.solve(gradient);
        step.iter().all(|v| v.is_finite()).then(|| relation.stepped(&step))
    }
}

#[cfg(test)]
pub mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Checks the derivatives of a relation, and of the distances by its parameters, against finite
    /// differences.
    pub fn derivatives_agree_with_differences<const P: usize, R: Relation<P>>(relation: &R, fit: &SampsonFit) {
        const STEP: f64 = 1e-6;
        let (m, derivatives) = (relation.matrix(), relation.derivatives());
        for p in 0..P {
            let mut step = SVector::<f64, P>::zeros();
            step[p] = STEP;
            let (plus, minus) = (relation.stepped(&step).matrix(), relation.stepped(&-step).matrix());
            let by_difference = (plus - minus) / (2.0 * STEP);
            assert!((by_difference - derivatives[p]).norm() < 1e-7 * (1.0 + m.norm()), "{p}: {by_difference} {}", derivatives[p]);
            for pair in &fit.pairs {
                let slope = distance_and_slope(&m, pair, &fit.pixel).1;
                let chained: f64 = (0..9).map(|k| slope[k] * derivatives[p][(k / 3, k % 3)]).sum();
                let differed = (distance(&plus, pair, &fit.pixel).0 - distance(&minus, pair, &fit.pixel).0) / (2.0 * STEP);
                assert!((chained - differed).abs() < 1e-4 * (1.0 + differed.abs()), "{p}: {chained} {differed}");
            }
        }
    }

    #[test]
    fn the_gradient_by_every_entry_agrees_with_differences() {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        for _ in 0..20 {
            let m = Matrix3::from_fn(|_, _| random.random_range(-1.0..1.0));
            let mut point = || Vector3::new(random.random_range(-1.0..1.0), random.random_range(-1.0..1.0), 1.0);
            let (pair, pixel) = ([point(), point()], [0.003, 0.002]);
            let (r, slope) = distance_and_slope(&m, &pair, &pixel);
            assert_eq!(r, distance(&m, &pair, &pixel).0);
            for k in 0..9 {
                let mut step = Matrix3::zeros();
                step[(k / 3, k % 3)] = 1e-6;
                let differed = (distance(&(m + step), &pair, &pixel).0 - distance(&(m - step), &pair, &pixel).0) / 2e-6;
                assert!((slope[k] - differed).abs() < 1e-5 * (1.0 + differed.abs()), "{k}: {} {differed}", slope[k]);
            }
        }
    }
}
