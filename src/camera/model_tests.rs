//! Tests of the camera model against hand calculation, finite differences and its own inverse.

use nalgebra::{Matrix2, Vector2};
use proptest::prelude::*;

use super::*;

/// The source thesis's camera (its results in chapter 4.3), with a 4288 x 2848 picture.
fn thesis_camera(skew: f64, k3: f64) -> CameraModel {
    CameraModel::new(Intrinsics {
        width: 4288,
        height: 2848,
        fx: 4178.76736,
        fy: 4185.21459,
        cx: 2191.16899,
        cy: 1412.23350,
        skew,
        distortion: [-0.13172, 0.21292, -0.00057, 0.00261, k3],
    })
    .unwrap()
}

fn webcam(skew: f64, distortion: [f64; 5]) -> CameraModel {
    CameraModel::new(Intrinsics { width: 1280, height: 720, fx: 900.0, fy: 910.0, cx: 650.0, cy: 350.0, skew, distortion }).unwrap()
}

/// Equations 5 to 10 computed in decimal arithmetic, independently of this program.
#[test]
fn equations_5_to_10_give_the_golden_numbers() {
    let near = |p: Pixel, x: f64, y: f64| assert!((p.0 - Vector2::new(x, y)).norm() < 1e-8, "{p:?} is not ({x}, {y})");
    let point = |x: f64, y: f64, z: f64| Normalized(Vector2::new(x / z, y / z));
    near(thesis_camera(0.0, 0.0).project(point(0.3, -0.2, 1.5)), 3022.7857296141, 857.2498850143);
    near(thesis_camera(0.001, 0.05).project(point(-0.9, 0.6, 2.0)), 356.0414668976, 2639.7900613361);
}

#[test]
fn kk_of_equation_10_matches_undistorted_projection() {
    let camera = webcam(0.01, [0.0; 5]);
    let ray = nalgebra::Vector3::new(0.2, -0.3, 1.0);
    let by_matrix = camera.k_matrix() * ray;
    let pixel = camera.project(Normalized(ray.xy())).0;
    assert!((by_matrix.xy() - pixel).norm() < 1e-12);
    assert_eq!(camera.k_matrix()[(0, 1)], 900.0 * 0.01);
}

#[test]
fn unproject_returns_none_beyond_the_valid_radius() {
    let camera = webcam(0.0, [-0.3, 0.0, 0.0, 0.0, 0.0]);
    let limit = (1.0f64 / 0.9).sqrt();
    assert!((camera.valid_radius() - limit).abs() < 1e-12);
    let rim = limit * (1.0 - 0.3 * limit * limit); // the largest distorted radius
    let pixel_at = |r: f64| Pixel(Vector2::new(900.0 * r + 650.0, 350.0));
    assert!(camera.unproject(pixel_at(0.99 * rim)).is_some());
    assert_eq!(camera.unproject(pixel_at(1.01 * rim)), None);
    assert_eq!(camera.unproject(pixel_at(1e9)), None);
    assert_eq!(camera.unproject(pixel_at(f64::NAN)), None);
}

#[test]
fn the_valid_radius_is_found_far_outside_the_picture() {
    let camera = webcam(0.0, [-1e-3, 0.0, 0.0, 0.0, 0.0]);
    assert!((camera.valid_radius() - (1.0f64 / 3e-3).sqrt()).abs() < 1e-9);
    assert_eq!(camera.unproject(Pixel(Vector2::new(1e6, 0.0))), None);
    assert!(webcam(0.0, [0.1, 0.0, 0.0, 0.0, 0.0]).valid_radius().is_infinite());
    assert_eq!(webcam(0.0, [0.1, 0.0, 0.0, 0.0, 0.0]).unproject(Pixel(Vector2::new(1e300, 0.0))), None);
}

#[test]
fn a_temporary_distortion_fold_limits_the_valid_radius() {
    // 1 - 3 s + 2 s² is negative between s = 0.5 and s = 1 only.
    let camera = webcam(0.0, [-1.0, 0.4, 0.0, 0.0, 0.0]);
    assert!((camera.valid_radius() - 0.5f64.sqrt()).abs() < 1e-12);
}

#[test]
fn invalid_intrinsics_are_refused() {
    let good = *webcam(0.0, [0.0; 5]).intrinsics();
    let refused = |change: fn(&mut Intrinsics)| {
        let mut bad = good;
        change(&mut bad);
        CameraModel::new(bad).unwrap_err()
    };
    assert!(matches!(refused(|i| i.fx = -1.0), CameraError::FocalLength { name: "fx", .. }));
    assert!(matches!(refused(|i| i.fy = 0.0), CameraError::FocalLength { name: "fy", .. }));
    assert!(matches!(refused(|i| i.cx = f64::NAN), CameraError::NotFinite { name: "cx", .. }));
    assert!(matches!(refused(|i| i.distortion[4] = f64::INFINITY), CameraError::NotFinite { name: "distortion k3", .. }));
    assert!(matches!(refused(|i| i.width = 0), CameraError::Size { .. }));
}

