use nalgebra::{UnitQuaternion, Vector2};

use super::super::synthetic::{cloth, facing, lens, prepared, seen_anchors};
use super::*;
use crate::camera::Normalized;

/// Returns exact anchors on a grid over every surface, displaced by up to `noise_px` in a fixed
/// pattern.
fn seen(
    body: &PreparedBody,
    pose: &Pose<Camera, Body>,
    camera: &CameraModel,
    across: u32,
    noise_px: f64,
) -> (Pose<Camera, Body>, f64, Vec<FittedAnchor>) {
    let wobble = |k: u32, _| Vector2::new((f64::from(k) * 12.9).sin(), (f64::from(k) * 78.2).sin()) * noise_px;
    let anchors = seen_anchors(body, pose, camera, across, wobble);
    (*pose, noise_px.max(0.05), anchors)
}

fn described(body: &PreparedBody, (pose, rms_px, anchors): &(Pose<Camera, Body>, f64, Vec<FittedAnchor>), camera: &CameraModel) -> TwoView {
    two_view(body, pose, *rms_px, anchors, camera, 1, &mut TwoViewBuffers::default())
}

fn with_depth() -> PreparedBody {
    let mut flat = cloth(2);
    flat.pose = Pose::new(UnitQuaternion::from_euler_angles(0.0, 0.4, 0.0), Vector3::new(0.7, 0.1, 0.9));
    flat.size_m = [1.2, 0.9];
    prepared(vec![cloth(1), flat])
}

fn assert_described(body: &PreparedBody, has_depth: bool) {
    let (camera, pose) = (lens(640, 480), facing(0.1, -0.3, Vector3::new(0.4, 0.05, 5.0)));
    let found = described(body, &seen(body, &pose, &camera, 10, 0.15), &camera);
    assert_eq!(found.has_depth, has_depth);
    let truth = pose * reference_camera(body);
    let (motion, inliers) = found.essential.expect("a baseline");
    let (rotation, direction) =
        (motion.rotation.angle_to(&truth.rotation).to_degrees(), motion.direction.angle(&truth.translation).to_degrees());
    println!("depth {has_depth}: {rotation:.3} and {direction:.3} degrees, {inliers} inliers");
    assert!(rotation < 0.5 && direction < 0.5 && inliers > 90, "{rotation} {direction} {inliers}");
    let h = found.homography.expect("correspondences enough");
    assert_eq!(h[(2, 2)], 1.0);
    let p = Vector2::new(200.0, 300.0);
    let c = pose.transform(&body.surfaces[0].spec.body_point(p));
    let expected = camera.undistorted_pixel(Normalized(Vector2::new(c.x / c.z, c.y / c.z)));
    assert!((Homography(h).map(p).expect("finite") - expected).norm() < 0.1);
}

#[test]
fn one_plane_is_a_homography() {
    assert_described(&prepared(vec![cloth(1)]), false);
}

#[test]
fn two_depths_are_an_essential_matrix() {
    assert_described(&with_depth(), true);
}

#[test]
fn the_reference_camera_sees_the_whole_artwork_upright() {
    let body = prepared(vec![cloth(1)]);
    let to_reference = reference_camera(&body).inverse();
    // fx = W, fy = H width / height, centred (C3): the artwork's outer corners must project to the
    // virtual picture's.
    let spec = &body.surfaces[0].spec;
    for (u, v) in [(-0.5, -0.5), (639.5, -0.5), (639.5, 479.5), (10.0, 20.0)] {
        let c = to_reference.transform(&spec.body_point(Vector2::new(u, v)));
        let pixel = Vector2::new(640.0 * c.x / c.z + 319.5, 480.0 * 4.0 / 3.0 * c.y / c.z + 239.5);
        assert!((pixel - Vector2::new(u, v)).norm() < 1e-9, "{pixel}");
    }
}

#[test]
fn two_views_need_a_baseline_and_correspondences() {
    let (body, camera) = (prepared(vec![cloth(1)]), lens(640, 480));
    // 1 % of 4 m is 4 cm.
    for (x, is_some) in [(0.03, false), (0.05, true)] {
        let pose: Pose<Camera, Body> = reference_camera(&body).inverse().renamed();
        let beside: Pose<Camera, Body> = Pose::new(pose.rotation, pose.translation + Vector3::new(x, 0.0, 0.0));
        let found = described(&body, &seen(&body, &beside, &camera, 8, 0.0), &camera);
        assert_eq!(found.essential.is_some(), is_some, "{x} m");
        assert!(found.homography.is_some());
    }
    let pose = facing(0.1, -0.3, Vector3::new(0.4, 0.05, 5.0));
    let mut few = seen(&body, &pose, &camera, 4, 0.0);
    few.2.truncate(11);
    assert!(described(&body, &few, &camera).homography.is_none());
}
