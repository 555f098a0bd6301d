//! Homography from many pairs by the normalised direct linear transformation (Hartley and
//! Zisserman, "Multiple View Geometry", algorithm 4.2).

use nalgebra::{Matrix3, SMatrix, SVector};

use super::homography::{Homography, PointPair};
use super::normalisation::normalising;

impl Homography {
    /// Estimates the homography by the normalised direct linear transformation over weighted pairs
    /// (Hartley & Zisserman, algorithm 4.2). `None` for fewer than four pairs or degenerate ones.
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::test_planes::{corner_error, pairs};

    #[test]
    fn linear_solution_is_exact_without_noise() {
        let h = Homography::from_pairs(&pairs(20, 0.0), None).expect("regular");
        assert!(corner_error(&h) < 1e-6);
    }
}
