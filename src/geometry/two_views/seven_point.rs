//! Seven-point solver of the fundamental matrix (Hartley and Zisserman, "Multiple View Geometry",
//! section 11.1.2): seven equations leave a pencil of matrices, of which one or three have a
//! vanishing determinant.

use nalgebra::{Matrix3, SVector};

use super::epipolar::null_direction;
use crate::geometry::correspondence::Correspondence;
use crate::geometry::normalisation::normalising;

/// A pivot below this fraction of the first means dependent equations: a repeated pair, or a sample
/// that leaves more than a pencil. Raised, more samples are rejected.
const DEPENDENT: f64 = 1e-10;
/// If the determinant is at most this for matrices of norm 1, the whole pencil is singular and
/// nothing is determined. Raised, more samples are rejected.
const ALL_SINGULAR: f64 = 1e-12;

/// Returns all F of rank two (norm 1) with `x2^T F x1 = 0` for seven pairs: one to three, or none
/// for a degenerate sample.
pub fn seven_point<C: Correspondence>(pairs: &[C; 7]) -> Vec<Matrix3<f64>> {
    solved(pairs).unwrap_or_default()
}

fn solved<C: Correspondence>(pairs: &[C; 7]) -> Option<Vec<Matrix3<f64>>> {
    if !pairs.iter().all(Correspondence::is_usable) {
        return None;
    }
    let first = normalising(pairs.iter().map(Correspondence::first))?;
    let second = normalising(pairs.iter().map(Correspondence::second))?;
    let rows = std::array::from_fn(|k| {
        let (a, b) = (first * pairs[k].first().push(1.0), second * pairs[k].second().push(1.0));
        std::array::from_fn(|j| b[j / 3] * a[j % 3])
    });
    let [f, g] = pencil(null_space(rows)?)?;
    let f = roots(determinants(&f, &g)).into_iter().filter_map(|z| {
        let m = second.transpose() * (f + g * z) * first;
        let m = m / m.norm();
        (m.iter().all(|v| v.is_finite()) && null_direction(&m).is_some()).then_some(m)
    });
    Some(f.collect())
}

/// Returns two orthonormal directions orthogonal to all rows, by Gaussian elimination with full
/// pivoting. `None` if there are more.
fn null_space(mut rows: [[f64; 9]; 7]) -> Option<[Matrix3<f64>; 2]> {
    let mut columns: [usize; 9] = std::array::from_fn(|k| k);
    let mut first_pivot = 0.0;
    for k in 0..7 {
        let rest = (k..7).flat_map(|r| (k..9).map(move |c| (r, c)));
        let (r, c) = rest.max_by(|&(r, c), &(s, d)| rows[r][columns[c]].abs().total_cmp(&rows[s][columns[d]].abs()))?;
        rows.swap(k, r);
        columns.swap(k, c);
        let pivot = rows[k][columns[k]];
        first_pivot = f64::max(first_pivot, pivot.abs());
        if pivot.is_nan() || pivot.abs() <= DEPENDENT * first_pivot {
            return None;
        }
        let chosen = rows[k].map(|v| v / pivot);
        rows[k] = chosen;
        for (_, row) in rows.iter_mut().enumerate().filter(|(r, _)| *r != k) {
            let factor = row[columns[k]];
            for (v, p) in row.iter_mut().zip(&chosen) {
                *v -= factor * p;
            }
        }
    }
    let direction = |free: usize| {
        let mut v = SVector::<f64, 9>::zeros();
        v[columns[free]] = 1.0;
        for (k, row) in rows.iter().enumerate() {
            v[columns[k]] = -row[columns[free]];
        }
        v
    };
    let a = direction(7).normalize();
    let b = direction(8);
    let b = (b - a * a.dot(&b)).normalize();
    Some([a, b].map(|v| Matrix3::from_row_slice(v.as_slice())))
}

/// Returns two matrices f, g of the same pencil with g far from singular: then every singular one
/// is f + z g with a root z of moderate size.
fn pencil([a, b]: [Matrix3<f64>; 2]) -> Option<[Matrix3<f64>; 2]> {
    // At most three angles are singular, so one of these four is at least a quarter of their
    // spacing away.
    let rotated = [0.0_f64, 45.0, 90.0, 135.0].map(|angle| {
        let (s, c) = angle.to_radians().sin_cos();
        [a * c + b * s, b * c - a * s]
    });
    let best = rotated.into_iter().max_by(|p, q| p[1].determinant().abs().total_cmp(&q[1].determinant().abs()))?;
    (best[1].determinant().abs() > ALL_SINGULAR).then_some(best)
}

/// Returns det(f + z g) as a polynomial in z, lowest power first.
fn determinants(f: &Matrix3<f64>, g: &Matrix3<f64>) -> [f64; 4] {
    let column = |m: &Matrix3<f64>, k: usize| m.column(k).into_owned();
    // The determinant with some of f's columns replaced by g's.
    let mixed = |of_g: [bool; 3]| {
        let c = [0, 1, 2].map(|k| column(if of_g[k] { g } else { f }, k));
        c[0].dot(&c[1].cross(&c[2]))
    };
    [
        f.determinant(),
        mixed([true, false, false]) + mixed([false, true, false]) + mixed([false, false, true]),
        mixed([true, true, false]) + mixed([true, false, true]) + mixed([false, true, true]),
        g.determinant(),
    ]
}

