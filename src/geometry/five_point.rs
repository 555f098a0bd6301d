//! Five-point solver for the essential matrix (Nistér, "An efficient solution to the five-point
//! relative pose problem", PAMI 2004).

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::relative_pose::RayPair;

/// Returns all essential matrices (at most ten) that five pairs satisfy.
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

/// Index of a monomial of degree <= 3 in x, y, z, in the order that Nistér's elimination needs.
fn monomial_index([x, y, z]: [usize; 3]) -> usize {
    // Exponents of x, y and z: first the ten that are eliminated, then those that form the
    // polynomial in z (Nistér 2004).
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
    // The table contains every product of three linear forms.
    ORDER.iter().position(|m| *m == [x, y, z]).unwrap_or(19)
}

/// Builds the ten cubic constraints on E = xX + yY + zZ + W (det E = 0 and 2 E E^T E = tr(E E^T)
/// E), eliminates the first ten monomials to the identity, and returns the remaining ten columns.
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

/// Row k of the 3x3 matrix B(z): [x-coefficient, y-coefficient, rest], from e - z f of Nistér's
/// table.
fn row_of(r: &SMatrix<f64, 10, 10>, e: usize, f: usize) -> [Polynomial; 3] {
    let (e, f) = (r.row(e), r.row(f));
    let part = |from: usize, n: usize| -> Polynomial {
        // Columns hold descending powers z^(n-1) .. z^0: reverse them, then subtract z times the
        // other row.
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
            // The null vector of B(z) is (x, y, 1): compute it from the best-conditioned pair of
            // rows.
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

/// Finds the real roots of a polynomial of degree ten (lowest power first): eigenvalues of the
/// companion matrix, polished by Newton's method.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::test_views::{scene, truth};

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
}
