use nalgebra::UnitQuaternion;

use super::*;
use crate::track::synthetic::{facing, lens, light_of, texture, view};
use nalgebra::Vector3;

fn upright() -> Pose<Body, SurfaceFrame> {
    Pose::new(UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2), Vector3::new(0.0, 1.0, 2.0))
}

fn artwork(picture: GrayImage) -> Result<SurfaceSpec, SurfaceError> {
    SurfaceSpec::from_artwork("art".into(), picture, [4.0, 3.0], upright())
}

fn photo(corners: [[f64; 2]; 4]) -> Result<SurfaceSpec, SurfaceError> {
    let corners = corners.map(|c| Pixel(Vector2::from(c)));
    SurfaceSpec::from_photograph("photo".into(), &texture(320, 240, 3), corners, lens(320, 240), [4.0, 3.0], upright())
}

#[test]
fn metres_span_the_outer_edges() {
    let spec = artwork(texture(400, 300, 1)).unwrap();
    assert_eq!(spec.to_metres(Vector2::new(-0.5, -0.5)), Vector2::new(-2.0, 1.5));
    assert_eq!(spec.to_metres(Vector2::new(399.5, 299.5)), Vector2::new(2.0, -1.5));
    let p = Vector2::new(12.25, 77.5);
    assert!((spec.to_artwork(spec.to_metres(p)) - p).norm() < 1e-12);
    // Upright at (0, 1, 2): the top left corner is up and left, at the depth of the centre.
    assert!((spec.body_point(Vector2::new(-0.5, -0.5)) - Point3::new(-2.0, 1.0, 3.5)).norm() < 1e-12);
}

#[test]
fn pictures_without_texture_are_refused() {
    assert!(matches!(artwork(GrayImage::from_pixel(400, 300, image::Luma([90]))), Err(SurfaceError::Textureless { found: 0, .. })));
    // Two long edges have no corners either.
    let stripes = GrayImage::from_fn(400, 300, |x, _| image::Luma([if (100..200).contains(&x) { 200 } else { 20 }]));
    assert!(matches!(artwork(stripes), Err(SurfaceError::Textureless { .. })));
    assert_eq!(artwork(texture(63, 300, 1)).unwrap_err(), SurfaceError::TooSmall { width: 63, height: 300, least: 64 });
}

#[test]
fn invalid_sizes_are_refused() {
    for size in [[0.0, 3.0], [4.0, -1.0], [f64::NAN, 3.0], [4.0, f64::INFINITY]] {
        let refused = SurfaceSpec::from_artwork("art".into(), texture(100, 100, 1), size, upright());
        assert!(matches!(refused, Err(SurfaceError::Size(_))), "{size:?}");
    }
}

#[test]
fn bad_corners_are_refused() {
    assert!(photo([[20.0, 20.0], [300.0, 30.0], [290.0, 220.0], [25.0, 210.0]]).is_ok());
    // Counter-clockwise, crossed, dented, all on a line, two in one place.
    for corners in [
        [[20.0, 20.0], [25.0, 210.0], [290.0, 220.0], [300.0, 30.0]],
        [[20.0, 20.0], [290.0, 220.0], [300.0, 30.0], [25.0, 210.0]],
        [[20.0, 20.0], [300.0, 30.0], [60.0, 50.0], [25.0, 210.0]],
        [[20.0, 20.0], [100.0, 20.0], [200.0, 20.0], [300.0, 20.0]],
        [[20.0, 20.0], [20.0, 20.0], [290.0, 220.0], [25.0, 210.0]],
    ] {
        assert!(matches!(photo(corners).unwrap_err(), SurfaceError::Corners(_)), "{corners:?}");
    }
    // If a clockwise order exists, the message names it.
    let upright = [[20.0, 20.0], [300.0, 30.0], [290.0, 220.0], [25.0, 210.0]];
    for order in [[0, 3, 2, 1], [1, 0, 3, 2], [0, 2, 1, 3]] {
        assert_eq!(photo(order.map(|k| upright[k])).unwrap_err(), SurfaceError::Corners(Some(upright)), "{order:?}");
    }
    let outside = photo([[20.0, 20.0], [300.0, 30.0], [290.0, 241.0], [25.0, 210.0]]).unwrap_err();
    assert_eq!(outside, SurfaceError::CornerOutside { number: 3, u: 290.0, v: 241.0 });
    assert!(matches!(
        photo([[f64::NAN, 20.0], [300.0, 30.0], [290.0, 220.0], [25.0, 210.0]]),
        Err(SurfaceError::CornerOutside { number: 1, .. })
    ));
}

#[test]
fn a_photographed_checkerboard_is_rectified() {
    let checker = GrayImage::from_fn(640, 480, |x, y| image::Luma([if (x / 40 + y / 40) % 2 == 0 { 40 } else { 210 }]));
    let flat = SurfaceSpec::from_artwork("checker".into(), checker, [4.0, 3.0], Pose::identity()).unwrap();
    let (camera, pose) = (lens(640, 480), facing(0.25, -0.35, Vector3::new(0.1, -0.05, 6.0)));
    let corners = [(-0.5, -0.5), (639.5, -0.5), (639.5, 479.5), (-0.5, 479.5)].map(|(u, v)| {
        let c = pose.transform(&flat.body_point(Vector2::new(u, v)));
        camera.project(Normalized(Vector2::new(c.x / c.z, c.y / c.z)))
    });
    let seen = view(&flat, &pose, &camera);
    let laid = SurfaceSpec::from_photograph("photo".into(), &seen, corners, camera, [4.0, 3.0], Pose::identity()).unwrap();
    let ReferenceKind::Photograph { pose: seen_from, .. } = &laid.kind else { panic!("it is a photograph") };
    assert!((seen_from.translation - pose.translation).norm() < 1e-6 && seen_from.rotation.angle_to(&pose.rotation) < 1e-6);
    // The middle of every square is where the artwork has it; every edge is crossed half way
    // between two middles.
    for (i, k) in (0..15).flat_map(|i| (0..12).map(move |k| (i, k))) {
        let middle = laid.to_artwork(flat.to_metres(Vector2::new(f64::from(40 * i) + 19.5, f64::from(40 * k) + 19.5)));
        let next = laid.to_artwork(flat.to_metres(Vector2::new(f64::from(40 * i) + 59.5, f64::from(40 * k) + 19.5)));
        let levels: Vec<f64> = (middle.x.round() as u32..=next.x.round() as u32)
            .map(|x| f64::from(laid.artwork.get_pixel(x, middle.y.round() as u32)[0]))
            .collect();
        let (first, last) = if (i + k) % 2 == 0 { (40.0, 210.0) } else { (210.0, 40.0) };
        assert!((levels[0] - first).abs() < 12.0 && (levels[levels.len() - 1] - last).abs() < 12.0, "{i} {k}: {levels:?}");
        // The area under the step of light is the position of the edge.
        let [first, last] = [first, last].map(light_of);
        let before = levels.iter().map(|l| (light_of(*l) - last) / (first - last)).sum::<f64>();
        let edge = middle.x.round() - 0.5 + before;
        let expected = 0.5 * (middle.x + next.x);
        assert!((edge - expected).abs() < 0.15, "square {i}, {k}: edge at {edge}, not {expected}");
    }
}
