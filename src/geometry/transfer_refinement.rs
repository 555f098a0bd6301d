//! Refinement of a homography on the transfer error in the second plane: for maps whose first plane
//! is known exactly, such as an artwork or a board.

use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};

use super::homography::{Homography, PointPair};
use super::least_squares::{Damping, MIN_GAIN_OF_PAIRS, Options, Problem, minimise};
use super::normalisation::normalising;
use super::robust_kernel::{geman_mcclure_cost, geman_mcclure_weight};

impl Homography {
    /// Refines by Levenberg-Marquardt on the robust transfer error in the second plane (8
    /// parameters).
    ///
    /// `sigma` is the pixel noise; residuals beyond about three times it lose weight
    /// (Geman-McClure). `None` for degenerate pairs.
    pub fn refined(&self, pairs: &[PointPair], sigma: f64, iterations: usize) -> Option<Self> {
        let (from, to) = (normalising(pairs.iter().map(|p| p.from))?, normalising(pairs.iter().map(|p| p.to))?);
        let (from_inv, to_inv) = (from.try_inverse()?, to.try_inverse()?);
        let start = to * self.0 * from_inv;
        let mut errors = TransferErrors { pairs, from, to, c2: (3.0 * sigma * to[(0, 0)]).powi(2) };
        let options = Options { iterations, damping: Damping { now: 1e-6, least: 1e-12, most: 1e3 }, least_gain: MIN_GAIN_OF_PAIRS };
        let (h, _) = minimise(&mut errors, start / start.norm(), &options);
        let h = to_inv * h * from;
        let front = pairs.iter().map(|p| (h * p.from.push(1.0)).z.signum()).sum::<f64>();
        let h = h * (front.signum() / h.norm());
        h.iter().all(|v| v.is_finite()).then_some(Self(h))
    }
}

/// Transfer errors in the second plane, of pairs normalised by `from` and `to`.
struct TransferErrors<'a> {
    pairs: &'a [PointPair],
    from: Matrix3<f64>,
    to: Matrix3<f64>,
    /// Squared error at which the cost is one half.
    c2: f64,
}

/// Applies a matrix of [`normalising`], which only scales and shifts.
fn scaled(by: &Matrix3<f64>, point: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(by[(0, 0)] * point.x + by[(0, 2)], by[(1, 1)] * point.y + by[(1, 2)])
}

impl Problem for TransferErrors<'_> {
    type State = Matrix3<f64>;
    type Normal = (SMatrix<f64, 9, 9>, SVector<f64, 9>);

    fn cost(&self, h: &Matrix3<f64>) -> f64 {
        let squared = |p: &PointPair| {
            let v = h * scaled(&self.from, &p.from).push(1.0);
            (v.xy() / v.z - scaled(&self.to, &p.to)).norm_squared()
        };
        self.pairs.iter().map(|p| geman_mcclure_cost(squared(p), self.c2)).sum()
    }

    fn linearised(&self, h: &Matrix3<f64>) -> Self::Normal {
        // A pair's derivatives are its first-plane point times 1, 0 and -q for H's rows: the normal
        // matrix consists of four sums of outer products.
        let [mut plain, mut across, mut down, mut both] = [Matrix3::zeros(); 4];
        let [mut by_first, mut by_second, mut by_third] = [Vector3::zeros(); 3];
        for p in self.pairs {
            let a = scaled(&self.from, &p.from).push(1.0);
            let v = h * a;
            if v.z.abs() < 1e-9 {
                continue;
            }
            let q = v.xy() / v.z;
            let r = q - scaled(&self.to, &p.to);
            let w = geman_mcclure_weight(r.norm_squared(), self.c2);
            let a = a / v.z;
            let outer = w * a * a.transpose();
            plain += outer;
            across += outer * q.x;
            down += outer * q.y;
            both += outer * q.norm_squared();
            by_first += a * (w * r.x);
            by_second += a * (w * r.y);
            by_third -= a * (w * q.dot(&r));
        }
        let mut jtj = SMatrix::<f64, 9, 9>::zeros();
        for (row, column, block) in
            [(0, 0, plain), (3, 3, plain), (0, 6, -across), (6, 0, -across), (3, 6, -down), (6, 3, -down), (6, 6, both)]
        {
            jtj.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        }
        let mut jtr = SVector::<f64, 9>::zeros();
        for (row, part) in [(0, by_first), (3, by_second), (6, by_third)] {
            jtr.fixed_rows_mut::<3>(row).copy_from(&part);
        }
        (with_pinned_scale(&jtj, h), jtr)
    }

    fn stepped(&self, h: &Matrix3<f64>, (normal, gradient): &Self::Normal, damping: f64) -> Option<Matrix3<f64>> {
        damped_step(h, normal, gradient, damping)
    }
}

