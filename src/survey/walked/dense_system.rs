//! The large dense systems of a survey, solved by `faer` in cache-sized blocks.
//!
//! A set of fifteen panels has 2000 unknowns, and dozens of such systems are solved while the
//! smoothness is chosen. There nalgebra's factorisation takes eight times as long, and its inverse
//! sixty times.

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::solvers::{DenseSolveCore, Llt, Solve};
use faer::{Accum, MatMut, MatRef, Par, Side};
use nalgebra::{DMatrix, DVector};

/// Subtracts the square of `root`, R Rᵀ, from the lower triangle of a matrix (a symmetric rank-k
/// update).
pub fn subtract_square(matrix: &mut DMatrix<f64>, root: &DMatrix<f64>) {
    let n = matrix.nrows();
    let root = MatRef::from_column_major_slice(root.as_slice(), n, root.ncols());
    let lower = MatMut::from_column_major_slice_mut(matrix.as_mut_slice(), n, n);
    let whole = BlockStructure::Rectangular;
    triangular::matmul(lower, BlockStructure::TriangularLower, Accum::Add, root, whole, root.transpose(), whole, -1.0, Par::Seq);
}

/// The factor L of a symmetric positive definite matrix A = L Lᵀ.
pub struct Factor(Llt<f64>);

impl Factor {
    /// Factorises a matrix, of which only the lower triangle is read. `None` if it is not positive
    /// definite.
    pub fn of(matrix: &DMatrix<f64>) -> Option<Self> {
        let view = MatRef::from_column_major_slice(matrix.as_slice(), matrix.nrows(), matrix.ncols());
        view.llt(Side::Lower).ok().map(Self)
    }

    /// Returns the solution x of A x = `right`.
    pub fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        let solution = self.0.solve(MatRef::from_column_major_slice(right.as_slice(), right.len(), 1));
        DVector::from_fn(right.len(), |i, _| solution[(i, 0)])
    }

    /// Returns the full inverse of the matrix.
    pub fn inverse(&self) -> DMatrix<f64> {
        let inverse = self.0.inverse();
        DMatrix::from_fn(inverse.nrows(), inverse.ncols(), |i, j| inverse[(i, j)])
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    fn positive_definite(n: usize, random: &mut Pcg64Mcg) -> DMatrix<f64> {
        let root = DMatrix::from_fn(n, n, |_, _| random.random_range(-1.0..1.0));
        &root * root.transpose() + DMatrix::identity(n, n)
    }

    #[test]
    fn the_dense_solver_agrees_with_nalgebra() {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        for n in [1, 2, 7, 64, 200] {
            let matrix = positive_definite(n, &mut random);
            let right = DVector::from_fn(n, |_, _| random.random_range(-1.0..1.0));
            let (oracle, factor) = (matrix.clone().cholesky().unwrap(), Factor::of(&matrix).unwrap());
            let [solution, inverse] = [(factor.solve(&right) - oracle.solve(&right)).amax(), (factor.inverse() - oracle.inverse()).amax()];
            assert!(solution < 1e-11 && inverse < 1e-11, "{n}: {solution} {inverse}");
        }
    }

    #[test]
    fn a_square_is_subtracted_from_the_lower_triangle_only() {
        let mut random = Pcg64Mcg::seed_from_u64(4);
        for (n, columns) in [(1, 1), (9, 4), (70, 200), (5, 0)] {
            let before = positive_definite(n, &mut random);
            let root = DMatrix::from_fn(n, columns, |_, _| random.random_range(-1.0..1.0));
            let (mut after, oracle) = (before.clone(), &before - &root * root.transpose());
            subtract_square(&mut after, &root);
            assert!((after.lower_triangle() - oracle.lower_triangle()).amax() < 1e-12, "{n} {columns}");
            assert!((0..n).all(|j| (0..j).all(|i| after[(i, j)] == before[(i, j)])), "{n} {columns}");
        }
    }

    #[test]
    fn only_the_lower_triangle_is_read() {
        let matrix = positive_definite(20, &mut Pcg64Mcg::seed_from_u64(2));
        let mut lower = matrix.clone();
        lower.fill_upper_triangle(f64::NAN, 1);
        let [whole, half] = [matrix, lower].map(|m| Factor::of(&m).unwrap().inverse());
        assert_eq!(whole, half);
        assert_eq!(whole, whole.transpose());
    }

    #[test]
    fn a_matrix_that_is_not_positive_definite_has_no_factor() {
        let mut matrix = positive_definite(30, &mut Pcg64Mcg::seed_from_u64(3));
        matrix[(17, 17)] = -1.0;
        assert!(Factor::of(&matrix).is_none());
        matrix[(17, 17)] = f64::NAN;
        assert!(Factor::of(&matrix).is_none());
    }
}
