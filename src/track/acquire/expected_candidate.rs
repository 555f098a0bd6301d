//! Proposes a candidate for a body that was seen a moment ago, near its predicted pose, from only a
//! few matches.
//!
//! A body that emerges from behind another is visible in strips. The matches in them are too few
//! and too collinear to determine a pose. But a lateral shift of the predicted pose takes only one
//! match, and three that agree on it are rarely wrong.

use crate::track::acquire::tuning::TUNING;
use nalgebra::{Matrix2, Vector2, Vector3};

use super::candidate::{Candidate, SurfaceMatch, nearly_same};
use crate::camera::{CameraModel, Normalized};
use crate::geometry::local_affinities::{LocalAffinity, robust_shift};
use crate::geometry::{Body, Camera, PointPair, Pose};
use crate::track::scene::reference::PreparedBody;

/// Shifts each expected pose laterally to where most matches nearby are, and returns the one with
/// the most support.
pub fn expected_candidate(
    body: &PreparedBody,
    matches: &[SurfaceMatch],
    camera: &CameraModel,
    expected: impl Iterator<Item = Pose<Camera, Body>>,
) -> Option<Candidate> {
    let shifted = expected.filter_map(|pose| shifted(body, matches, camera, &pose));
    // The first wins a tie.
    shifted.reduce(|best, next| if next.inliers > best.inliers { next } else { best })
}

/// Shifts one expected pose; `None` if too few matches agree on a shift.
fn shifted(body: &PreparedBody, matches: &[SurfaceMatch], camera: &CameraModel, expected: &Pose<Camera, Body>) -> Option<Candidate> {
    let (depths, affinities): (Vec<f64>, Vec<LocalAffinity>) =
        matches.iter().filter_map(|m| relative_to_expected(body, m, camera, expected)).unzip();
    let (shift, agreeing) =
        robust_shift(&affinities, TUNING.max_predicted_distance * f64::from(camera.width()), TUNING.min_agreeing_places)?;
    let depth = agreeing.iter().map(|&k| depths[k]).sum::<f64>() / agreeing.len() as f64;
    let middle = Vector2::new(f64::from(camera.width()), f64::from(camera.height())) * 0.5;
    let [from, to] = [middle, middle + shift].map(|p| camera.from_undistorted_pixel(p).0);
    let lateral: Vector3<f64> = ((to - from) * depth).push(0.0);
    // Whatever shifted the body may have changed its distance and rotated it by as much.
    let open = lateral.norm();
    Some(Candidate {
        pose: Pose::new(expected.rotation, expected.translation + lateral),
        inliers: agreeing.len(),
        cost: 0.0,
        off: [open.hypot(TUNING.feature_pose_shift_sigma * depth), (open / depth).hypot(TUNING.feature_pose_rotation_sigma)],
    })
}

/// Returns the depth of a match at the expected pose, and the local affine map from the expected to
/// the observed view of the surface; `None` behind the camera.
fn relative_to_expected(
    body: &PreparedBody,
    m: &SurfaceMatch,
    camera: &CameraModel,
    expected: &Pose<Camera, Body>,
) -> Option<(f64, LocalAffinity)> {
    let spec = &body.surfaces[m.surface as usize].spec;
    let seen = |artwork: Vector2<f64>| {
        let point = expected.transform(&spec.body_point(artwork));
        (point.z > 0.0).then(|| (point.z, camera.undistorted_pixel(Normalized(point.coords.xy() / point.z))))
    };
    let (depth, from) = seen(m.artwork)?;
    let by_artwork = Matrix2::from_columns(&[seen(m.artwork + Vector2::x())?.1 - from, seen(m.artwork + Vector2::y())?.1 - from]);
    let pair = PointPair { from, to: m.undistorted };
    Some((depth, LocalAffinity { pair, derivative: m.derivative * by_artwork.try_inverse()?, noise: TUNING.feature_noise_px * m.scale }))
}

/// Of two planar poses of the same matches, puts first the one whose rotation is nearer to the
/// expected one.
pub fn prefer_expected_tilt(found: &mut [Candidate], expected: &Pose<Camera, Body>) {
    if let [first, second, ..] = found {
        let are_twins = 2 * first.inliers.min(second.inliers) > first.inliers.max(second.inliers);
        if are_twins && second.pose.angle_to(expected) < first.pose.angle_to(expected) {
            std::mem::swap(first, second);
        }
    }
}

