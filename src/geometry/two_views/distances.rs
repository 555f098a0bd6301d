//! Further distances of a correspondence from a two-view relation, in the units of its coordinates
//! (e.g. pixels).
//!
//! Relations are `x2^T F x1 = 0` (F: fundamental for pixels, essential for normalised points) and
//! `x2 ∝ H x1`. All distances are squared, as costs need them. Source: Hartley and Zisserman,
//! "Multiple View Geometry", chapters 4 and 11.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::geometry::correspondence::Correspondence;
use crate::geometry::homography::Homography;

/// Computes the squared distances of the first point from the second's epipolar line and of the
/// second from the first's. Infinite at an epipole, which has no line.
pub fn squared_epipolar<C: Correspondence>(f: &Matrix3<f64>, pair: &C) -> [f64; 2] {
    let (a, b) = (pair.first().push(1.0), pair.second().push(1.0));
    let (line_in_second, line_in_first) = (f * a, f.transpose() * b);
    let c2 = b.dot(&line_in_second).powi(2);
    [line_in_first, line_in_second].map(|line: Vector3<f64>| {
        let d = c2 / line.xy().norm_squared();
        if d.is_nan() { f64::INFINITY } else { d }
    })
}

/// Computes the squared symmetric epipolar distance: the sum of both one-sided ones.
pub fn squared_symmetric_epipolar<C: Correspondence>(f: &Matrix3<f64>, pair: &C) -> f64 {
    squared_epipolar(f, pair).iter().sum()
}

/// Computes the squared symmetric transfer distance: H x1 from x2 plus H⁻¹ x2 from x1. Infinite
/// beyond a horizon and if H is singular.
pub fn squared_symmetric_transfer<C: Correspondence>(h: &Homography, pair: &C) -> f64 {
    let Some(back) = h.inverse() else { return f64::INFINITY };
    let there = h.map(pair.first()).map_or(f64::INFINITY, |q| (q - pair.second()).norm_squared());
    let and_back = back.map(pair.second()).map_or(f64::INFINITY, |q| (q - pair.first()).norm_squared());
    there + and_back
}

