//! The essential matrix: five-point solver (Nistér, PAMI 2004), motion from it with cheirality judged by
//! every correspondence in both views, and refinement of the motion on Sampson distances.

use nalgebra::{Matrix3, Matrix5, SMatrix, SVector, UnitQuaternion, Vector3};

use super::least_squares::{Damping, Options, Problem, minimise};
use super::pose::{quaternion, skew};
use super::ransac::{self, Estimator};
use super::relative_pose::{RayPair, TwoViewMotion};
use super::robust_kernel::{geman_mcclure_cost, geman_mcclure_weight};
use super::triangulation::depths;

/// Squared Sampson distance of a pair to E, in normalised units squared.
pub fn squared_sampson(e: &Matrix3<f64>, pair: &RayPair) -> f64 {
    let (a, b) = (pair.first.push(1.0), pair.second.push(1.0));
    let (ea, etb) = (e * a, e.transpose() * b);
    let c = b.dot(&ea);
    c * c / (ea.xy().norm_squared() + etb.xy().norm_squared()).max(1e-300)
}

/// All essential matrices (at most ten) that five pairs satisfy.
pub fn five_point(pairs: &[RayPair; 5]) -> Vec<Matrix3<f64>> {
    let mut a = SMatrix::<f64, 9, 9>::zeros();
    for p in pairs {
        let (x, y) = (p.first.push(1.0), p.second.push(1.0));
        let row = SVector::<f64, 9>::from_iterator((0..9).map(|k| y[k / 3] * x[k % 3]));
        a += row * row.transpose();
    }
    let eigen = a.symmetric_eigen();
    let mut order: Vec<usize> = (0..9).collect();
    order.sort_by(|&i, &k| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[k]));
    let basis: [Matrix3<f64>; 4] = std::array::from_fn(|k| {
        let column = eigen.eigenvectors.column(order[k]).into_owned();
        Matrix3::from_row_slice(column.as_slice())
    });
    let Some(reduced) = reduced_constraints(&basis) else { return Vec::new() };
    solutions(&reduced, &basis)
}

/// Index of the monomials of degree <= 3 in x, y, z, in the order that Nistér's elimination needs.
fn monomial_index([x, y, z]: [usize; 3]) -> usize {
    // Exponents of x, y and z: first the ten that are eliminated, then those that the polynomial in z is made of (Nistér 2004).
    const ORDER: [[usize; 3]; 20] = [
        [3, 0, 0],
        [0, 3, 0],
        [2, 1, 0],
        [1, 2, 0],
        [2, 0, 1],
        [2, 0, 0],
        [0, 2, 1],
        [0, 2, 0],
        [1, 1, 1],
        [1, 1, 0],
        [1, 0, 2],
        [1, 0, 1],
        [1, 0, 0],
        [0, 1, 2],
        [0, 1, 1],
        [0, 1, 0],
        [0, 0, 3],
        [0, 0, 2],
        [0, 0, 1],
        [0, 0, 0],
    ];
    // Every product of three linear forms is in the table.
    ORDER.iter().position(|m| *m == [x, y, z]).unwrap_or(19)
}

/// The ten cubic constraints on E = xX + yY + zZ + W (det E = 0 and 2 E E^T E = tr(E E^T) E), eliminated to the identity in
/// the first ten monomials; the remaining ten columns are returned.
fn reduced_constraints(basis: &[Matrix3<f64>; 4]) -> Option<SMatrix<f64, 10, 10>> {
    let exponents = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]];
    let mut m = SMatrix::<f64, 10, 20>::zeros();
    for i in 0..4 {
        for j in 0..4 {
            let bij = basis[i] * basis[j].transpose();
            for k in 0..4 {
                let exponent = std::array::from_fn(|d| exponents[i][d] + exponents[j][d] + exponents[k][d]);
                let column = monomial_index(exponent);
                let cubic = 2.0 * bij * basis[k] - bij.trace() * basis[k];
                for r in 0..9 {
                    m[(r, column)] += cubic[(r / 3, r % 3)];
                }
                let determinant =
                    Vector3::from(basis[i].row(0).transpose()).cross(&basis[j].row(1).transpose()).dot(&basis[k].row(2).transpose());
                m[(9, column)] += determinant;
            }
        }
    }
    let left: SMatrix<f64, 10, 10> = m.fixed_columns::<10>(0).into_owned();
    let right: SMatrix<f64, 10, 10> = m.fixed_columns::<10>(10).into_owned();
    left.full_piv_lu().solve(&right)
}

/// A polynomial in z, lowest power first.
type Polynomial = Vec<f64>;

