//! Camera motions that a plane seen in two views allows.
//!
//! H = R + (t / d) nᵀ between normalised points, with n the plane's unit normal and d its distance
//! in the first view. Up to four motions have the same H (Faugeras and Lustman 1988; closed form of
//! Ma, Soatto, Košecká and Sastry, "An Invitation to 3-D Vision", section 5.3.3). The points must
//! be in front of the camera, which leaves at most two, and one for a plane seen head-on or pure
//! rotation.

use nalgebra::{Matrix3, UnitQuaternion, Vector2, Vector3};

use crate::geometry::homography::Homography;
use crate::geometry::pose::{quaternion, skew};
use crate::geometry::relative_pose::RayPair;

/// If the largest and smallest singular value differ by less than this, H is a pure rotation (whose
/// singular values are all 1). t / d, at least half their difference, is then below a millionth and
/// just rounding. Raised, very small motions are lost.
const MAX_ONLY_ROTATED: f64 = 1e-6;

/// A motion and the plane that was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanarMotion {
    /// R: `x2 ∝ R x1 + t`.
    pub rotation: UnitQuaternion<f64>,
    /// t / d: the translation in units of the plane's distance from the first camera; zero for pure
    /// rotation.
    pub translation: Vector3<f64>,
    /// The plane's unit normal in the first camera's axes, pointing away from the camera:
    /// `n · X = d > 0`. `None` for pure rotation.
    pub normal: Option<Vector3<f64>>,
    /// Number of pairs in front of both cameras.
    pub in_front: usize,
}

/// Returns the motions that a homography between normalised points and its pairs allow, most pairs
/// in front first: at most two, and at least one if the homography maps the pairs at all.
///
/// All pairs are used. Of a motion and its mirror image, (R, t, n) and (R, -t, -n), the one with
/// more pairs in front is kept; of the rest, those with at least half as many pairs in front as the
/// best.
pub fn decompose_homography(h: &Homography, pairs: &[RayPair]) -> Vec<PlanarMotion> {
    let Some(h) = of_unit_scale(h, pairs) else { return Vec::new() };
    let mut found: Vec<PlanarMotion> = motions(&h).into_iter().map(|motion| facing(motion, pairs)).collect();
    found.sort_by_key(|m| std::cmp::Reverse(m.in_front));
    let most = found.first().map_or(0, |best| best.in_front);
    found.retain(|m| 2 * m.in_front >= most);
    found
}

/// Scales H so that its middle singular value is 1, as H = R + (t / d) nᵀ requires, with the sign
/// that keeps points in front of both cameras.
fn of_unit_scale(h: &Homography, pairs: &[RayPair]) -> Option<Matrix3<f64>> {
    let h = h.0;
    if !h.iter().all(|v| v.is_finite()) {
        return None;
    }
    let mut squares = (h.transpose() * h).symmetric_eigenvalues();
    squares.as_mut_slice().sort_by(f64::total_cmp);
    let scale = squares[1].max(0.0).sqrt();
    let ahead = pairs.iter().map(|p| p.second.push(1.0).dot(&(h * p.first.push(1.0))).signum()).sum::<f64>();
    let scaled = h * (if ahead < 0.0 { -1.0 } else { 1.0 } / scale);
    scaled.iter().all(|v| v.is_finite()).then_some(scaled)
}

/// Returns both motions up to the joint sign of t and n.
fn motions(h: &Matrix3<f64>) -> Vec<PlanarMotion> {
    let eigen = (h.transpose() * h).symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &k| eigen.eigenvalues[k].total_cmp(&eigen.eigenvalues[i]));
    let [large, _, small] = order.map(|k| eigen.eigenvalues[k].max(0.0));
    let [v1, v2, v3] = order.map(|k| eigen.eigenvectors.column(k).into_owned());
    if large.sqrt() - small.sqrt() < MAX_ONLY_ROTATED {
        let rotation = quaternion(h);
        return vec![PlanarMotion { rotation, translation: Vector3::zeros(), normal: None, in_front: 0 }];
    }
    // Directions in the plane whose length H keeps, besides v2.
    let (a, b) = ((1.0 - small).max(0.0).sqrt(), (large - 1.0).max(0.0).sqrt());
    let directions = [v1 * a + v3 * b, v1 * a - v3 * b].map(|u| u / (large - small).sqrt());
    let motion = |u: &Vector3<f64>| {
        let normal = v2.cross(u);
        let before = Matrix3::from_columns(&[v2, *u, normal]);
        let (w2, wu) = (h * v2, h * u);
        let after = Matrix3::from_columns(&[w2, wu, skew(&w2) * wu]);
        let rotation = quaternion(&(after * before.transpose()));
        let translation = (h - rotation.to_rotation_matrix().into_inner()) * normal;
        PlanarMotion { rotation, translation, normal: Some(normal), in_front: 0 }
    };
    directions.iter().map(motion).collect()
}

/// Chooses the motion or its mirror image, whichever has more pairs in front of both cameras.
fn facing(motion: PlanarMotion, pairs: &[RayPair]) -> PlanarMotion {
    let rotated = PlanarMotion { translation: -motion.translation, normal: motion.normal.map(|n| -n), ..motion };
    let [as_is, mirrored] =
        [motion, rotated].map(|m| PlanarMotion { in_front: pairs.iter().filter(|p| is_in_front(&m, p.first)).count(), ..m });
    if mirrored.in_front > as_is.in_front { mirrored } else { as_is }
}

