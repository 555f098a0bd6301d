//! Epipoles and epipolar lines.

use nalgebra::{Matrix3, Vector2, Vector3};

/// Distance, in the coordinates' unit, beyond which an epipole is reported as a direction. Lines
/// through a picture to a point ten million pixels away are parallel to a ten-thousandth of a
/// pixel, and the point itself is rounding noise.
const FARTHEST: f64 = 1e7;

/// Image of the other camera's centre in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Epipole {
    /// A point, inside the picture or not.
    At(Vector2<f64>),
    /// A point at infinity, in this or the opposite direction (unit length): the camera moved
    /// perpendicular to its line of sight.
    Towards(Vector2<f64>),
}

/// Computes the epipoles in the first picture (F e1 = 0) and in the second (F^T e2 = 0); `None` if
/// the rank is below two.
pub fn epipoles(f: &Matrix3<f64>) -> Option<[Epipole; 2]> {
    Some([null_direction(f)?, null_direction(&f.transpose())?].map(|e| {
        let at = e.xy() / e.z;
        // NaN if e.z is 0: then the comparison fails as well.
        if at.norm() <= FARTHEST { Epipole::At(at) } else { Epipole::Towards(e.xy().normalize()) }
    }))
}

/// Returns the unit null vector of a matrix of rank two: the cross product of its two least
/// parallel rows. `None` for rank one.
pub fn null_direction(m: &Matrix3<f64>) -> Option<Vector3<f64>> {
    let rows = [0, 1, 2].map(|k| m.row(k).transpose());
    let across = [(0, 1), (0, 2), (1, 2)].map(|(i, k)| rows[i].cross(&rows[k]));
    let longest = across.into_iter().max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))?;
    longest.try_normalize(1e-14 * m.norm_squared()).filter(|n| n.iter().all(|v| v.is_finite()))
}

/// Returns the epipolar line in the second picture of a point in the first: `a x + b y + c = 0`, as
/// (a, b, c). Use F^T for the reverse.
pub fn epipolar_line(f: &Matrix3<f64>, point: Vector2<f64>) -> Vector3<f64> {
    f * point.push(1.0)
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::geometry::skew;

    #[test]
    fn epipoles_are_the_images_of_the_other_camera() {
        let r = UnitQuaternion::from_euler_angles(0.1, -0.3, 0.2);
        let t = Vector3::new(0.2, -0.1, 0.9);
        let e = skew(&t) * r.to_rotation_matrix().into_inner();
        // The first camera's centre in the second is t; the second's in the first is -R^T t.
        let other = r.inverse() * -t;
        let [Epipole::At(first), Epipole::At(second)] = epipoles(&e).expect("rank 2") else { panic!("both are finite") };
        assert!((first - other.xy() / other.z).norm() < 1e-9 && (second - t.xy() / t.z).norm() < 1e-9);
    }

    #[test]
    fn a_sideways_move_has_its_epipoles_at_infinity() {
        let both = epipoles(&skew(&Vector3::new(3.0, 4.0, 0.0))).expect("rank 2");
        for epipole in both {
            let Epipole::Towards(d) = epipole else { panic!("{epipole:?}") };
            assert!((d.perp(&Vector2::new(0.6, 0.8))).abs() < 1e-12 && (d.norm() - 1.0).abs() < 1e-12);
        }
        let rank_one = Vector3::new(1.0, 2.0, 3.0) * Vector3::new(0.5, 1.0, -1.0).transpose();
        assert_eq!(epipoles(&rank_one), None);
        assert_eq!(epipoles(&Matrix3::zeros()), None);
        assert_eq!(epipoles(&Matrix3::repeat(f64::NAN)), None);
    }
}