fn times(a: &[f64], b: &[f64]) -> Polynomial {
    let mut out = vec![0.0; a.len() + b.len() - 1];
    for (i, x) in a.iter().enumerate() {
        for (k, y) in b.iter().enumerate() {
            out[i + k] += x * y;
        }
    }
    out
}

fn minus(a: &[f64], b: &[f64]) -> Polynomial {
    (0..a.len().max(b.len())).map(|k| a.get(k).unwrap_or(&0.0) - b.get(k).unwrap_or(&0.0)).collect()
}

fn value(p: &[f64], z: f64) -> f64 {
    p.iter().rev().fold(0.0, |sum, c| sum * z + c)
}

/// Row k of the 3x3 matrix B(z): [x-coefficient, y-coefficient, rest], from e - z f of Nistér's table.
fn row_of(r: &SMatrix<f64, 10, 10>, e: usize, f: usize) -> [Polynomial; 3] {
    let (e, f) = (r.row(e), r.row(f));
    let part = |from: usize, n: usize| -> Polynomial {
        // Columns hold descending powers z^(n-1) .. z^0; reverse them, then subtract z times the other row.
        let low: Vec<f64> = (0..n).map(|k| e[from + n - 1 - k]).collect();
        let high: Vec<f64> = std::iter::once(0.0).chain((0..n).map(|k| f[from + n - 1 - k])).collect();
        minus(&low, &high)
    };
    [part(0, 3), part(3, 3), part(6, 4)]
}

fn solutions(reduced: &SMatrix<f64, 10, 10>, basis: &[Matrix3<f64>; 4]) -> Vec<Matrix3<f64>> {
    let b = [row_of(reduced, 4, 5), row_of(reduced, 6, 7), row_of(reduced, 8, 9)];
    let minor = |i: usize, j: usize, c: usize, d: usize| minus(&times(&b[i][c], &b[j][d]), &times(&b[i][d], &b[j][c]));
    let cofactors = [minor(1, 2, 1, 2), minor(1, 2, 2, 0), minor(1, 2, 0, 1)];
    let mut determinant = vec![0.0; 11];
    for (column, cofactor) in cofactors.iter().enumerate() {
        for (power, c) in times(&b[0][column], cofactor).into_iter().enumerate() {
            determinant[power] += c;
        }
    }
    real_roots(&determinant)
        .into_iter()
        .filter_map(|z| {
            // The null vector of B(z) is (x, y, 1): take it from the best-conditioned pair of rows.
            let rows: [Vector3<f64>; 3] = std::array::from_fn(|k| Vector3::new(value(&b[k][0], z), value(&b[k][1], z), value(&b[k][2], z)));
            let null = [rows[0].cross(&rows[1]), rows[0].cross(&rows[2]), rows[1].cross(&rows[2])]
                .into_iter()
                .max_by(|p, q| p.norm_squared().total_cmp(&q.norm_squared()))?;
            let (x, y) = (null.x / null.z, null.y / null.z);
            let e = basis[0] * x + basis[1] * y + basis[2] * z + basis[3];
            let e = e / e.norm();
            e.iter().all(|v| v.is_finite()).then_some(e)
        })
        .collect()
}

/// Real roots of a polynomial of degree ten (lowest power first): eigenvalues of the companion matrix, polished by Newton.
fn real_roots(p: &[f64]) -> Vec<f64> {
    let lead = p[10];
    let largest = p.iter().fold(0.0_f64, |m, c| m.max(c.abs()));
    if !largest.is_finite() || lead.abs() <= 1e-14 * largest {
        return Vec::new();
    }
    let mut companion = SMatrix::<f64, 10, 10>::zeros();
    for k in 0..10 {
        companion[(0, k)] = -p[9 - k] / lead;
        if k > 0 {
            companion[(k, k - 1)] = 1.0;
        }
    }
    let Some(schur) = nalgebra::linalg::Schur::try_new(companion, 1e-14, 500) else { return Vec::new() };
    let slope: Vec<f64> = (1..p.len()).map(|k| k as f64 * p[k]).collect();
    schur
        .complex_eigenvalues()
        .iter()
        .filter(|root| root.im.abs() < 1e-4 * (1.0 + root.re.abs()))
        .map(|root| {
            let mut z = root.re;
            for _ in 0..5 {
                let step = value(p, z) / value(&slope, z);
                if step.is_finite() {
                    z -= step;
                }
            }
            z
        })
        .collect()
}