/// Computes the squared Sampson distance to H; infinite beyond the horizon.
///
/// A pair satisfies two equations, `(h1 - u h3) x1 = 0` and `(h2 - v h3) x1 = 0`. With their values
/// e and their derivative J by (x, y, u, v), the distance is eᵀ (J Jᵀ)⁻¹ e (Chum, Pajdla and Sturm,
/// "The geometric error for homographies", CVIU 2005).
pub fn squared_sampson_of_homography<C: Correspondence>(h: &Homography, pair: &C) -> f64 {
    let (h, to) = (&h.0, pair.second());
    let v = h * pair.first().push(1.0);
    if v.z.is_nan() || v.z <= 0.0 {
        return f64::INFINITY;
    }
    let e = v.xy() - to * v.z;
    let row = |k: usize| Vector2::new(h[(k, 0)] - to[k] * h[(2, 0)], h[(k, 1)] - to[k] * h[(2, 1)]);
    let (p, q) = (row(0), row(1));
    let jjt = Matrix2::new(p.norm_squared() + v.z * v.z, p.dot(&q), p.dot(&q), q.norm_squared() + v.z * v.z);
    jjt.try_inverse().map_or(f64::INFINITY, |inverse| e.dot(&(inverse * e)))
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, UnitQuaternion};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::distances::squared_sampson;
    use crate::geometry::homography::PointPair;
    use crate::geometry::skew;

    fn fundamental() -> Matrix3<f64> {
        let k_inverse = Matrix3::new(1.0 / 800.0, 0.0, -0.4, 0.0, 1.0 / 800.0, -0.3, 0.0, 0.0, 1.0);
        let r = UnitQuaternion::from_euler_angles(0.1, -0.2, 0.05).to_rotation_matrix().into_inner();
        k_inverse.transpose() * skew(&Vector3::new(1.0, 0.2, 0.3)) * r * k_inverse
    }

    fn homography() -> Homography {
        Homography(Matrix3::new(0.8, 0.1, 120.0, -0.05, 0.9, 60.0, 1e-4, -2e-4, 1.0))
    }

    fn pair(random: &mut Pcg64Mcg) -> PointPair {
        let mut at = || Vector2::new(random.random_range(0.0..640.0), random.random_range(0.0..480.0));
        PointPair { from: at(), to: at() }
    }

    #[test]
    fn epipolar_distance_equals_the_shift_across_the_line() {
        let (f, mut random) = (fundamental(), Pcg64Mcg::seed_from_u64(1));
        for _ in 0..50 {
            let mut p = pair(&mut random);
            let line = f * p.from.push(1.0);
            let across = line.xy().normalize();
            let moved = random.random_range(-40.0..40.0);
            p.to += across * (moved - (line.dot(&p.to.push(1.0))) / line.xy().norm());
            let [in_first, in_second] = squared_epipolar(&f, &p);
            assert!((in_second.sqrt() - f64::abs(moved)).abs() < 1e-6, "{in_second} {moved}");
            assert!((squared_symmetric_epipolar(&f, &p) - in_first - in_second).abs() < 1e-9);
            // 1 / Sampson² = 1 / d1² + 1 / d2², so it is below both.
            let sampson = squared_sampson(&f, &p);
            assert!((1.0 / sampson - 1.0 / in_first - 1.0 / in_second).abs() < 1e-6 / sampson);
        }
    }

    #[test]
    fn sampson_distance_approximates_the_shortest_correction() {
        // A pair on the relation, moved slightly: the distance is at most the length of the move,
        // and it agrees with a brute-force minimum.
        let (h, mut random) = (homography(), Pcg64Mcg::seed_from_u64(2));
        for _ in 0..50 {
            let from = pair(&mut random).from;
            let Some(to) = h.map(from) else { continue };
            let mut step = || Vector2::new(random.random_range(-1.0..1.0), random.random_range(-1.0..1.0));
            let moved = PointPair { from: from + step(), to: to + step() };
            let d2 = squared_sampson_of_homography(&h, &moved);
            let length2 = (moved.from - from).norm_squared() + (moved.to - to).norm_squared();
            assert!(d2 <= length2 * 1.01, "{d2} {length2}");
            // The smallest distance over x̂ on a fine grid around the moved point.
            let mut least = f64::INFINITY;
            for i in -100..=100 {
                for k in -100..=100 {
                    let x = moved.from + Vector2::new(f64::from(i), f64::from(k)) * 0.015;
                    let Some(y) = h.map(x) else { continue };
                    least = least.min((x - moved.from).norm_squared() + (y - moved.to).norm_squared());
                }
            }
            assert!((d2.sqrt() - least.sqrt()).abs() < 0.02, "{d2} {least}");
        }
    }

    #[test]
    fn transfer_error_is_counted_in_both_pictures() {
        let h = homography();
        let from = Vector2::new(200.0, 100.0);
        let to = h.map(from).expect("in front");
        assert!(squared_symmetric_transfer(&h, &PointPair { from, to }) < 1e-18);
        let moved = PointPair { from, to: to + Vector2::new(3.0, 4.0) };
        let back = h.inverse().and_then(|b| b.map(moved.to)).expect("in front");
        assert!((squared_symmetric_transfer(&h, &moved) - 25.0 - (back - from).norm_squared()).abs() < 1e-9);
        let flat = Homography(Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0));
        assert_eq!(squared_symmetric_transfer(&flat, &moved), f64::INFINITY);
    }

    #[test]
    fn distances_scale_with_the_unit_but_not_with_the_matrix() {
        let (f, h, mut random) = (fundamental(), homography(), Pcg64Mcg::seed_from_u64(3));
        for unit in [1e-3, 1e3] {
            let p = pair(&mut random);
            let scaled = PointPair { from: p.from * unit, to: p.to * unit };
            let shrink = Matrix3::from_diagonal(&Vector3::new(1.0 / unit, 1.0 / unit, 1.0));
            let grow = Matrix3::from_diagonal(&Vector3::new(unit, unit, 1.0));
            let in_unit = shrink * f * shrink * 7.0;
            let ratio = squared_sampson(&in_unit, &scaled) / squared_sampson(&f, &p) / (unit * unit);
            assert!((ratio - 1.0).abs() < 1e-9, "{ratio}");
            let h_in_unit = Homography(grow * h.0 * shrink * 7.0);
            let ratio = squared_sampson_of_homography(&h_in_unit, &scaled) / squared_sampson_of_homography(&h, &p) / (unit * unit);
            assert!((ratio - 1.0).abs() < 1e-9, "{ratio}");
        }
    }

    #[test]
    fn the_epipolar_distance_of_an_epipole_is_infinite() {
        // A forward motion: both epipoles are at the origin.
        let f = skew(&Vector3::z()) * Rotation3::identity().into_inner();
        let p = PointPair { from: Vector2::zeros(), to: Vector2::new(1.0, 2.0) };
        assert_eq!(squared_epipolar(&f, &p)[1], f64::INFINITY);
        assert!(squared_sampson(&f, &PointPair { from: Vector2::zeros(), to: Vector2::zeros() }).is_finite());
    }
}
