use nalgebra::Point3;

use super::*;
use crate::camera::{Intrinsics, Normalized};
use crate::simulate::{
    CameraPath, MovingObject, ObjectPath, Occluder, Person, Roll, SensorNoise, Spline, Spot, ToneCurve, artwork_surface, look_at, upright,
};
use crate::track::BodySpec;

/// Size of the pictures, pixels.
const WIDTH: u32 = 200;
/// See [`WIDTH`].
const HEIGHT: u32 = 150;

fn camera(distortion: [f64; 5]) -> CameraModel {
    CameraModel::new(Intrinsics { width: WIDTH, height: HEIGHT, fx: 180.0, fy: 182.0, cx: 101.3, cy: 73.8, skew: 0.002, distortion })
        .unwrap()
}

/// A dark and light checker for a cloth of 3 x 2 m: 2.5 mm per texel, so that an edge is sharp in
/// the picture.
fn checker(cell_px: u32) -> GrayImage {
    GrayImage::from_fn(1200, 800, |x, y| image::Luma([if (x / cell_px + y / cell_px).is_multiple_of(2) { 30 } else { 220 }]))
}

/// Averages grey levels, so that the area under a step of grey is the place of an edge.
fn stage_of(artwork: GrayImage, camera: CameraModel, path: CameraPath) -> VirtualStage {
    let surface = artwork_surface("cloth", artwork, [3.0, 2.0], upright(Vector3::zeros(), 0.0));
    let mut stage = VirtualStage::new(camera, path, BodySpec::new("stage", vec![surface]));
    stage.light_model = LightModel::GreyAverages;
    stage
}

fn oblique() -> CameraPath {
    let mut path = CameraPath::fixed(Point3::new(0.6, -1.7, 0.2), Point3::new(0.1, 0.0, 0.0));
    path.roll_rad = 0.05;
    path
}

/// Projects a point of the artwork to raw pixels, without the renderer.
fn projected(scene: &VirtualStage, u: f64, v: f64, time_s: f64) -> Vector2<f64> {
    let point = scene.stage.surfaces[0].body_point(Vector2::new(u, v));
    let seen = scene.truth(time_s).inverse().transform(&point);
    scene.camera.project(Normalized(Vector2::new(seen.x / seen.z, seen.y / seen.z))).0
}

#[test]
fn rendered_edges_are_at_their_projection() {
    // One vertical edge: artwork left of column 700 is dark, right of it light.
    let artwork = GrayImage::from_fn(1200, 800, |x, _| image::Luma([if x < 700 { 30 } else { 220 }]));
    let mut scene = stage_of(artwork, camera([-0.25, 0.08, 0.002, -0.001, 0.01]), oblique());
    scene.samples = 16;
    let renderer = Renderer::new(scene);
    let mut checked = 0;
    for row in (10..HEIGHT as usize - 10).step_by(7) {
        // Find where the edge crosses this row by walking along it in the artwork.
        let crossing =
            (0..=8000).map(|v| projected(renderer.stage(), 699.5, f64::from(v) * 0.1, 0.0)).find(|p| (p.y - row as f64).abs() < 0.02);
        let Some(expected) = crossing else { continue };
        let light = renderer.light_of_row(0.0, row);
        let (from, to) = (expected.x as usize - 6, expected.x as usize + 7);
        // The area under the step gives its position: every pixel covers ±0.5.
        let dark: f32 = light[from..=to].iter().map(|&g| (220.0 - g) / 190.0).sum();
        let found = from as f64 - 0.5 + f64::from(dark);
        assert!((found - expected.x).abs() < 0.05, "row {row}: found {found}, projected {}", expected.x);
        checked += 1;
    }
    assert!(checked > 10);
}

#[test]
fn a_distant_checkerboard_averages_to_grey() {
    let mut scene = stage_of(checker(4), camera([0.0; 5]), CameraPath::fixed(Point3::new(0.0, -12.0, 0.0), Point3::origin()));
    scene.samples = 8;
    let renderer = Renderer::new(scene);
    let row = renderer.light_of_row(0.0, 74);
    let inside = &row[90..110];
    let mean = inside.iter().sum::<f32>() / inside.len() as f32;
    assert!((mean - 125.0).abs() < 2.0, "mean {mean}");
    assert!(inside.iter().all(|g| (g - 125.0).abs() < 25.0), "glitters: {inside:?}");
}

