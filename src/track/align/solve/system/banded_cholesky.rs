//! Cholesky factorisation of a matrix whose first rows are banded, and whose last rows are full.
//!
//! Most of its work is dot products of rows. Each uses four parallel sums, which wide registers
//! hold; a single sum would wait for itself.

use crate::simd::multiversion;

/// Where the matrix is nonzero: light nodes only beside their neighbours, all other unknowns
/// everywhere.
#[derive(Debug, Clone, Copy, Default)]
pub struct Band {
    /// Rows of the whole matrix, which is stored row by row.
    pub size: usize,
    /// Number of light nodes, which come first.
    pub nodes: usize,
    /// Nodes per column of their grid.
    pub rows: usize,
}

impl Band {
    /// Returns the first column of the factor's row that may be nonzero.
    #[inline(always)]
    pub fn first(&self, row: usize) -> usize {
        if row < self.nodes { row.saturating_sub(self.rows + 1) } else { 0 }
    }
}

multiversion! {
    /// Factors a matrix in place (Cholesky), row by row, lower triangle; `None` where a direction
    /// is undetermined.
    pub fn factor(matrix: &mut [f64], band: &Band) -> Option<()>; ["avx2"] => factor_plain, else factor_plain
}

#[inline(always)]
fn factor_plain(matrix: &mut [f64], band: &Band) -> Option<()> {
    let n = band.size;
    for i in 0..n {
        let first_i = band.first(i);
        let (before, rest) = matrix.split_at_mut(i * n);
        for j in first_i..i {
            let first = first_i.max(band.first(j));
            let row_j = &before[j * n..=j * n + j];
            rest[j] = (rest[j] - dot(&rest[first..j], &row_j[first..j])) / row_j[j];
        }
        let pivot = rest[i] - dot(&rest[first_i..i], &rest[first_i..i]);
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        rest[i] = pivot.sqrt();
    }
    Some(())
}

multiversion! {
    /// Solves with the factor, in place.
    pub fn back_substitute(matrix: &[f64], band: &Band, x: &mut [f64]); ["avx2"] => back_substitute_plain, else back_substitute_plain
}

#[inline(always)]
fn back_substitute_plain(matrix: &[f64], band: &Band, x: &mut [f64]) {
    let n = band.size;
    for i in 0..n {
        let first = band.first(i);
        x[i] = (x[i] - dot(&matrix[i * n + first..i * n + i], &x[first..i])) / matrix[i * n + i];
    }
    for i in (0..n).rev() {
        x[i] /= matrix[i * n + i];
        let value = x[i];
        let first = band.first(i);
        for (x, l) in x[first..i].iter_mut().zip(&matrix[i * n + first..i * n + i]) {
            *x -= l * value;
        }
    }
}

/// Returns the dot product, in four parallel sums as wide registers hold them.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (fours_a, fours_b) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = fours_a.remainder().iter().zip(fours_b.remainder()).map(|(a, b)| a * b).sum();
    let mut sums = [0.0; 4];
    for (a, b) in fours_a.zip(fours_b) {
        for k in 0..4 {
            sums[k] += a[k] * b[k];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// A grid of nodes coupled to their neighbours, with a full end. Entries that must not be read
    /// are NaN.
    fn system(columns: usize, rows: usize, full: usize) -> (Band, Vec<f64>, DMatrix<f64>, DVector<f64>) {
        let band = Band { size: columns * rows + full, nodes: columns * rows, rows };
        let mut random = Pcg64Mcg::seed_from_u64(5);
        let mut whole = DMatrix::zeros(band.size, band.size);
        for row in 0..band.size {
            for column in band.first(row)..row {
                whole[(row, column)] = random.random_range(-1.0..1.0);
                whole[(column, row)] = whole[(row, column)];
            }
            whole[(row, row)] = 2.0 * band.size as f64;
        }
        let is_kept = |row: usize, column: usize| (band.first(row)..=row).contains(&column);
        let stored = (0..band.size * band.size).map(|k| (k / band.size, k % band.size));
        let stored = stored.map(|(row, column)| if is_kept(row, column) { whole[(row, column)] } else { f64::NAN }).collect();
        let right = DVector::from_fn(band.size, |_, _| random.random_range(-1.0..1.0));
        (band, stored, whole, right)
    }

    #[test]
    fn the_banded_solver_agrees_with_the_dense_one() {
        for (columns, rows, full) in [(1, 1, 1), (3, 2, 3), (6, 5, 20), (9, 7, 22)] {
            let (band, mut matrix, whole, right) = system(columns, rows, full);
            factor(&mut matrix, &band).expect("positive definite");
            let mut solved = right.as_slice().to_vec();
            back_substitute(&matrix, &band, &mut solved);
            let expected = whole.cholesky().expect("positive definite").solve(&right);
            let off = (DVector::from_vec(solved) - &expected).norm();
            assert!(off < 1e-12 * expected.norm(), "{columns} by {rows} and {full}: {off}");
        }
    }

    #[test]
    fn an_unconstrained_direction_has_no_factor() {
        let (band, mut matrix, ..) = system(4, 3, 5);
        let last = band.size * band.size - 1;
        matrix[last] = -1.0;
        assert_eq!(factor(&mut matrix, &band), None);
    }
}
