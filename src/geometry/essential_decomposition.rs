//! Decomposes an essential matrix into motions and chooses the one that puts the points in front of
//! both cameras (cheirality).

use nalgebra::{Matrix3, Vector3};

use super::pose::quaternion;
use super::relative_pose::{RayPair, TwoViewMotion};
use super::triangulation::depths;

/// Returns the four motions that an essential matrix allows.
pub(super) fn decompose(e: &Matrix3<f64>) -> Option<[TwoViewMotion; 4]> {
    if !e.iter().all(|v| v.is_finite()) {
        return None;
    }
    let svd = e.svd(true, true);
    let (mut u, mut vt) = (svd.u?, svd.v_t?);
    // nalgebra sorts singular values in descending order: the null directions come last.
    if u.determinant() < 0.0 {
        u = -u;
    }
    if vt.determinant() < 0.0 {
        vt = -vt;
    }
    let w = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let t: Vector3<f64> = u.column(2).into_owned();
    let (r1, r2) = (quaternion(&(u * w * vt)), quaternion(&(u * w.transpose() * vt)));
    Some([(r1, t), (r1, -t), (r2, t), (r2, -t)].map(|(rotation, direction)| TwoViewMotion { rotation, direction }))
}

/// Returns the motion of the four that puts most pairs in front of both cameras, with that number.
pub fn motion_by_cheirality(e: &Matrix3<f64>, pairs: &[RayPair]) -> Option<(TwoViewMotion, usize)> {
    let motions = decompose(e)?;
    let counted = motions.map(|m| {
        let in_front = pairs.iter().filter(|p| depths(&m, p).is_some_and(|(a, b)| a > 0.0 && b > 0.0)).count();
        (m, in_front)
    });
    counted.into_iter().max_by_key(|(_, n)| *n)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::test_views::{errors_deg, scene, truth};

    #[test]
    fn cheirality_by_all_pairs_finds_the_motion() {
        let pairs = scene(50, 0.0, false, 5);
        for sign in [1.0, -1.0] {
            let (m, count) = motion_by_cheirality(&(truth().essential() * sign), &pairs).expect("decomposes");
            assert_eq!(count, 50);
            let (r, t) = errors_deg(&m);
            assert!(r < 1e-6 && t < 1e-5, "{r} {t}");
        }
    }
}