#[test]
fn a_frame_renders_identically_in_any_order() {
    let mut scene = stage_of(checker(20), camera([-0.1, 0.0, 0.0, 0.0, 0.0]), oblique());
    scene.noise = SensorNoise::webcam();
    let renderer = Renderer::new(scene.clone());
    let first = renderer.render(0.4, 12);
    let other = renderer.render(0.4, 13);
    assert_ne!(first, other);
    let again = Renderer::new(scene);
    assert_eq!(again.render(0.4, 13), other);
    assert_eq!(again.render(0.4, 12), first);
}

#[test]
fn rolling_shutter_delays_rows_as_stated() {
    let keys = [(-1.0, Vector3::new(-1.2, -2.0, 0.0)), (1.0, Vector3::new(1.2, -2.0, 0.0))];
    let mut path = CameraPath::fixed(Point3::origin(), Point3::origin());
    path.position = Spline::new(&keys).unwrap();
    path.target = Spline::new(&keys.map(|(t, p)| (t, p + Vector3::y()))).unwrap();
    let artwork = GrayImage::from_fn(1200, 800, |x, _| image::Luma([if x < 600 { 30 } else { 220 }]));
    let mut scene = stage_of(artwork, camera([0.0; 5]), path);
    (scene.shutter.readout_s, scene.samples) = (0.04, 16);
    let renderer = Renderer::new(scene);
    // At 1.2 m/s and 2 m the edge moves left by 108 px/s, and a row is early or late by up to 20
    // ms.
    for (row, late_s) in [(0, -0.02), (149, 0.02), (30, 0.04 * (30.0 / 149.0 - 0.5))] {
        let light = renderer.light_of_row(0.0, row);
        let dark: f32 = light[60..140].iter().map(|&g| (220.0 - g) / 190.0).sum();
        let found = 59.5 + f64::from(dark);
        // Skew shears the picture: x depends on the row, equally at every instant.
        let y = (row as f64 - 73.8) / 182.0;
        let expected = 101.3 + 180.0 * (0.002 * y - 0.6 * late_s);
        assert!((found - expected).abs() < 0.05, "row {row}: {found}, not {expected}");
    }
}

#[test]
fn the_exposure_blurs_an_edge_along_its_path() {
    let keys = [(-1.0, Vector3::new(-1.2, -2.0, 0.0)), (1.0, Vector3::new(1.2, -2.0, 0.0))];
    let mut path = CameraPath::fixed(Point3::origin(), Point3::origin());
    path.position = Spline::new(&keys).unwrap();
    path.target = Spline::new(&keys.map(|(t, p)| (t, p + Vector3::y()))).unwrap();
    let artwork = GrayImage::from_fn(1200, 800, |x, _| image::Luma([if x < 600 { 30 } else { 220 }]));
    let mut scene = stage_of(artwork, camera([0.0; 5]), path);
    (scene.shutter.exposure_s, scene.samples) = (0.1, 64);
    let light = Renderer::new(scene).light_of_row(0.0, 74);
    // 108 px/s for 0.1 s: a ramp 10.8 px wide, centred on the edge at the stamp.
    let ramp = light.iter().filter(|&&g| (32.0..218.0).contains(&g)).count();
    assert!((10..=13).contains(&ramp), "{ramp} px");
    let dark: f32 = light[60..140].iter().map(|&g| (220.0 - g) / 190.0).sum();
    assert!((59.5 + dark - 101.3).abs() < 0.1);
}

