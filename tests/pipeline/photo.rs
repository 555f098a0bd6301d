//! A surface that is known from a photograph of it, taken by another camera.

use nalgebra::{Point3, Vector2, Vector3};
use stagepose::two_views::geometry::Homography;
use stagepose::{
    CameraModel, CameraPath, EntryContent, Intrinsics, Normalized, Pixel, ReferenceKind, Renderer, Spline, State, SurfaceSpec,
};

use super::scene::{assert_tracks_within, backdrop, body, camera, nees_per_freedom, past, quiet, rows, setup, track_rows};
use super::two_view::{motion_errors, worst_transfer};

fn photographer() -> CameraModel {
    let distortion = [-0.2, 0.08, 0.001, -0.0005, 0.0];
    let (width, height) = (960, 720);
    CameraModel::new(Intrinsics { width, height, fx: 850.0, fy: 853.0, cx: 470.0, cy: 366.0, skew: 0.001, distortion }).unwrap()
}

/// A still of the clip may serve as the photograph; then the frame and the photograph are
/// identical, even in their noise.
#[test]
fn a_clip_starting_with_its_own_photograph_tracks_at_once() {
    for place in [Point3::new(0.7, -4.4, -0.2), Point3::new(-0.3, -5.0, 0.3)] {
        let path = CameraPath::fixed(place, Point3::new(0.05, 0.0, 0.02));
        let scene = quiet(photographer(), path, backdrop());
        let rows = rows(&scene, 3);
        let EntryContent::Frame(first) = &rows[0].content else { panic!("rendered rows are frames") };
        let spec = &scene.stage.surfaces[0];
        let (stand, (w, h)) = (scene.truth(0.0).inverse(), spec.artwork.dimensions());
        let corners = [(0, 0), (w, 0), (w, h), (0, h)].map(|(u, v)| {
            let seen = stand.transform(&spec.body_point(Vector2::new(f64::from(u) - 0.5, f64::from(v) - 0.5)));
            photographer().project(Normalized(seen.coords.xy() / seen.z))
        });
        let mut told = setup(&scene);
        let photo = SurfaceSpec::from_photograph("photo".into(), &first.image, corners, photographer(), spec.size_m, spec.pose).unwrap();
        told.stage = body(vec![photo]);
        let samples = track_rows(told, &rows);
        assert!(samples.iter().all(|s| s.state == State::Tracking), "{:?}", samples.iter().map(|s| s.reason).collect::<Vec<_>>());
        assert_tracks_within(&scene, &samples, 0.0015, 0.06);
    }
}

#[test]
fn a_photograph_serves_as_the_stage() {
    let stage = backdrop();
    let spec = &stage.surfaces[0];
    let photo_path = CameraPath::fixed(Point3::new(0.7, -4.6, -0.2), Point3::new(0.05, 0.0, 0.02));
    let photo_scene = quiet(photographer(), photo_path, stage.clone());
    let stand = photo_scene.truth(0.0);
    let (w, h) = (f64::from(spec.artwork.width()), f64::from(spec.artwork.height()));
    let seen = |artwork: Vector2<f64>| {
        let c = stand.inverse().transform(&spec.body_point(artwork));
        Normalized(Vector2::new(c.x / c.z, c.y / c.z))
    };
    let outer = [(-0.5, -0.5), (w - 0.5, -0.5), (w - 0.5, h - 0.5), (-0.5, h - 0.5)].map(|(u, v)| Vector2::new(u, v));
    let corners: [Pixel; 4] = outer.map(|p| photographer().project(seen(p)));
    let photo = Renderer::new(photo_scene).render(0.0, 0);
    let surface = SurfaceSpec::from_photograph("photo".into(), &photo, corners, photographer(), spec.size_m, spec.pose).unwrap();
    let ReferenceKind::Photograph { h_photo_artwork, pose, .. } = &surface.kind else { panic!("a photograph's kind") };
    // The photographing camera's pose is recovered from the corners alone.
    let found = (spec.pose * pose.inverse()).translation;
    assert!((found - stand.translation).norm() < 1e-6, "{found}");
    // The flattened picture's corners are the photograph's.
    let flat_corner = Homography(*h_photo_artwork).map(Vector2::new(-0.5, -0.5)).unwrap();
    assert!((flat_corner - photographer().undistorted_pixel(seen(outer[0]))).norm() < 1e-6);

    let scene = quiet(camera(640, 480), past(), stage.clone());
    let mut told = setup(&scene);
    told.stage = body(vec![surface]);
    let samples = track_rows(told, &rows(&scene, 8));
    assert_tracks_within(&scene, &samples, 0.0015, 0.06);
    let mut worst = (0.0_f64, 0.0_f64, 0.0_f64);
    for sample in &samples[1..] {
        let m = sample.measurement.unwrap();
        let transfer = worst_transfer(&scene, sample, &m.homography.unwrap(), |p| photographer().undistorted_pixel(seen(p)));
        let (rotation, direction) = motion_errors(&scene, sample, &stand, &m.essential.unwrap());
        worst = (worst.0.max(transfer), worst.1.max(rotation), worst.2.max(direction));
    }
    println!("worst: homography {:.3} px, essential {:.3} and {:.3} degrees", worst.0, worst.1, worst.2);
    assert!(worst.0 < 0.5 && worst.1 < 0.5 && worst.2 < 0.5, "{worst:?}");
}