/// Returns the real roots of a cubic (lowest power first, the highest not 0), by Viète's and
/// Cardano's formulas and two Newton steps. A double root is returned twice, or not at all if
/// rounding has moved it off the real axis.
fn roots([d, c, b, a]: [f64; 4]) -> Vec<f64> {
    let (b, c, d) = (b / a, c / a, d / a);
    // z = t - b / 3 turns it into t³ + p t + q.
    let p = c - b * b / 3.0;
    let q = 2.0 * b.powi(3) / 27.0 - b * c / 3.0 + d;
    let discriminant = (q / 2.0).powi(2) + (p / 3.0).powi(3);
    let depressed = if discriminant < 0.0 {
        let r = (-p / 3.0).sqrt();
        let angle = (-q / (2.0 * r.powi(3))).clamp(-1.0, 1.0).acos() / 3.0;
        [0.0, 1.0, 2.0].map(|k| 2.0 * r * (angle - k * std::f64::consts::TAU / 3.0).cos()).to_vec()
    } else {
        // Compute the larger of the two summands first, to avoid cancellation.
        let u = -q.signum() * (q.abs() / 2.0 + discriminant.sqrt()).cbrt();
        vec![if u == 0.0 { 0.0 } else { u - p / (3.0 * u) }]
    };
    let polished = depressed.into_iter().map(|t| {
        let mut z = t - b / 3.0;
        for _ in 0..2 {
            let step = (((z + b) * z + c) * z + d) / ((3.0 * z + 2.0 * b) * z + c);
            if step.is_finite() && step.abs() < 0.1 * (1.0 + z.abs()) {
                z -= step;
            }
        }
        z
    });
    polished.filter(|z| z.is_finite()).collect()
}

/// Whether all pairs of a sample can be in front of both cameras that F describes: e2 x x2 and F x1
/// are the same line, and must point the same way for all pairs or the opposite way for all (Chum,
/// Werner and Matas, "Epipolar geometry estimation via RANSAC benefits from the oriented epipolar
/// constraint", ICPR 2004).
pub fn is_oriented<C: Correspondence>(f: &Matrix3<f64>, sample: &[C]) -> bool {
    let Some(epipole) = null_direction(&f.transpose()) else { return false };
    let side = |p: &C| epipole.cross(&p.second().push(1.0)).dot(&(f * p.first().push(1.0)));
    sample.iter().all(|p| side(p) > 0.0) || sample.iter().all(|p| side(p) < 0.0)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use proptest::prelude::*;

    use super::*;
    use crate::geometry::homography::PointPair;
    use crate::geometry::test_planes;
    use crate::geometry::test_views::{pixels, scene, true_fundamental};

    fn seven(pairs: &[PointPair]) -> [PointPair; 7] {
        std::array::from_fn(|k| pairs[k])
    }

    #[test]
    fn seven_exact_pairs_contain_the_truth() {
        let (mut counts, truth) = ([0; 4], true_fundamental());
        for seed in 0..200 {
            let sample = seven(&pixels(&scene(7, 0.0, false, seed)));
            let found = seven_point(&sample);
            let nearest = found.iter().min_by(|f, g| away(f, &truth).total_cmp(&away(g, &truth))).expect("one at least");
            assert!(away(nearest, &truth) < 1e-5, "seed {seed}: {}", away(nearest, &truth));
            assert!(is_oriented(nearest, &sample), "seed {seed}");
            counts[found.len()] += 1;
        }
        assert!(counts[1] > 20 && counts[3] > 20, "{counts:?}");
    }

    fn away(f: &Matrix3<f64>, truth: &Matrix3<f64>) -> f64 {
        (f - truth).norm().min((f + truth).norm())
    }

    #[test]
    fn degenerate_samples_give_none() {
        let pairs = pixels(&scene(7, 0.0, false, 1));
        let mut twice = seven(&pairs);
        twice[6] = twice[2];
        assert!(seven_point(&twice).is_empty());
        assert!(seven_point(&[pairs[0]; 7]).is_empty());
        assert!(seven_point(&seven(&test_planes::pairs(7, 0.0))).is_empty(), "one plane");
        let line = std::array::from_fn(|k| PointPair { from: Vector2::new(k as f64, 1.0), to: Vector2::new(k as f64, 2.0) });
        assert!(seven_point(&line).is_empty());
        for bad in [f64::NAN, f64::INFINITY, 1e300] {
            let mut broken = seven(&pairs);
            broken[3].to.x = bad;
            assert!(seven_point(&broken).is_empty());
        }
    }

    #[test]
    fn cubic_roots_are_recovered() {
        for expected in [[-3.0, 0.5, 7.0], [-1e-3, 1e-3, 2.0], [-100.0, 0.0, 0.01]] {
            let [x, y, z] = expected;
            let mut found = roots([-x * y * z * 2.0, (x * y + x * z + y * z) * 2.0, -(x + y + z) * 2.0, 2.0]);
            found.sort_by(f64::total_cmp);
            assert!(found.len() == 3 && found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
        }
        // (z - 2)(z² + 1), and a triple root.
        assert!(matches!(roots([-2.0, 1.0, -2.0, 1.0])[..], [z] if (z - 2.0).abs() < 1e-12));
        assert!(roots([0.0, 0.0, 0.0, 1.0]).iter().all(|z| *z == 0.0));
    }

    proptest! {
        /// For any seven pairs: there are at most three solutions, and each fits all pairs and is
        /// singular.
        #[test]
        fn every_solution_meets_its_pairs(numbers in proptest::collection::vec(-500.0..500.0_f64, 28)) {
            let sample: [PointPair; 7] = std::array::from_fn(|k| PointPair {
                from: Vector2::new(numbers[4 * k], numbers[4 * k + 1]),
                to: Vector2::new(numbers[4 * k + 2], numbers[4 * k + 3]),
            });
            let found = seven_point(&sample);
            prop_assert!(found.len() == 1 || found.len() == 3 || found.len() == 2, "{}", found.len());
            for f in &found {
                prop_assert!(sample.iter().all(|p| crate::geometry::distances::squared_sampson(f, p) < 1e-8));
            }
        }
    }
}