/// The four motions that an essential matrix allows.
fn decompose(e: &Matrix3<f64>) -> Option<[TwoViewMotion; 4]> {
    let svd = e.svd(true, true);
    let (mut u, mut vt) = (svd.u?, svd.v_t?);
    // nalgebra sorts singular values, largest first: the null directions are the last ones.
    if u.determinant() < 0.0 {
        u = -u;
    }
    if vt.determinant() < 0.0 {
        vt = -vt;
    }
    let w = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let t: Vector3<f64> = u.column(2).into_owned();
    let (r1, r2) = (quaternion(&(u * w * vt)), quaternion(&(u * w.transpose() * vt)));
    Some([(r1, t), (r1, -t), (r2, t), (r2, -t)].map(|(rotation, direction)| TwoViewMotion { rotation, direction }))
}

/// The motion among the four that puts most pairs in front of both cameras, with that number.
pub fn motion_by_cheirality(e: &Matrix3<f64>, pairs: &[RayPair]) -> Option<(TwoViewMotion, usize)> {
    let motions = decompose(e)?;
    let counted = motions.map(|m| {
        let in_front = pairs.iter().filter(|p| depths(&m, p).is_some_and(|(a, b)| a > 0.0 && b > 0.0)).count();
        (m, in_front)
    });
    counted.into_iter().max_by_key(|(_, n)| *n)
}

/// Sampson cost, truncated at `threshold` (normalised units).
pub fn truncated_cost(e: &Matrix3<f64>, pairs: &[RayPair], threshold: f64) -> f64 {
    let t2 = threshold * threshold;
    pairs.iter().map(|p| squared_sampson(e, p).min(t2)).sum()
}

/// Robust search: `samples` five-point samples, MSAC on Sampson distances; every distinct good model is returned, best
/// first (at most `keep`), because a flat scene allows two.
pub fn robust_essential(pairs: &[RayPair], threshold: f64, samples: usize, keep: usize, seed: u64) -> Vec<Matrix3<f64>> {
    if pairs.len() < 6 {
        return Vec::new();
    }
    let options = ransac::Options { samples, confidence: None, is_progressive: false, least_score: f64::NEG_INFINITY, keep, seed };
    ransac::search(&TwoViews { pairs, threshold }, &options).into_iter().map(|(_, e)| e).collect()
}

/// Rays seen in two views, of which five make up to ten essential matrices.
struct TwoViews<'a> {
    pairs: &'a [RayPair],
    threshold: f64,
}

impl Estimator<5> for TwoViews<'_> {
    type Model = Matrix3<f64>;

    fn count(&self) -> usize {
        self.pairs.len()
    }

    fn models(&self, sample: [usize; 5]) -> impl Iterator<Item = Matrix3<f64>> {
        five_point(&sample.map(|k| self.pairs[k])).into_iter()
    }

    fn score(&self, e: &Matrix3<f64>) -> f64 {
        -truncated_cost(e, self.pairs, self.threshold)
    }

    fn inlier_share(&self, e: &Matrix3<f64>) -> f64 {
        let t2 = self.threshold * self.threshold;
        self.pairs.iter().filter(|p| squared_sampson(e, p) < t2).count() as f64 / self.pairs.len() as f64
    }
}

/// Refines a motion on Sampson distances of all pairs (5 degrees of freedom, Geman-McClure at `sigma`, normalised units).
pub fn refine_motion(start: &TwoViewMotion, pairs: &[RayPair], sigma: f64, iterations: usize) -> TwoViewMotion {
    let options = Options { iterations, damping: Damping { now: 1e-4, least: 1e-12, most: 1e6 }, least_gain: 1e-10 };
    minimise(&mut SampsonDistances { pairs, c2: (3.0 * sigma).powi(2) }, *start, &options).0
}

struct SampsonDistances<'a> {
    pairs: &'a [RayPair],
    /// Squared distance of half the cost.
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

/// Two directions across t, and the step [δθ (3), δt (2)]: R <- Exp(δθ) R, t <- t + B δt, normalised.
fn tangent(t: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let least = t.abs().imin();
    let mut axis = Vector3::zeros();
    axis[least] = 1.0;
    let a = t.cross(&axis).normalize();
    [a, t.cross(&a)]
}

fn moved(m: &TwoViewMotion, step: &SVector<f64, 5>) -> TwoViewMotion {
    let [a, b] = tangent(&m.direction);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
    TwoViewMotion { rotation: turn * m.rotation, direction: (m.direction + a * step[3] + b * step[4]).normalize() }
}