/// The print is 350 pixels wide in its photograph, its corners have typical reading errors, and the
/// camera moves in front of it.
#[test]
fn photo_corners_a_pixel_off_widen_the_covariance_only() {
    let (stage, lens) = (backdrop(), camera(640, 480));
    let spec = &stage.surfaces[0];
    let photo_path = CameraPath::fixed(Point3::new(0.2, -7.2, -0.1), Point3::new(0.0, 0.0, 0.0));
    let photo_scene = quiet(lens, photo_path, stage.clone());
    let stand = photo_scene.truth(0.0).inverse();
    let (w, h) = (f64::from(spec.artwork.width()), f64::from(spec.artwork.height()));
    let outer = [(-0.5, -0.5), (w - 0.5, -0.5), (w - 0.5, h - 0.5), (-0.5, h - 0.5)];
    let corners = outer.map(|(u, v)| {
        let c = stand.transform(&spec.body_point(Vector2::new(u, v)));
        lens.project(Normalized(Vector2::new(c.x / c.z, c.y / c.z))).0
    });
    let photo = Renderer::new(photo_scene).render(0.0, 0);
    let keys = [(0.0, Vector3::new(-0.8, -6.4, 0.3)), (1.0, Vector3::new(0.9, -6.8, -0.2))];
    let target = Spline::fixed(Vector3::zeros());
    let path = CameraPath { position: Spline::new(&keys).unwrap(), target, roll_rad: 0.02, shake: None };
    let scene = quiet(lens, path, stage.clone());
    let rows = rows(&scene, 24);
    // One corner off by a pixel, each by up to a pixel, each by a pixel along both axes, and each
    // by two.
    let typed = [
        [[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [0.0, 0.0]],
        [[0.0, 0.9], [-0.7, -0.1], [-0.7, -0.2], [0.7, -0.2]],
        [[-1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]],
        [[2.0, 0.0], [0.0, 2.0], [-2.0, 0.0], [0.0, 2.0]],
    ];
    for off in typed {
        let typed: [Pixel; 4] = std::array::from_fn(|k| Pixel(corners[k] + Vector2::from(off[k])));
        let surface = SurfaceSpec::from_photograph("photo".into(), &photo, typed, lens, spec.size_m, spec.pose).unwrap();
        let mut configured = setup(&scene);
        configured.stage = body(vec![surface]);
        let samples = track_rows(configured, &rows);
        let tracked: Vec<_> = samples.iter().filter(|s| s.state == State::Tracking).collect();
        let nees = tracked.iter().map(|s| nees_per_freedom(&scene, s)).sum::<f64>() / tracked.len().max(1) as f64;
        println!("{off:?}: {} of 24, NEES / 6 {nees:.2}", tracked.len());
        assert!(tracked.len() >= 23 && nees < 3.0, "{off:?}: {} of 24, NEES / 6 {nees:.2}", tracked.len());
    }
}
