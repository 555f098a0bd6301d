//! Triangulation: a point's depths in two cameras.

use nalgebra::{Matrix2, Vector2};
#[cfg(feature = "cli")]
use nalgebra::{Matrix3, Vector3};

use super::relative_pose::{RayPair, TwoViewMotion};

/// Computes the depths along both optical axes, in units of the baseline, by least squares on
/// `d2 x2 = d1 R x1 + t`; `None` for parallel rays.
pub fn depths(motion: &TwoViewMotion, pair: &RayPair) -> Option<(f64, f64)> {
    let a = motion.rotation * pair.first.push(1.0);
    let b = pair.second.push(1.0);
    let normal = Matrix2::new(a.dot(&a), -a.dot(&b), -a.dot(&b), b.dot(&b));
    let right = Vector2::new(-a.dot(&motion.direction), b.dot(&motion.direction));
    // The determinant is |a|²|b|² sin² of the parallax; below this the depth is noise.
    if normal.determinant() < 1e-12 * a.norm_squared() * b.norm_squared() {
        return None;
    }
    let d = normal.try_inverse()? * right;
    Some((d.x, d.y))
}

/// Returns the point with the least sum of squared distances from some rays, each an origin and a
/// direction of unit length; `None` for parallel ones.
#[cfg(feature = "cli")]
pub fn nearest_to_rays(rays: impl IntoIterator<Item = (Vector3<f64>, Vector3<f64>)>) -> Option<Vector3<f64>> {
    let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (origin, along) in rays {
        let across = Matrix3::identity() - along * along.transpose();
        matrix += across;
        right += across * origin;
    }
    matrix.try_inverse().map(|inverse| inverse * right).filter(|place| place.iter().all(|v| v.is_finite()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    #[test]
    fn depths_of_a_known_point() {
        let motion = TwoViewMotion {
            rotation: UnitQuaternion::from_euler_angles(0.1, 0.2, -0.1),
            direction: Vector3::new(1.0, 0.0, 0.2).normalize(),
        };
        let p = Vector3::new(0.4, -0.3, 7.0);
        let q = motion.rotation * p + motion.direction;
        let (d1, d2) = depths(&motion, &RayPair { first: p.xy() / p.z, second: q.xy() / q.z }).expect("parallax");
        assert!((d1 - 7.0).abs() < 1e-9 && (d2 - q.z).abs() < 1e-9);
    }

    #[test]
    fn parallel_rays_have_no_depth() {
        let motion = TwoViewMotion { rotation: UnitQuaternion::identity(), direction: Vector3::x() };
        let x = nalgebra::Vector2::new(0.1, 0.1);
        assert!(depths(&motion, &RayPair { first: x, second: x }).is_none());
    }
}