#[test]
fn nearer_things_hide_farther_ones() {
    let white = GrayImage::from_pixel(64, 64, image::Luma([200]));
    let path = CameraPath::fixed(Point3::new(0.0, -3.0, 0.0), Point3::origin());
    let mut scene = stage_of(checker(1200), camera([0.0; 5]), path);
    let prop = artwork_surface("prop", white, [0.4, 0.4], upright(Vector3::zeros(), 0.0));
    let keys = [(0.0, Vector3::new(-0.5, -1.0, 0.0)), (1.0, Vector3::new(0.5, -1.0, 0.0))];
    let way = ObjectPath { position: Spline::new(&keys).unwrap(), rotation_rad: 0.0, angular_velocity_rad_s: 0.0 };
    scene.objects.push(MovingObject { body: BodySpec::new("prop", vec![prop]), path: way });
    let centre = Point3::new(0.0, -2.0, 0.0);
    scene.occluders.push(Occluder { centre, swing: Vector3::zeros(), period_s: 1.0, half_size_m: [0.05, 0.2], grey: 90.0 });
    let renderer = Renderer::new(scene);
    let level = |x: u32, time_s: f64| renderer.render(time_s, 0).get_pixel(x, 74)[0];
    // The prop at 2 m, x = ±0.5 m, is at 101 ± 45 px; the cloth is dark.
    assert_eq!([level(56, 0.0), level(146, 0.0)], [200, 30]);
    assert_eq!([level(56, 1.0), level(146, 1.0)], [30, 200]);
    // The ellipse is nearer than the prop that passes behind it.
    assert_eq!([level(101, 0.0), level(101, 0.5), level(118, 0.5)], [90, 90, 200]);
    assert_eq!(renderer.stage().object_truth(0, 1.0).unwrap().translation, Vector3::new(0.5, -1.0, 0.0));
}

#[test]
fn the_back_of_a_surface_is_unpainted() {
    let mut scene = stage_of(checker(1200), camera([0.0; 5]), CameraPath::fixed(Point3::new(0.0, 3.0, 0.0), Point3::origin()));
    scene.background = 7.0;
    let picture = Renderer::new(scene).render(0.0, 0);
    assert_eq!(picture.get_pixel(101, 74)[0], BACK_GREY as u8);
    assert_eq!(picture.get_pixel(0, 74)[0], 7);
}

#[test]
fn light_and_blackouts_reach_the_picture() {
    let mut scene = stage_of(checker(1200), camera([0.0; 5]), oblique());
    scene.light = vec![crate::simulate::LightKey { time_s: 0.0, gain: 2.0 }];
    scene.blackouts = vec![1.0..2.0];
    let renderer = Renderer::new(scene);
    assert_eq!([0.0, 1.0, 2.0].map(|t| renderer.render(t, 0).get_pixel(101, 74)[0]), [60, 4, 60]);
}

#[test]
fn the_true_pose_follows_the_path() {
    let scene = stage_of(checker(50), camera([0.0; 5]), CameraPath::fixed(Point3::new(0.3, -2.0, 0.1), Point3::origin()));
    assert_eq!(scene.truth(0.7), look_at(Point3::new(0.3, -2.0, 0.1), Point3::origin(), 0.0));
}

#[test]
fn a_moving_picture_is_rendered_at_the_paths_mean_position() {
    // Fine detail with a long exposure, during which the camera moves by 2.5 pixels to the left or
    // to the right: both must see the same place. It is rolled so that edges take all sub-pixel
    // positions; at a single one the discrete rays would show.
    let seen = |speed: f64| {
        let along = |y: f64| Spline::straight(&[(-1.0, Vector3::new(-speed, y, 0.0)), (1.0, Vector3::new(speed, y, 0.0))]).unwrap();
        let path = CameraPath { position: along(-2.9), target: along(0.0), roll_rad: 0.1, shake: None };
        let mut scene = stage_of(checker(40), camera([0.0; 5]), path);
        (scene.shutter.exposure_s, scene.samples) = (0.02, 16);
        Renderer::new(scene).render(0.0, 0)
    };
    let (left, right) = (seen(-2.0), seen(2.0));
    let [mut difference, mut slopes] = [0.0; 2];
    for (x, y) in (1..WIDTH - 1).flat_map(|x| (0..HEIGHT).map(move |y| (x, y))) {
        let grey = |picture: &GrayImage, x: u32| f64::from(picture.get_pixel(x, y)[0]);
        let slope = 0.25 * (grey(&left, x + 1) - grey(&left, x - 1) + grey(&right, x + 1) - grey(&right, x - 1));
        difference += slope * (grey(&left, x) - grey(&right, x));
        slopes += slope * slope;
    }
    assert!((difference / slopes).abs() < 0.003, "{} pixels", difference / slopes);
}