/// Puts a candidate first, replacing those that are nearly the same.
pub fn put_first(found: &mut Vec<Candidate>, candidate: Candidate) {
    found.retain(|other| !nearly_same(&other.pose, &candidate.pose));
    found.insert(0, candidate);
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::camera::Pixel;
    use crate::track::synthetic::{cloth, facing, lens, prepared, seen};

    fn truth() -> Pose<Camera, Body> {
        facing(0.3, -0.2, Vector3::new(0.1, 0.05, 6.0))
    }

    /// Returns matches in a strip at the left of the cloth, the only visible part, and wrong ones
    /// anywhere.
    fn matches(body: &PreparedBody, camera: &CameraModel, right: usize, wrong: usize, seed: u64) -> Vec<SurfaceMatch> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut anywhere = |width: f64| Vector2::new(random.random_range(0.0..width), random.random_range(0.0..480.0));
        let mut matched = |k: usize| {
            let artwork = anywhere(if k < right { 60.0 } else { 640.0 });
            let (pixel, derivative) = seen(camera, &truth(), &body.surfaces[0].spec, artwork);
            let (pixel, rotation) = if k < right { (pixel, 0.1) } else { (anywhere(640.0), anywhere(6.0).x) };
            let undistorted = camera.undistorted_pixel(camera.unproject(Pixel(pixel)).expect("in the frame"));
            let derivative = nalgebra::Rotation2::new(rotation) * derivative;
            SurfaceMatch { surface: 0, artwork, pixel, undistorted, scale: 1.0, derivative }
        };
        (0..right + wrong).map(&mut matched).collect()
    }

    /// Returns the true pose, shifted by `lateral` (fraction of the distance) and rotated by
    /// `rotation` radians.
    fn off_by(lateral: f64, rotation: f64) -> Pose<Camera, Body> {
        let truth = truth();
        let rotated = UnitQuaternion::from_euler_angles(rotation, -rotation, rotation) * truth.rotation;
        Pose::new(rotated, truth.translation + Vector3::new(lateral, -0.5 * lateral, 0.5 * lateral) * truth.translation.z)
    }

    #[test]
    fn four_matches_in_a_strip_correct_the_expected_pose() {
        let (body, camera) = (prepared(vec![cloth(3)]), lens(640, 480));
        for seed in 0..20 {
            let matches = matches(&body, &camera, 4, 50, seed);
            let expected = off_by(0.03, 0.02);
            let found = expected_candidate(&body, &matches, &camera, std::iter::once(expected)).expect("a candidate");
            assert!(found.inliers >= 3 && found.inliers <= 5, "{seed}: {} places", found.inliers);
            let spec = &body.surfaces[0].spec;
            let [right, was, is] = [truth(), expected, found.pose].map(|pose| seen(&camera, &pose, spec, Vector2::new(30.0, 240.0)).0);
            assert!(
                (was - right).norm() > 10.0 && (is - right).norm() < 4.0,
                "{seed}: {} to {} px",
                (was - right).norm(),
                (is - right).norm()
            );
            // The stated uncertainty covers the error.
            let error = (found.pose.inverse().translation - truth().inverse().translation).norm();
            assert!(error < 3.0 * found.off[0] && found.pose.angle_to(&truth()) < 3.0 * found.off[1], "{seed}: {error} of {:?}", found.off);
        }
    }

    #[test]
    fn the_expected_pose_with_the_most_matches_is_used() {
        let (body, camera) = (prepared(vec![cloth(3)]), lens(640, 480));
        let matches = matches(&body, &camera, 6, 50, 1);
        for expected in [[off_by(0.3, 0.0), off_by(0.02, 0.02)], [off_by(0.02, 0.02), off_by(0.3, 0.0)]] {
            let found = expected_candidate(&body, &matches, &camera, expected.into_iter()).expect("a candidate");
            assert!(found.pose.angle_to(&off_by(0.02, 0.02)) < 1e-6);
        }
    }

    #[test]
    fn wrong_matches_or_distant_bodies_rarely_yield_candidates() {
        let (body, camera) = (prepared(vec![cloth(3)]), lens(640, 480));
        let found = |right: usize, expected: Pose<Camera, Body>, seed: u64| {
            expected_candidate(&body, &matches(&body, &camera, right, 60, seed), &camera, std::iter::once(expected)).is_some()
        };
        let wrong = (0..200).filter(|&seed| found(0, truth(), seed)).count();
        assert!(wrong <= 4, "{wrong} of 200");
        let elsewhere = (0..200).filter(|&seed| found(10, off_by(0.3, 0.0), seed)).count();
        assert!(elsewhere <= 4, "{elsewhere} of 200");
        // The expected pose lies behind the camera.
        let behind = Pose::new(truth().rotation, -truth().translation);
        assert!((0..20).all(|seed| !found(10, behind, seed)));
    }

    #[test]
    fn the_planar_pose_with_the_expected_tilt_comes_first() {
        let candidate = |rotation: f64, inliers: usize| Candidate { pose: off_by(0.0, rotation), inliers, cost: 1.0, off: [0.01; 2] };
        let order = |mut found: Vec<Candidate>, rotation: f64| {
            prefer_expected_tilt(&mut found, &off_by(0.05, rotation));
            found.iter().map(|c| c.inliers).collect::<Vec<_>>()
        };
        let twins = || vec![candidate(-0.4, 20), candidate(0.4, 19), candidate(0.0, 18)];
        assert_eq!(order(twins(), 0.3), [19, 20, 18]);
        assert_eq!(order(twins(), -0.3), [20, 19, 18]);
        // A candidate with little support is no planar twin.
        assert_eq!(order(vec![candidate(-0.4, 20), candidate(0.4, 9)], 0.3), [20, 9]);
        assert_eq!(order(vec![candidate(-0.4, 20)], 0.3), [20]);
        let mut found = twins();
        put_first(&mut found, candidate(0.401, 5));
        assert_eq!(found.iter().map(|c| c.inliers).collect::<Vec<_>>(), [5, 20, 18]);
    }
}