/// Adds a unit constraint along `h` to the normal equations of a homography (row by row), which
/// pins its free scale.
pub(super) fn with_pinned_scale(normal: &SMatrix<f64, 9, 9>, h: &Matrix3<f64>) -> SMatrix<f64, 9, 9> {
    let along = SVector::<f64, 9>::from_iterator(h.transpose().iter().copied());
    normal + along * along.transpose() * normal.trace()
}

/// Returns the homography of norm 1 after a damped step of equations with a pinned scale; `None` if
/// they are singular.
pub(super) fn damped_step(h: &Matrix3<f64>, normal: &SMatrix<f64, 9, 9>, gradient: &SVector<f64, 9>, damping: f64) -> Option<Matrix3<f64>> {
    // The constraint adds the trace once: half of the total is the data's.
    let share = damping * 0.5 * normal.trace() / 9.0;
    let damped = normal + SMatrix::<f64, 9, 9>::identity() * share;
    let next = h - Matrix3::from_row_slice(damped.cholesky()?.solve(gradient).as_slice());
    Some(next / next.norm())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::test_planes::{corner_error, pairs, truth};

    #[test]
    fn the_normal_equations_agree_with_error_differences() {
        let pairs = pairs(40, 0.5);
        let h = truth().0 / truth().0.norm();
        let (from, to) =
            (normalising(pairs.iter().map(|p| p.from)).expect("a plane"), normalising(pairs.iter().map(|p| p.to)).expect("a plane"));
        let h = to * h * from.try_inverse().expect("regular");
        let h = h / h.norm();
        let errors = TransferErrors { pairs: &pairs, from, to, c2: 1e-4 };
        let error = |h: &Matrix3<f64>, p: &PointPair| {
            let v = h * (from * p.from.push(1.0));
            v.xy() / v.z - (to * p.to.push(1.0)).xy()
        };
        const STEP: f64 = 1e-6;
        let mut jtj = SMatrix::<f64, 9, 9>::zeros();
        let mut jtr = SVector::<f64, 9>::zeros();
        for p in &pairs {
            let mut j = SMatrix::<f64, 2, 9>::zeros();
            for k in 0..9 {
                let mut step = Matrix3::zeros();
                step[(k / 3, k % 3)] = STEP;
                j.set_column(k, &((error(&(h + step), p) - error(&(h - step), p)) / (2.0 * STEP)));
            }
            let weight = geman_mcclure_weight(error(&h, p).norm_squared(), errors.c2);
            jtj += j.transpose() * j * weight;
            jtr += j.transpose() * error(&h, p) * weight;
        }
        let along = SVector::<f64, 9>::from_iterator(h.transpose().iter().copied());
        let (normal, gradient) = errors.linearised(&h);
        let of_errors = normal - along * along.transpose() * jtj.trace();
        assert!((of_errors - jtj).norm() < 1e-6 * jtj.norm(), "{of_errors} {jtj}");
        assert!((gradient - jtr).norm() < 1e-6 * jtr.norm(), "{gradient} {jtr}");
    }

    #[test]
    fn refinement_resists_outliers_and_beats_noise() {
        let mut p = pairs(200, 0.5);
        for (k, pair) in p.iter_mut().take(30).enumerate() {
            pair.to += Vector2::new(40.0 + k as f64, -35.0);
        }
        let start = Homography(truth().0 + Matrix3::new(1e-3, 0.0, 1.0, 0.0, 1e-3, -1.0, 0.0, 0.0, 0.0));
        let h = start.refined(&p, 0.5, 20).expect("regular");
        // Half a pixel of noise over 170 pairs leaves about half a pixel at the extrapolated
        // corners.
        assert!(corner_error(&h) < 1.0, "{}", corner_error(&h));
    }
}