fn motion_normal_equations(m: &TwoViewMotion, pairs: &[RayPair], c2: f64) -> (Matrix5<f64>, SVector<f64, 5>) {
    let r = m.rotation.to_rotation_matrix().into_inner();
    let e = skew(&m.direction) * r;
    let [ta, tb] = tangent(&m.direction);
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    let derivatives: [Matrix3<f64>; 5] = std::array::from_fn(|k| match k {
        0..=2 => skew(&m.direction) * skew(&axes[k]) * r,
        3 => skew(&ta) * r,
        _ => skew(&tb) * r,
    });
    let mut normal = Matrix5::zeros();
    let mut gradient = SVector::<f64, 5>::zeros();
    for p in pairs {
        let (a, b) = (p.first.push(1.0), p.second.push(1.0));
        let denominator = ((e * a).xy().norm_squared() + (e.transpose() * b).xy().norm_squared()).max(1e-300).sqrt();
        let residual = b.dot(&(e * a)) / denominator;
        let w = geman_mcclure_weight(residual * residual, c2);
        // Gauss-Newton with the denominator held, as usual for Sampson distances.
        let j = SVector::<f64, 5>::from_iterator(derivatives.iter().map(|d| b.dot(&(d * a)) / denominator));
        normal += w * j * j.transpose();
        gradient += w * j * residual;
    }
    (normal, gradient)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    fn truth() -> TwoViewMotion {
        TwoViewMotion { rotation: UnitQuaternion::from_euler_angles(0.1, -0.3, 0.05), direction: Vector3::new(0.8, 0.1, 0.3).normalize() }
    }

    fn scene(n: usize, noise: f64, flat: bool, seed: u64) -> Vec<RayPair> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        (0..n)
            .map(|_| {
                let depth = if flat { 4.0 } else { rng.random_range(3.0..6.0) };
                let p = Vector3::new(rng.random_range(-1.5..1.5), rng.random_range(-1.0..1.0), depth);
                let q = truth().rotation * p + truth().direction;
                let mut jitter = || Vector2::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0)) * noise;
                RayPair { first: p.xy() / p.z + jitter(), second: q.xy() / q.z + jitter() }
            })
            .collect()
    }

    fn errors_deg(m: &TwoViewMotion) -> (f64, f64) {
        let t = truth();
        (m.rotation.angle_to(&t.rotation).to_degrees(), m.direction.dot(&t.direction).clamp(-1.0, 1.0).acos().to_degrees())
    }

    #[test]
    fn five_exact_pairs_contain_the_truth() {
        let e = truth().essential().normalize();
        for seed in 0..20 {
            let p = scene(5, 0.0, false, seed);
            let found = five_point(&[p[0], p[1], p[2], p[3], p[4]]);
            let nearest = found.iter().map(|f| (f - e).norm().min((f + e).norm())).fold(f64::INFINITY, f64::min);
            assert!(nearest < 1e-6, "seed {seed}: {nearest}");
        }
    }

    #[test]
    fn every_solution_is_an_essential_matrix() {
        let p = scene(5, 0.0, false, 77);
        for e in five_point(&[p[0], p[1], p[2], p[3], p[4]]) {
            assert!(e.determinant().abs() < 1e-6);
            let eet = e * e.transpose();
            assert!((2.0 * eet * e - eet.trace() * e).norm() < 1e-6);
        }
    }

    #[test]
    fn cheirality_by_all_pairs_finds_the_motion() {
        let pairs = scene(50, 0.0, false, 5);
        for sign in [1.0, -1.0] {
            let (m, count) = motion_by_cheirality(&(truth().essential() * sign), &pairs).expect("decomposes");
            assert_eq!(count, 50);
            let (r, t) = errors_deg(&m);
            assert!(r < 1e-6 && t < 1e-5, "{r} {t}");
        }
    }

    #[test]
    fn robust_search_and_refinement_meet_the_truth_with_outliers() {
        let mut pairs = scene(200, 0.0005, false, 6);
        for (k, p) in pairs.iter_mut().enumerate().take(60) {
            p.second += Vector2::new(0.1, 0.05 * k as f64 / 60.0);
        }
        let found = robust_essential(&pairs, 0.002, 100, 1, 3);
        let inliers: Vec<RayPair> = pairs.iter().filter(|p| squared_sampson(&found[0], p) < 0.002_f64.powi(2)).copied().collect();
        let (m, _) = motion_by_cheirality(&found[0], &inliers).expect("decomposes");
        let (r, t) = errors_deg(&refine_motion(&m, &pairs, 0.0005, 30));
        assert!(r < 0.1 && t < 0.5, "{r} {t}");
    }

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

    #[test]
    fn a_flat_scene_keeps_the_truth_among_the_best() {
        let pairs = scene(100, 0.0003, true, 9);
        let near = robust_essential(&pairs, 0.001, 60, 20, 4).iter().any(|e| {
            motion_by_cheirality(e, &pairs).is_some_and(|(m, _)| {
                let (r, t) = errors_deg(&refine_motion(&m, &pairs, 0.0003, 30));
                r < 0.5 && t < 3.0
            })
        });
        assert!(near);
    }
}
