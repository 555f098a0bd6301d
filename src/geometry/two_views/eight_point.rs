//! Fundamental matrix from eight or more pairs by the normalised eight-point algorithm (Hartley,
//! "In defense of the eight-point algorithm", PAMI 1997).

use nalgebra::{Matrix3, SMatrix, SVector};

use super::epipolar::null_direction;
use crate::geometry::correspondence::Correspondence;
use crate::geometry::normalisation::normalising;

/// If the second smallest eigenvalue is below this fraction of the largest, more than one matrix
/// fits exactly: coplanar points, or fewer than eight distinct pairs. It is the square of a
/// deviation of 1e-7 of the picture's size. Raised, noisy data may be rejected as ambiguous.
const AMBIGUOUS: f64 = 1e-14;

/// Estimates F with `x2^T F x1 = 0`, of rank two and norm 1, by least squares of that equation over
/// weighted pairs in normalised coordinates. `None` for fewer than eight pairs or if they do not
/// determine F.
pub fn eight_point<C: Correspondence>(pairs: &[C], weights: Option<&[f64]>) -> Option<Matrix3<f64>> {
    if pairs.len() < 8 || !pairs.iter().all(Correspondence::is_usable) {
        return None;
    }
    let first = normalising(pairs.iter().map(Correspondence::first))?;
    let second = normalising(pairs.iter().map(Correspondence::second))?;
    let mut ata = SMatrix::<f64, 9, 9>::zeros();
    for (k, pair) in pairs.iter().enumerate() {
        let weight = weights.and_then(|w| w.get(k)).copied().unwrap_or(1.0);
        let (a, b) = (first * pair.first().push(1.0), second * pair.second().push(1.0));
        let row = SVector::<f64, 9>::from_fn(|k, _| b[k / 3] * a[k % 3]);
        ata.syger(weight, &row, &row, 1.0);
    }
    ata.fill_upper_triangle_with_lower_triangle();
    if !ata.iter().all(|v| v.is_finite()) {
        return None;
    }
    let eigen = ata.symmetric_eigen();
    let mut order: [usize; 9] = std::array::from_fn(|k| k);
    order.sort_by(|&i, &k| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[k]));
    if eigen.eigenvalues[order[1]] <= AMBIGUOUS * eigen.eigenvalues[order[8]] {
        return None;
    }
    let f = Matrix3::from_row_slice(eigen.eigenvectors.column(order[0]).into_owned().as_slice());
    let f = second.transpose() * of_rank_two(&f)? * first;
    let f = f / f.norm();
    f.iter().all(|v| v.is_finite()).then_some(f)
}

/// Returns the nearest matrix of rank two (Frobenius norm) by removing the smallest singular value.
/// `None` if the rank is lower.
pub fn of_rank_two(m: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let eigen = (m.transpose() * m).symmetric_eigen();
    let v = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    let flat = m - m * v * v.transpose();
    null_direction(&flat).map(|_| flat)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::geometry::distances::squared_sampson;
    use crate::geometry::homography::PointPair;
    use crate::geometry::test_planes;
    use crate::geometry::test_views::{pixels, scene, true_fundamental};

    #[test]
    fn exact_pairs_give_the_exact_matrix() {
        for n in [8, 9, 50] {
            let f = eight_point(&pixels(&scene(n, 0.0, false, n as u64)), None).expect("regular");
            let truth = true_fundamental();
            assert!((f - truth).norm().min((f + truth).norm()) < 1e-7, "{n}: {f} {truth}");
            assert!(f.determinant().abs() < 1e-15);
        }
    }

    #[test]
    fn noise_is_averaged_and_rank_two_enforced() {
        let pairs = pixels(&scene(300, 0.001, false, 3));
        let f = eight_point(&pairs, None).expect("regular");
        let mean = pairs.iter().map(|p| squared_sampson(&f, p)).sum::<f64>() / pairs.len() as f64;
        // The noise is uniform over ±0.8 px in each coordinate, 0.46 px rms.
        assert!(mean.sqrt() < 0.5, "{mean}");
        assert!(null_direction(&f).is_some_and(|e| (f * e).norm() < 1e-12));
    }

    #[test]
    fn a_zero_weight_excludes_a_pair() {
        let mut pairs = pixels(&scene(30, 0.0, false, 4));
        pairs[7].to += Vector2::new(50.0, 80.0);
        let weights: Vec<f64> = (0..30).map(|k| if k == 7 { 0.0 } else { 1.0 + k as f64 }).collect();
        let f = eight_point(&pairs, Some(&weights)).expect("regular");
        assert!(pairs.iter().enumerate().all(|(k, p)| k == 7 || squared_sampson(&f, p) < 1e-12));
    }

    #[test]
    fn degenerate_pairs_yield_no_matrix() {
        let pairs = pixels(&scene(30, 0.0, false, 5));
        assert_eq!(eight_point(&pairs[..7], None), None);
        assert_eq!(eight_point(&[pairs[0]; 12], None), None);
        assert_eq!(eight_point(&[&pairs[..7], &pairs[..5]].concat(), None), None);
        assert_eq!(eight_point(&test_planes::pairs(20, 0.0), None), None, "one plane");
        let broken = PointPair { from: Vector2::new(f64::NAN, 0.0), to: Vector2::zeros() };
        assert_eq!(eight_point(&[&pairs[..], &[broken]].concat(), None), None);
    }
}
