//! Plane-to-plane maps: the 4-point solver, the normalised linear solution, and the refinement that
//! minimises the transfer error in the second picture.

use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};

use super::least_squares::{Damping, Options, Problem, minimise};
use super::robust_kernel::{geman_mcclure_cost, geman_mcclure_weight};

/// A projective map between two planes, `x2 ∝ H x1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Homography(pub Matrix3<f64>);

/// A pair of corresponding points on two planes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointPair {
    /// On the first plane.
    pub from: Vector2<f64>,
    /// On the second plane.
    pub to: Vector2<f64>,
}

impl Homography {
    /// Maps a point, or `None` when it lies on or beyond the horizon (third coordinate not of the sign of h33-normalised points).
    pub fn map(&self, p: Vector2<f64>) -> Option<Vector2<f64>> {
        let v = self.0 * p.push(1.0);
        (v.z > 1e-12).then(|| Vector2::new(v.x / v.z, v.y / v.z))
    }

    /// Whether the map keeps the sense of rotation, as every view of a picture's front does; a mirror image reverses it.
    pub fn keeps_orientation(&self) -> bool {
        // The Jacobian's determinant is det(H) / z^3, and z > 0 for every point that is mapped at all.
        self.0.determinant() > 0.0
    }

    /// Squared transfer error of a pair in the second plane; infinite behind the horizon.
    pub fn squared_error(&self, pair: &PointPair) -> f64 {
        self.map(pair.from).map_or(f64::INFINITY, |q| (q - pair.to).norm_squared())
    }

    /// Scaled so that h33 = 1, or `None` where h33 vanishes.
    pub fn with_unit_h33(&self) -> Option<Matrix3<f64>> {
        let scaled = self.0 / self.0[(2, 2)];
        scaled.iter().all(|v| v.is_finite()).then_some(scaled)
    }

    /// The exact map through four pairs, no three of them in line (Heckbert's square-to-quad construction, twice).
    ///
    /// `None` for degenerate or orientation-mixing samples: the four corners must turn the same way around every triangle in
    /// both pictures, up to one common reflection, or no view of a plane can have produced them.
    pub fn from_four(pairs: &[PointPair; 4]) -> Option<Self> {
        if !consistent_orientation(pairs) {
            return None;
        }
        let from = basis_map(&pairs.map(|p| p.from))?;
        let to = basis_map(&pairs.map(|p| p.to))?;
        let h = to * from.try_inverse()?;
        let scale = h.norm();
        // All four points must lie on the same side of the horizon; choose the sign that makes it the front.
        let sign = (h * pairs[0].from.push(1.0)).z.signum();
        let h = h * (sign / scale);
        let finite = h.iter().all(|v| v.is_finite());
        let front = pairs.iter().all(|p| (h * p.from.push(1.0)).z > 0.0);
        (finite && front).then_some(Self(h))
    }

    /// The normalised direct linear transformation over weighted pairs (Hartley & Zisserman, algorithm 4.2).
    pub fn from_pairs(pairs: &[PointPair], weights: Option<&[f64]>) -> Option<Self> {
        if pairs.len() < 4 {
            return None;
        }
        let from = normalising(pairs.iter().map(|p| p.from))?;
        let to = normalising(pairs.iter().map(|p| p.to))?;
        let mut ata = SMatrix::<f64, 9, 9>::zeros();
        for (k, pair) in pairs.iter().enumerate() {
            let w = weights.map_or(1.0, |w| w[k]);
            let a = from * pair.from.push(1.0);
            let b = to * pair.to.push(1.0);
            let mut r1 = SVector::<f64, 9>::zeros();
            let mut r2 = SVector::<f64, 9>::zeros();
            r1.fixed_rows_mut::<3>(0).copy_from(&a);
            r1.fixed_rows_mut::<3>(6).copy_from(&(-b.x * a));
            r2.fixed_rows_mut::<3>(3).copy_from(&a);
            r2.fixed_rows_mut::<3>(6).copy_from(&(-b.y * a));
            ata += w * (r1 * r1.transpose() + r2 * r2.transpose());
        }
        let eigen = ata.symmetric_eigen();
        let least = eigen.eigenvalues.imin();
        let v = eigen.eigenvectors.column(least);
        let hn = Matrix3::new(v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8]);
        let h = to.try_inverse()? * hn * from;
        let front = pairs.iter().map(|p| (h * p.from.push(1.0)).z.signum()).sum::<f64>();
        let h = h * (front.signum() / h.norm());
        h.iter().all(|v| v.is_finite()).then_some(Self(h))
    }

    /// Gauss-Newton with Levenberg's damping on the robust transfer error in the second plane (8 parameters).
    ///
    /// `sigma` is the pixel noise; residuals beyond about three of it lose weight (Geman-McClure).
    pub fn refined(&self, pairs: &[PointPair], sigma: f64, iterations: usize) -> Option<Self> {
        let (from, to) = (normalising(pairs.iter().map(|p| p.from))?, normalising(pairs.iter().map(|p| p.to))?);
        let (from_inv, to_inv) = (from.try_inverse()?, to.try_inverse()?);
        let start = to * self.0 * from_inv;
        let mut errors = TransferErrors { pairs, from, to, c2: (3.0 * sigma * to[(0, 0)]).powi(2) };
        let options = Options { iterations, damping: Damping { now: 1e-6, least: 1e-12, most: 1e3 }, least_gain: 1e-10 };
        let (h, _) = minimise(&mut errors, start / start.norm(), &options);
        let h = to_inv * h * from;
        let front = pairs.iter().map(|p| (h * p.from.push(1.0)).z.signum()).sum::<f64>();
        let h = h * (front.signum() / h.norm());
        h.iter().all(|v| v.is_finite()).then_some(Self(h))
    }
}