#[test]
fn another_aspect_ratio_is_refused() {
    assert!(matches!(webcam(0.0, [0.0; 5]).scaled_to(640, 480), Err(CameraError::Aspect { .. })));
    assert!(webcam(0.0, [0.0; 5]).scaled_to(0, 0).is_err());
}

/// Distortions from none to strong wide-angle barrel and pincushion, with skew and tangential
/// terms.
fn cameras() -> impl Strategy<Value = CameraModel> {
    (-0.02..0.02, -0.5..0.5, -0.3..0.3, -0.005..0.005, -0.005..0.005, -0.1..0.1)
        .prop_map(|(skew, k1, k2, p1, p2, k3)| webcam(skew, [k1, k2, p1, p2, k3]))
}

fn rays() -> impl Strategy<Value = Normalized> {
    (-0.9..0.9, -0.6..0.6).prop_map(|(x, y)| Normalized(Vector2::new(x, y)))
}

proptest! {
    #[test]
    fn jacobian_equals_differences(camera in cameras(), ray in rays()) {
        let (pixel, jacobian) = camera.project_with_jacobian(ray);
        prop_assert_eq!(pixel, camera.project(ray));
        const STEP: f64 = 1e-5;
        let along = |d: Vector2<f64>| {
            let at = |s: f64| camera.project(Normalized(ray.0 + d * (s * STEP))).0;
            (at(1.0) - at(-1.0)) / (2.0 * STEP)
        };
        let differences = Matrix2::from_columns(&[along(Vector2::x()), along(Vector2::y())]);
        prop_assert!((jacobian - differences).norm() < 1e-4, "{jacobian} is not {differences}");
    }

    #[test]
    fn rays_within_the_valid_radius_round_trip(camera in cameras(), ray in rays()) {
        let ray = Normalized(ray.0 * (0.9 * camera.valid_radius() / ray.0.norm()).min(1.0));
        let back = camera.unproject(camera.project(ray));
        prop_assert!(back.is_some_and(|b| (b.0 - ray.0).norm() < 1e-8), "{ray:?} came back as {back:?}");
    }

    #[test]
    fn without_tangential_terms_newton_starts_at_the_ray(camera in cameras(), ray in rays()) {
        let [k1, k2, _, _, k3] = camera.intrinsics().distortion;
        let radial = webcam(0.0, [k1, k2, 0.0, 0.0, k3]);
        let ray = ray.0 * (0.99 * radial.valid_radius() / ray.0.norm()).min(1.0);
        let start = radial.radial_start(radial.intrinsics().distort(Normalized(ray).0).0);
        prop_assert!(start.is_some_and(|start| (start - ray).norm() < 1e-4), "{ray:?} began at {start:?}");
    }

    #[test]
    fn unprojected_pixels_project_back(camera in cameras(), u in -100.0..1400.0, v in -100.0..820.0) {
        let pixel = Pixel(Vector2::new(u, v));
        if let Some(ray) = camera.unproject(pixel) {
            prop_assert!((camera.project(ray).0 - pixel.0).norm() < 1e-6);
            prop_assert!(ray.0.norm() <= camera.valid_radius());
        }
    }

    #[test]
    fn arbitrary_numbers_never_panic(k in prop::array::uniform5(-1e3..1e3f64), u in any::<f64>(), v in any::<f64>()) {
        let camera = webcam(0.0, k);
        let _ = camera.unproject(Pixel(Vector2::new(u, v)));
    }

    #[test]
    fn undistorted_pixels_round_trip(camera in cameras(), ray in rays()) {
        let back = camera.from_undistorted_pixel(camera.undistorted_pixel(ray));
        prop_assert!((back.0 - ray.0).norm() < 1e-12);
    }

    #[test]
    fn scaling_moves_pixels_by_the_half_pixel_rule(camera in cameras(), ray in rays(), double in any::<bool>()) {
        let s = if double { 2.0 } else { 0.5 };
        let scaled = camera.scaled_to((1280.0 * s) as u32, (720.0 * s) as u32).unwrap();
        let wanted = (camera.project(ray).0 + Vector2::repeat(0.5)) * s - Vector2::repeat(0.5);
        prop_assert!((scaled.project(ray).0 - wanted).norm() < 1e-9);
    }
}