/// Linear light without contrast.
const LINEAR: LightModel = LightModel::Linear(ToneCurve { contrast: 0.0 });

/// A cloth of one grey, head-on at 2 m: 90 pixels per metre.
fn plain(grey: u8, model: LightModel) -> VirtualStage {
    let path = CameraPath::fixed(Point3::new(0.0, -2.0, 0.0), Point3::origin());
    let mut scene = stage_of(GrayImage::from_pixel(60, 40, image::Luma([grey])), camera([0.0; 5]), path);
    scene.light_model = model;
    scene
}

#[test]
fn half_a_white_pixel_is_188_in_linear_light_and_128_where_greys_are_averaged() {
    let artwork = GrayImage::from_fn(1200, 800, |x, _| image::Luma([if x < 600 { 0 } else { 255 }]));
    let intrinsics = Intrinsics { width: 41, height: 31, fx: 40.0, fy: 40.0, cx: 20.0, cy: 15.0, skew: 0.0, distortion: [0.0; 5] };
    let grey = |model: LightModel| {
        let path = CameraPath::fixed(Point3::new(0.0, -2.0, 0.0), Point3::origin());
        let mut scene = stage_of(artwork.clone(), CameraModel::new(intrinsics).unwrap(), path);
        (scene.light_model, scene.samples) = (model, 16);
        Renderer::new(scene).render(0.0, 0).get_pixel(20, 15)[0]
    };
    let [linear, averaged] = [grey(LINEAR), grey(LightModel::GreyAverages)];
    // 127.5 rounds either way, depending on the rounding of the rays' sum.
    assert!(linear == 188 && (127..=128).contains(&averaged), "{linear} {averaged}");
}

#[test]
fn blur_adds_up_light() {
    // Every place within the edge's sweep is white for part of the exposure, in the middle for half
    // of it: 188.
    let artwork = GrayImage::from_fn(1200, 800, |x, _| image::Luma([if x < 600 { 0 } else { 255 }]));
    let keys = [(-1.0, Vector3::new(-1.2, -2.0, 0.0)), (1.0, Vector3::new(1.2, -2.0, 0.0))];
    let mut path = CameraPath::fixed(Point3::origin(), Point3::origin());
    path.position = Spline::new(&keys).unwrap();
    path.target = Spline::new(&keys.map(|(t, p)| (t, p + Vector3::y()))).unwrap();
    let mut scene = stage_of(artwork, camera([0.0; 5]), path);
    (scene.light_model, scene.shutter.exposure_s, scene.samples) = (LINEAR, 0.1, 64);
    let picture = Renderer::new(scene).render(0.0, 0);
    assert!((i32::from(picture.get_pixel(101, 74)[0]) - 188).abs() < 8, "{}", picture.get_pixel(101, 74)[0]);
}

#[test]
fn linear_light_keeps_greys_and_clips_at_full_light() {
    let grey = |of: u8, gain: f32| {
        let mut scene = plain(of, LINEAR);
        scene.light = vec![crate::simulate::LightKey { time_s: 0.0, gain }];
        Renderer::new(scene).render(0.0, 0).get_pixel(101, 74)[0]
    };
    assert_eq!([20, 100, 230].map(|of| grey(of, 1.0)), [20, 100, 230]);
    // Twice the light is not twice the grey level.
    assert_eq!([grey(100, 2.0), grey(200, 2.0)], [138, 255]);
}

#[test]
fn a_spot_lights_what_it_hits() {
    let mut scene = plain(100, LINEAR);
    let (lamp, aim) = (Point3::new(0.0, -4.0, 3.0), Point3::new(0.5, 0.0, 0.0));
    scene.spots = vec![Spot { lamp, aim, swing: Vector3::new(-1.0, 0.0, 0.0), period_s: 4.0, width_rad: 0.03, gain: 1.0 }];
    let renderer = Renderer::new(scene);
    let grey = |x: u32, time_s: f64| renderer.render(time_s, 0).get_pixel(x, 74)[0];
    // Half a metre aside is 45 pixels; a quarter of the period later the spot is on the other side.
    assert_eq!([grey(146, 0.0), grey(56, 0.0)], [138, 100]);
    assert_eq!([grey(146, 1.0), grey(56, 1.0)], [100, 138]);
}

