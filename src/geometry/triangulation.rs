//! Triangulation: a point's depths in two cameras, and the smallest correction that makes its rays
//! meet.

use nalgebra::{Matrix2, Vector2};

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

/// Returns the pair nearest to the measured one whose rays meet: the minimum sum of squared shifts
/// in both views, to within rounding (Lindstrom, "Triangulation made easy", CVPR 2010, `niter2`).
/// Its [`depths`] are exact. Assumes equal noise in the normalised coordinates of both views.
pub fn corrected(motion: &TwoViewMotion, pair: &RayPair) -> RayPair {
    let e = motion.essential();
    let upper = e.fixed_view::<2, 2>(0, 0).into_owned();
    let (a, b) = (pair.first.push(1.0), pair.second.push(1.0));
    // The derivatives of bᵀ E a by the second and the first point.
    let (second, first) = ((e * a).xy(), (e.transpose() * b).xy());
    let quadratic = second.dot(&(upper * first));
    let half = 0.5 * (first.norm_squared() + second.norm_squared());
    let c = b.dot(&(e * a));
    let root = (half * half - quadratic * c).max(0.0).sqrt();
    let step = c / (half + root);
    let (by_second, by_first) = (second - upper * first * step, first - upper.transpose() * second * step);
    let step = step * 2.0 * root / (by_first.norm_squared() + by_second.norm_squared());
    let moved = RayPair { first: pair.first - by_first * step, second: pair.second - by_second * step };
    // At an epipole the derivative vanishes, and no correction is possible.
    if moved.first.iter().chain(&moved.second).all(|v| v.is_finite()) { moved } else { *pair }
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

    #[test]
    fn corrected_rays_are_the_nearest_pair_that_meets() {
        use rand::{Rng, SeedableRng};
        let motion = TwoViewMotion {
            rotation: UnitQuaternion::from_euler_angles(0.1, 0.2, -0.1),
            direction: Vector3::new(1.0, 0.1, 0.3).normalize(),
        };
        let (e, mut random) = (motion.essential(), rand_pcg::Pcg64Mcg::seed_from_u64(1));
        for _ in 0..200 {
            let mut at = |half: f64| Vector2::new(random.random_range(-half..half), random.random_range(-half..half));
            let p = (at(0.5) * 5.0).push(5.0);
            let q = motion.rotation * p + motion.direction;
            let pair = RayPair { first: p.xy() / p.z + at(0.01), second: q.xy() / q.z + at(0.01) };
            let found = corrected(&motion, &pair);
            let meets = |pair: &RayPair| pair.second.push(1.0).dot(&(e * pair.first.push(1.0)));
            assert!(meets(&found).abs() < 1e-10, "{}", meets(&found));
            let moved = |to: &RayPair| (to.first - pair.first).norm_squared() + (to.second - pair.second).norm_squared();
            // Other pairs that meet: any first point nearby, and the second moved to its line.
            for _ in 0..50 {
                let first = found.first + at(0.003);
                let line = e * first.push(1.0);
                let second = pair.second - line.xy() * (line.dot(&pair.second.push(1.0)) / line.xy().norm_squared());
                assert!(moved(&RayPair { first, second }) >= moved(&found) * (1.0 - 1e-6));
            }
        }
        let nowhere = RayPair { first: Vector2::new(f64::NAN, 0.0), second: Vector2::zeros() };
        assert!(corrected(&motion, &nowhere).first.x.is_nan());
    }
}