/// Whether the plane is in front of both cameras along this ray of the first.
fn is_in_front(motion: &PlanarMotion, first: Vector2<f64>) -> bool {
    let ray = first.push(1.0);
    let rotated = motion.rotation * ray;
    match motion.normal {
        // The depth in the first view is d / (n · x), in the second that of R x + t (n · x) / d.
        Some(n) => n.dot(&ray) > 0.0 && rotated.z + motion.translation.z * n.dot(&ray) > 0.0,
        None => rotated.z > 0.0,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A plane n · X = d seen from two places.
    fn seen(rotation: &UnitQuaternion<f64>, t: &Vector3<f64>, n: &Vector3<f64>, d: f64) -> (Homography, Vec<RayPair>) {
        let h = rotation.to_rotation_matrix().into_inner() + t / d * n.transpose();
        let mut pairs = Vec::new();
        for i in -4..=4 {
            for k in -3..=3 {
                let first = Vector2::new(0.1 * f64::from(i), 0.1 * f64::from(k));
                let q = h * first.push(1.0);
                if n.dot(&first.push(1.0)) > 0.05 && q.z > 0.05 {
                    pairs.push(RayPair { first, second: q.xy() / q.z });
                }
            }
        }
        (Homography(h), pairs)
    }

    fn error(m: &PlanarMotion, rotation: &UnitQuaternion<f64>, t: &Vector3<f64>, n: &Vector3<f64>) -> f64 {
        m.rotation.angle_to(rotation) + (m.translation - t).norm() + m.normal.map_or(0.0, |found| (found - n).norm())
    }

    proptest! {
        /// For any motion, plane, and sign and scale of the homography: the truth is among at most
        /// two results, and each reproduces H.
        #[test]
        fn the_decomposition_includes_the_true_motion(rotation in prop::array::uniform3(-0.4..0.4_f64), t in prop::array::uniform3(-0.5..0.5_f64), tilt in prop::array::uniform2(-0.8..0.8_f64), scale in prop::sample::select(vec![-3.0, 1.0, 1e-4])) {
            let (rotation, t) = (UnitQuaternion::from_scaled_axis(Vector3::from(rotation)), Vector3::from(t));
            let n = Vector3::new(tilt[0], tilt[1], 1.0).normalize();
            prop_assume!(t.norm() > 0.02);
            let (h, pairs) = seen(&rotation, &t, &n, 1.0);
            prop_assume!(pairs.len() > 30);
            let found = decompose_homography(&Homography(h.0 * scale), &pairs);
            prop_assert!((1..=2).contains(&found.len()));
            let nearest = found.iter().map(|m| error(m, &rotation, &t, &n)).fold(f64::INFINITY, f64::min);
            prop_assert!(nearest < 1e-5, "{nearest} {found:?}");
            prop_assert_eq!(found[0].in_front, pairs.len());
            for m in &found {
                let back = m.rotation.to_rotation_matrix().into_inner() + m.translation * m.normal.unwrap_or_default().transpose();
                prop_assert!((back - h.0).norm() < 1e-6);
            }
        }
    }

    #[test]
    fn a_camera_that_only_turned_has_no_translation() {
        let rotation = UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3);
        let (h, pairs) = seen(&rotation, &Vector3::zeros(), &Vector3::z(), 1.0);
        let found = decompose_homography(&h, &pairs);
        let [m] = found[..] else { panic!("{found:?}") };
        assert!(m.rotation.angle_to(&rotation) < 1e-9 && m.translation.norm() == 0.0 && m.normal.is_none() && m.in_front == pairs.len());
    }

    #[test]
    fn motion_along_the_normal_yields_one_double_solution() {
        let (t, n) = (Vector3::new(0.0, 0.0, -0.3), Vector3::z());
        let (h, pairs) = seen(&UnitQuaternion::identity(), &t, &n, 1.0);
        let found = decompose_homography(&h, &pairs);
        assert!(!found.is_empty() && found.iter().all(|m| error(m, &UnitQuaternion::identity(), &t, &n) < 1e-6), "{found:?}");
    }

    #[test]
    fn noise_moves_the_motion_little_and_never_reverses_it() {
        use rand::{Rng, SeedableRng};
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(1);
        for _ in 0..200 {
            let mut axis = |half: f64| {
                Vector3::new(random.random_range(-half..half), random.random_range(-half..half), random.random_range(-half..half))
            };
            let (rotation, t, n) = (UnitQuaternion::from_scaled_axis(axis(0.3)), axis(0.3), (axis(0.7) + Vector3::z()).normalize());
            if t.norm() < 0.05 {
                continue;
            }
            let (h, mut pairs) = seen(&rotation, &t, &n, 1.0);
            let noisy = Homography(h.0 + Matrix3::from_fn(|_, _| random.random_range(-3e-4..3e-4)));
            for p in pairs.iter_mut().step_by(10) {
                std::mem::swap(&mut p.first, &mut p.second);
            }
            let found = decompose_homography(&noisy, &pairs);
            assert!(
                found.iter().any(|m| m.translation.angle(&t).to_degrees() < 20.0 && m.rotation.angle_to(&rotation).to_degrees() < 2.5),
                "{t} {n} {found:?}"
            );
        }
    }

    #[test]
    fn invalid_homographies_have_no_motion() {
        assert!(decompose_homography(&Homography(Matrix3::zeros()), &[]).is_empty());
        assert!(decompose_homography(&Homography(Matrix3::repeat(f64::NAN)), &[]).is_empty());
    }
}