/// Transfer errors in the second plane, of pairs that are normalised by `from` and `to`.
struct TransferErrors<'a> {
    pairs: &'a [PointPair],
    from: Matrix3<f64>,
    to: Matrix3<f64>,
    /// Squared error of half the cost.
    c2: f64,
}

impl Problem for TransferErrors<'_> {
    type State = Matrix3<f64>;
    type Normal = (SMatrix<f64, 9, 9>, SVector<f64, 9>);

    fn cost(&self, h: &Matrix3<f64>) -> f64 {
        let squared = |p: &PointPair| {
            let v = h * (self.from * p.from.push(1.0));
            let b = self.to * p.to.push(1.0);
            (v.xy() / v.z - b.xy()).norm_squared()
        };
        self.pairs.iter().map(|p| geman_mcclure_cost(squared(p), self.c2)).sum()
    }

    fn linearised(&self, h: &Matrix3<f64>) -> Self::Normal {
        let mut jtj = SMatrix::<f64, 9, 9>::zeros();
        let mut jtr = SVector::<f64, 9>::zeros();
        for p in self.pairs {
            let a = self.from * p.from.push(1.0);
            let b = self.to * p.to.push(1.0);
            let v = h * a;
            if v.z.abs() < 1e-9 {
                continue;
            }
            let q = v.xy() / v.z;
            let r = q - b.xy();
            let w = geman_mcclure_weight(r.norm_squared(), self.c2);
            let mut j = SMatrix::<f64, 2, 9>::zeros();
            for k in 0..3 {
                j[(0, k)] = a[k] / v.z;
                j[(1, k + 3)] = a[k] / v.z;
                j[(0, k + 6)] = -q.x * a[k] / v.z;
                j[(1, k + 6)] = -q.y * a[k] / v.z;
            }
            jtj += w * j.transpose() * j;
            jtr += w * j.transpose() * r;
        }
        // The scale of H is free: pin it by a unit constraint along h itself.
        let along = SVector::<f64, 9>::from_iterator(h.transpose().iter().copied());
        let trace = jtj.trace();
        (jtj + along * along.transpose() * trace, jtr)
    }

    fn stepped(&self, h: &Matrix3<f64>, (normal, gradient): &Self::Normal, damping: f64) -> Option<Matrix3<f64>> {
        // The constraint adds the trace once: half of it is the data's.
        let share = damping * 0.5 * normal.trace() / 9.0;
        let damped = normal + SMatrix::<f64, 9, 9>::identity() * share;
        let next = h - Matrix3::from_row_slice(damped.cholesky()?.solve(gradient).as_slice());
        Some(next / next.norm())
    }
}

