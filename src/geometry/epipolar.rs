//! Epipoles, and the visible part of epipolar lines.

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

/// Converts an essential matrix to the fundamental matrix for pixels of these cameras (first,
/// second; K maps normalised points to pixels): K2⁻ᵀ E K1⁻¹.
pub fn in_pixels(e: &Matrix3<f64>, [first, second]: [&Matrix3<f64>; 2]) -> Option<Matrix3<f64>> {
    let f = second.try_inverse()?.transpose() * e * first.try_inverse()?;
    f.iter().all(|v| v.is_finite()).then_some(f)
}

/// Returns the epipolar line in the second picture of a point in the first: `a x + b y + c = 0`, as
/// (a, b, c). Use F^T for the reverse.
pub fn epipolar_line(f: &Matrix3<f64>, point: Vector2<f64>) -> Vector3<f64> {
    f * point.push(1.0)
}

/// Clips a line to a picture of this width and height (pixel centres at integers, so from -0.5 to
/// width - 0.5); `None` if it misses the picture.
pub fn clipped(line: &Vector3<f64>, [width, height]: [u32; 2]) -> Option<[Vector2<f64>; 2]> {
    let across = line.xy().norm();
    let along = Vector2::new(-line.y, line.x) / across;
    // Working from the line's point nearest to the picture's centre keeps the numbers small.
    let middle = Vector2::new(0.5 * (f64::from(width) - 1.0), 0.5 * (f64::from(height) - 1.0));
    let foot = middle - line.xy() / across * ((line.xy().dot(&middle) + line.z) / across);
    let (mut from, mut to) = (f64::NEG_INFINITY, f64::INFINITY);
    for (k, size) in [width, height].into_iter().enumerate() {
        let (low, high) = (-0.5 - foot[k], f64::from(size) - 0.5 - foot[k]);
        if along[k] == 0.0 {
            if low > 0.0 || high < 0.0 {
                return None;
            }
            continue;
        }
        let (enter, leave) = (low / along[k], high / along[k]);
        (from, to) = (from.max(enter.min(leave)), to.min(enter.max(leave)));
    }
    let ends = [foot + along * from, foot + along * to];
    (from <= to && ends.iter().flatten().all(|v| v.is_finite())).then_some(ends)
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;

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

    #[test]
    fn epipolar_lines_are_clipped_at_the_picture_edges() {
        // y = 3 over a 10 x 5 picture.
        let [a, b] = clipped(&Vector3::new(0.0, 2.0, -6.0), [10, 5]).expect("crosses");
        assert!((a.x - b.x).abs() == 10.0 && a.y == 3.0 && b.y == 3.0 && a.x.min(b.x) == -0.5);
        assert_eq!(clipped(&Vector3::new(0.0, 1.0, -5.0), [10, 5]), None);
        for none in [Vector3::zeros(), Vector3::z(), Vector3::repeat(f64::NAN)] {
            assert_eq!(clipped(&none, [10, 5]), None);
        }
        assert_eq!(clipped(&Vector3::new(1.0, 0.0, 0.0), [1, 1]).map(|ends| ends[0].x), Some(0.0));
    }

    proptest! {
        /// Clipped segments lie on the line and in the picture; lines without one miss the picture.
        #[test]
        fn a_clipped_line_lies_on_the_line_within_the_picture(angle in 0.0..6.3_f64, offset in -900.0..900.0_f64, scale in 1e-3..1e3_f64, w in 1..800_u32, h in 1..600_u32) {
            let line = Vector3::new(angle.cos(), angle.sin(), offset) * scale;
            let inside = |p: Vector2<f64>, slack: f64| {
                p.x > -0.5 - slack && p.y > -0.5 - slack && p.x < f64::from(w) - 0.5 + slack && p.y < f64::from(h) - 0.5 + slack
            };
            match clipped(&line, [w, h]) {
                Some(ends) => for p in ends {
                    prop_assert!(line.dot(&p.push(1.0)).abs() < 1e-8 * scale && inside(p, 1e-8));
                },
                None => {
                    let corners = [(-0.5, -0.5), (f64::from(w) - 0.5, -0.5), (-0.5, f64::from(h) - 0.5), (f64::from(w) - 0.5, f64::from(h) - 0.5)];
                    let sides = corners.map(|(x, y)| line.dot(&Vector3::new(x, y, 1.0)) / scale);
                    prop_assert!(sides.iter().all(|s| *s > -1e-9) || sides.iter().all(|s| *s < 1e-9));
                }
            }
        }
    }
}
