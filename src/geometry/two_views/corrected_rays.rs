//! The smallest correction of a pair that makes its rays meet.

use crate::geometry::relative_pose::{RayPair, TwoViewMotion};

/// Returns the pair nearest to the measured one whose rays meet: the minimum sum of squared shifts
/// in both views, to within rounding (Lindstrom, "Triangulation made easy", CVPR 2010, `niter2`).
/// Its depths are exact. Assumes equal noise in the normalised coordinates of both views.
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
    use nalgebra::{UnitQuaternion, Vector2, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    #[test]
    fn corrected_rays_are_the_nearest_pair_that_meets() {
        let motion = TwoViewMotion {
            rotation: UnitQuaternion::from_euler_angles(0.1, 0.2, -0.1),
            direction: Vector3::new(1.0, 0.1, 0.3).normalize(),
        };
        let (e, mut random) = (motion.essential(), Pcg64Mcg::seed_from_u64(1));
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