/// The map that takes the projective basis to four points (columns scaled so that they add up to the fourth).
fn basis_map(p: &[Vector2<f64>; 4]) -> Option<Matrix3<f64>> {
    let m = Matrix3::from_columns(&[p[0].push(1.0), p[1].push(1.0), p[2].push(1.0)]);
    let c: Vector3<f64> = m.try_inverse()? * p[3].push(1.0);
    let m = Matrix3::from_columns(&[m.column(0) * c.x, m.column(1) * c.y, m.column(2) * c.z]);
    (c.x != 0.0 && c.y != 0.0 && c.z != 0.0).then_some(m)
}

fn turn(a: Vector2<f64>, b: Vector2<f64>, c: Vector2<f64>) -> f64 {
    (b - a).perp(&(c - a))
}

/// Every triangle of the sample must keep its orientation, or every one must reverse it.
fn consistent_orientation(p: &[PointPair; 4]) -> bool {
    let product = |i: usize, j: usize, k: usize| turn(p[i].from, p[j].from, p[k].from) * turn(p[i].to, p[j].to, p[k].to);
    let signs = [product(0, 1, 2), product(0, 1, 3), product(0, 2, 3), product(1, 2, 3)];
    signs.iter().all(|s| *s > 0.0) || signs.iter().all(|s| *s < 0.0)
}

/// Hartley's normalisation: centroid to the origin, mean distance to sqrt 2.
fn normalising(points: impl Iterator<Item = Vector2<f64>> + Clone) -> Option<Matrix3<f64>> {
    let n = points.clone().count() as f64;
    let mean = points.clone().sum::<Vector2<f64>>() / n;
    let spread = points.map(|p| (p - mean).norm()).sum::<f64>() / n;
    let s = std::f64::consts::SQRT_2 / spread;
    s.is_finite().then(|| Matrix3::new(s, 0.0, -s * mean.x, 0.0, s, -s * mean.y, 0.0, 0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    fn truth() -> Homography {
        Homography(Matrix3::new(0.8, 0.1, 120.0, -0.05, 0.9, 60.0, 1e-4, -2e-4, 1.0))
    }

    fn pairs(n: usize, noise: f64) -> Vec<PointPair> {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        (0..n)
            .map(|_| {
                let from = Vector2::new(rng.random_range(0.0..800.0), rng.random_range(0.0..600.0));
                let to =
                    truth().map(from).expect("in front") + noise * Vector2::new(rng.random_range(-1.7..1.7), rng.random_range(-1.7..1.7));
                PointPair { from, to }
            })
            .collect()
    }

    fn corner_error(h: &Homography) -> f64 {
        [(0.0, 0.0), (800.0, 0.0), (800.0, 600.0), (0.0, 600.0)]
            .map(|(x, y)| (h.map(Vector2::new(x, y)).expect("in front") - truth().map(Vector2::new(x, y)).expect("in front")).norm())
            .into_iter()
            .fold(0.0, f64::max)
    }

    #[test]
    fn four_points_are_met_exactly() {
        let p = pairs(4, 0.0);
        let h = Homography::from_four(&[p[0], p[1], p[2], p[3]]).expect("a regular sample");
        assert!(corner_error(&h) < 1e-6, "{}", corner_error(&h));
    }

    #[test]
    fn a_sample_that_mixes_orientations_is_refused() {
        let mut p = pairs(4, 0.0);
        p.swap(0, 1);
        let swapped = [PointPair { from: p[0].from, to: p[1].to }, PointPair { from: p[1].from, to: p[0].to }, p[2], p[3]];
        assert!(Homography::from_four(&swapped).is_none());
    }

    #[test]
    fn linear_solution_is_exact_without_noise() {
        let h = Homography::from_pairs(&pairs(20, 0.0), None).expect("regular");
        assert!(corner_error(&h) < 1e-6);
    }

    #[test]
    fn refinement_resists_outliers_and_beats_noise() {
        let mut p = pairs(200, 0.5);
        for (k, pair) in p.iter_mut().take(30).enumerate() {
            pair.to += Vector2::new(40.0 + k as f64, -35.0);
        }
        let start = Homography(truth().0 + Matrix3::new(1e-3, 0.0, 1.0, 0.0, 1e-3, -1.0, 0.0, 0.0, 0.0));
        let h = start.refined(&p, 0.5, 20).expect("regular");
        // Half a pixel of noise over 170 pairs leaves about half a pixel at the extrapolated corners.
        assert!(corner_error(&h) < 1.0, "{}", corner_error(&h));
    }
}
