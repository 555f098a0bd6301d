//! Homography from exactly four pairs.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::homography::{Homography, PointPair};

impl Homography {
    /// Computes the exact map through four pairs, no three of them collinear (Heckbert's
    /// square-to-quad construction, twice).
    ///
    /// `None` for degenerate samples or ones of mixed orientation. Every triangle of the four
    /// points must keep its orientation in both pictures, or every one must reverse it; otherwise
    /// no view of a plane can have produced them.
    pub fn from_four(pairs: &[PointPair; 4]) -> Option<Self> {
        if !consistent_orientation(pairs) {
            return None;
        }
        let from = basis_map(&pairs.map(|p| p.from))?;
        let to = basis_map(&pairs.map(|p| p.to))?;
        let h = to * from.try_inverse()?;
        let scale = h.norm();
        // All four points must be on the same side of the horizon; choose the sign that makes it
        // the front.
        let sign = (h * pairs[0].from.push(1.0)).z.signum();
        let h = h * (sign / scale);
        let finite = h.iter().all(|v| v.is_finite());
        let front = pairs.iter().all(|p| (h * p.from.push(1.0)).z > 0.0);
        (finite && front).then_some(Self(h))
    }
}

/// Maps the projective basis to four points (columns scaled so that they add up to the fourth).
fn basis_map(p: &[Vector2<f64>; 4]) -> Option<Matrix3<f64>> {
    let m = Matrix3::from_columns(&[p[0].push(1.0), p[1].push(1.0), p[2].push(1.0)]);
    let c: Vector3<f64> = m.try_inverse()? * p[3].push(1.0);
    let m = Matrix3::from_columns(&[m.column(0) * c.x, m.column(1) * c.y, m.column(2) * c.z]);
    (c.x != 0.0 && c.y != 0.0 && c.z != 0.0).then_some(m)
}

fn orientation(a: Vector2<f64>, b: Vector2<f64>, c: Vector2<f64>) -> f64 {
    (b - a).perp(&(c - a))
}

/// Whether every triangle of the sample keeps its orientation, or every one reverses it.
fn consistent_orientation(p: &[PointPair; 4]) -> bool {
    let product = |i: usize, j: usize, k: usize| orientation(p[i].from, p[j].from, p[k].from) * orientation(p[i].to, p[j].to, p[k].to);
    let signs = [product(0, 1, 2), product(0, 1, 3), product(0, 2, 3), product(1, 2, 3)];
    signs.iter().all(|s| *s > 0.0) || signs.iter().all(|s| *s < 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::test_planes::{corner_error, pairs};

    #[test]
    fn a_homography_of_four_points_fits_them_exactly() {
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
}