#[test]
fn a_person_covers_what_is_behind_its_outline() {
    let mut scene = plain(100, LightModel::GreyAverages);
    let clothes = GrayImage::from_fn(20, 60, |_, y| image::Luma([if y < 30 { 220 } else { 30 }]));
    let swing = Vector3::new(0.5, 0.0, 0.0);
    let (centre, half_size_m) = (Point3::new(0.0, -1.0, 0.0), [0.1, 0.3]);
    scene.people = vec![Person { centre, swing, period_s: 4.0, phase: 0.0, half_size_m, clothes }];
    let renderer = Renderer::new(scene);
    let grey = |[x, y]: [u32; 2], time_s: f64| renderer.render(time_s, 0).get_pixel(x, y)[0];
    // At 1 m the person is 36 pixels wide and 109 high: light above, dark below, rounded at the
    // corners.
    assert_eq!([[101, 50], [101, 100], [86, 60]].map(|at| grey(at, 0.0)), [220, 30, 220]);
    assert_eq!([[80, 74], [122, 74], [86, 22], [116, 124]].map(|at| grey(at, 0.0)), [100; 4]);
    // A quarter of the period later it is half a metre to the right.
    assert_eq!([[101, 50], [191, 50]].map(|at| grey(at, 1.0)), [100, 220]);
}

#[test]
fn the_roll_turns_the_picture() {
    let mut scene = stage_of(checker(1200), camera([0.0; 5]), oblique());
    scene.roll = Some(Roll::new(&[(0.0, 0.0), (1.0, 0.4)]).unwrap());
    let mut rolled_path = scene.clone();
    rolled_path.roll = None;
    rolled_path.camera_path.roll_rad += 0.4;
    assert!(scene.truth(1.0).angle_to(&rolled_path.truth(1.0)) < 1e-12);
    let (ours, theirs) = (Renderer::new(scene).render(1.0, 0), Renderer::new(rolled_path).render(1.0, 0));
    // The two computations round differently.
    assert!(ours.iter().zip(theirs.iter()).all(|(a, b)| a.abs_diff(*b) <= 1));
}

/// The tests of `track` come before this module and have a plain sampler of their own.
#[test]
fn the_sampler_of_tracks_tests_renders_the_same_picture() {
    use crate::track::synthetic::{cloth, lens, view};
    let surface = SurfaceSpec { pose: upright(Vector3::zeros(), 0.1), ..cloth(1) };
    let path = CameraPath::fixed(Point3::new(0.9, -3.6, 0.4), Point3::new(0.1, 0.0, 0.1));
    let mut scene = VirtualStage::new(lens(240, 180), path, BodySpec::new("stage", vec![surface.clone()]));
    (scene.samples, scene.background) = (16, 30.0);
    let plain = view(&surface, &scene.truth(0.0).inverse().renamed(), &scene.camera);
    let differences = |rendered: &GrayImage| -> Vec<f64> {
        let mut all: Vec<f64> = rendered.pixels().zip(plain.pixels()).map(|(a, b)| f64::from(a[0].abs_diff(b[0]))).collect();
        all.sort_by(f64::total_cmp);
        all
    };
    let same = differences(&Renderer::new(scene.clone()).render(0.0, 0));
    let (mean, p95) = (same.iter().sum::<f64>() / same.len() as f64, same[same.len() * 95 / 100]);
    // A fifth of a pixel to the side.
    scene.camera_path = CameraPath::fixed(Point3::new(0.903, -3.6, 0.4), Point3::new(0.103, 0.0, 0.1));
    let moved = differences(&Renderer::new(scene).render(0.0, 0));
    let of_moved = moved.iter().sum::<f64>() / moved.len() as f64;
    println!("mean {mean:.3}, 95th percentile {p95}, moved {of_moved:.3}");
    assert!(mean < 0.6 && p95 <= 2.0 && of_moved > 3.0 * mean, "mean {mean}, 95th percentile {p95}, moved {of_moved}");
}
