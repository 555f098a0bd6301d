//! Plane-to-plane maps. Their estimators are in separate files: four points, direct linear,
//! transfer refinement, gold standard.

use nalgebra::{Matrix3, Vector2};

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
    /// Maps a point; `None` on or beyond the horizon (third coordinate not positive).
    pub fn map(&self, p: Vector2<f64>) -> Option<Vector2<f64>> {
        let v = self.0 * p.push(1.0);
        (v.z > 1e-12).then(|| Vector2::new(v.x / v.z, v.y / v.z))
    }

    /// Whether the map keeps the sense of rotation, as every view of a picture's front does; a
    /// mirror image reverses it.
    pub fn keeps_orientation(&self) -> bool {
        // The Jacobian's determinant is det(H) / z^3, and z > 0 for every point that can be mapped.
        self.0.determinant() > 0.0
    }

    /// Returns the squared transfer error of a pair in the second plane; infinite beyond the
    /// horizon.
    pub fn squared_error(&self, pair: &PointPair) -> f64 {
        self.map(pair.from).map_or(f64::INFINITY, |q| (q - pair.to).norm_squared())
    }

    /// Returns the matrix scaled so that h33 = 1; `None` if h33 is 0.
    pub fn with_unit_h33(&self) -> Option<Matrix3<f64>> {
        let scaled = self.0 / self.0[(2, 2)];
        scaled.iter().all(|v| v.is_finite()).then_some(scaled)
    }

    /// Returns the inverse map; `None` if the matrix is singular.
    pub fn inverse(&self) -> Option<Self> {
        // A point in front stays in front: H⁻¹ (z x2) = x1 with the same positive z.
        let inverse = self.0.try_inverse()?;
        inverse.iter().all(|v| v.is_finite()).then_some(Self(inverse))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_homography_and_its_inverse_round_trip_in_front() {
        let h = Homography(Matrix3::new(0.8, 0.1, 120.0, -0.05, 0.9, 60.0, 1e-4, -2e-4, 1.0));
        let back = h.inverse().expect("regular");
        for (x, y) in [(0.0, 0.0), (640.0, 0.0), (640.0, 480.0), (31.5, 470.25)] {
            let p = Vector2::new(x, y);
            let there = h.map(p).expect("in front");
            assert!((back.map(there).expect("in front") - p).norm() < 1e-9);
        }
        assert_eq!(Homography(Matrix3::zeros()).inverse(), None);
    }

    /// Thesis error E5: the third coordinate is the signed depth, not "any large-scale
    /// coefficient".
    #[test]
    fn e5_what_lies_behind_the_horizon_has_no_image() {
        let h = Homography(Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -0.01, 0.0, 1.0));
        assert!(h.map(Vector2::new(99.0, 0.0)).is_some());
        assert_eq!(h.map(Vector2::new(100.0, 0.0)), None);
        assert_eq!(h.map(Vector2::new(101.0, 0.0)), None);
    }
}
