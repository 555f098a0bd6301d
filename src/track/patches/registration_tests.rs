use nalgebra::Vector3;

use super::*;
use crate::camera::CameraModel;
use crate::camera::Normalized;
use crate::geometry::resection::perturbed;
use crate::track::scene::bilinear::bilinear;
use crate::track::synthetic::{cloth, facing, lens, prepared, texture, view};
use nalgebra::Vector6;

fn projected(pose: &Pose<Camera, Body>, camera: &CameraModel, point: &Point3<f64>) -> Vector2<f64> {
    let c = pose.transform(point);
    camera.project(Normalized(Vector2::new(c.x / c.z, c.y / c.z))).0
}

fn truth() -> Pose<Camera, Body> {
    facing(0.2, -0.3, Vector3::new(0.1, 0.05, 3.4))
}

/// A start some three pixels off.
fn nearby() -> Pose<Camera, Body> {
    perturbed(&truth(), &Vector6::new(0.01, -0.008, 0.02, 0.004, -0.003, 0.002))
}

fn registered(body: &PreparedBody, frame: &GrayImage, scale: f64, start: &Pose<Camera, Body>, camera: &CameraModel) -> Vec<Registered> {
    let picture = SearchPicture { image: frame, scale, mask: None };
    let mut targets = Vec::new();
    visible_targets(body, start, camera, &picture, 200, &mut targets);
    let mut found = Vec::new();
    register(body, &targets, &picture, &Workers::new(1), &mut found);
    found.into_iter().flatten().collect()
}

/// Returns the root mean square distance of the fitting anchors from the truth, pixels, and the
/// fraction that fits.
fn scatter(body: &PreparedBody, camera: &CameraModel, all: &[Registered]) -> (f64, f64) {
    let squared = |r: &Registered| {
        let point = body.surfaces[r.surface as usize].spec.body_point(r.artwork);
        r.observation.map(|o| (o.pixel - projected(&truth(), camera, &point)).norm_squared())
    };
    let squares: Vec<f64> = all.iter().filter_map(squared).collect();
    ((squares.iter().sum::<f64>() / squares.len() as f64).sqrt(), squares.len() as f64 / all.len() as f64)
}

#[test]
fn tilted_patches_register_to_a_twentieth_of_a_pixel() {
    let (body, camera) = (prepared(vec![cloth(1)]), lens(480, 360));
    let frame = view(&body.surfaces[0].spec, &truth(), &camera);
    let all = registered(&body, &frame, 1.0, &nearby(), &camera);
    let moved = all.iter().map(|r| (r.predicted - projected(&truth(), &camera, &body.surfaces[0].spec.body_point(r.artwork))).norm());
    assert!(moved.fold(0.0, f64::max) > 2.0, "the start must be wrong for the test to say anything");
    let (rms, share) = scatter(&body, &camera, &all);
    println!("{} anchors, {share:.2} fit, {rms:.4} px", all.len());
    assert!(all.len() > 100 && share > 0.9 && rms < 0.05, "{} {share} {rms}", all.len());
}

#[test]
fn light_does_not_move_a_patch() {
    let (body, camera) = (prepared(vec![cloth(1)]), lens(480, 360));
    let bright = view(&body.surfaces[0].spec, &truth(), &camera);
    for (gain, bias) in [(0.35, 10.0), (0.7, 60.0)] {
        let mut frame = bright.clone();
        frame.iter_mut().for_each(|g| *g = (f64::from(*g) * gain + bias).round() as u8);
        let (rms, share) = scatter(&body, &camera, &registered(&body, &frame, 1.0, &nearby(), &camera));
        println!("gain {gain}: {share:.2} fit, {rms:.4} px");
        assert!(share > 0.9 && rms < 0.06, "{gain} {bias}: {share} {rms}");
    }
}

#[test]
fn half_size_registration_reports_full_size_pixels() {
    let (body, camera) = (prepared(vec![cloth(1)]), lens(640, 480));
    let half = crate::features::halved(&view(&body.surfaces[0].spec, &truth(), &camera));
    let (rms, share) = scatter(&body, &camera, &registered(&body, &half, 2.0, &nearby(), &camera));
    assert!(share > 0.8 && rms < 0.12, "{share} {rms}");
}

#[test]
fn another_picture_fits_nowhere() {
    let (body, camera) = (prepared(vec![cloth(1)]), lens(480, 360));
    let negative = {
        let mut frame = view(&body.surfaces[0].spec, &truth(), &camera);
        frame.iter_mut().for_each(|g| *g = 255 - *g);
        frame
    };
    for frame in [texture(480, 360, 77), negative, GrayImage::from_pixel(480, 360, image::Luma([128]))] {
        let all = registered(&body, &frame, 1.0, &truth(), &camera);
        let fitting = all.iter().filter(|r| r.observation.is_some()).count();
        assert!(all.len() > 100 && 20 * fitting < all.len(), "{fitting} of {}", all.len());
    }
}

#[test]
fn hidden_masked_and_back_facing_anchors_are_skipped() {
    let mut front = cloth(2);
    front.pose = Pose::new(nalgebra::UnitQuaternion::identity(), Vector3::new(-1.5, 0.0, 0.5));
    front.size_m = [1.0, 3.2];
    let (body, camera) = (prepared(vec![cloth(1), front]), lens(480, 360));
    let pose = facing(0.0, 0.0, Vector3::new(0.0, 0.0, 4.2));
    let image = GrayImage::new(480, 360);
    let mask = GrayImage::from_fn(480, 360, |x, _| image::Luma([if x < 240 { 255 } else { 0 }]));
    let mut targets = Vec::new();
    visible_targets(&body, &pose, &camera, &SearchPicture { image: &image, scale: 1.0, mask: Some(&mask) }, 1000, &mut targets);
    assert!(targets.iter().any(|t| t.surface == 0) && targets.iter().any(|t| t.surface == 1));
    for t in &targets {
        assert!(t.predicted.x < 240.5, "masked");
        let behind = t.surface == 0 && (-2.2..-1.15).contains(&t.point.x);
        assert!(!behind, "hidden at {}", t.point);
    }
    // From behind, nothing is painted.
    let rotated = facing(0.0, std::f64::consts::PI, Vector3::new(0.0, 0.0, 4.2));
    visible_targets(&body, &rotated, &camera, &SearchPicture { image: &image, scale: 1.0, mask: None }, 1000, &mut targets);
    assert!(targets.is_empty());
}

#[test]
fn a_drawn_patch_equals_per_pixel_lookups() {
    let (body, camera) = (prepared(vec![cloth(1)]), lens(480, 360));
    let frame = view(&body.surfaces[0].spec, &truth(), &camera);
    let picture = SearchPicture { image: &frame, scale: 1.0, mask: None };
    let mut targets = Vec::new();
    visible_targets(&body, &truth(), &camera, &picture, 20, &mut targets);
    let octaves = &body.surfaces[0].octaves;
    let mut drawn = targets.iter().filter_map(|target| Some((target, draw(target, octaves, 1.0)?))).peekable();
    assert!(drawn.peek().is_some());
    for (target, drawn) in drawn {
        // The octave whose pixels are half as wide as a pixel of the patch.
        let footprint = target.artwork_by_frame.determinant().abs().sqrt();
        let octave = ((0.5 * footprint).log2().round().max(0.0) as usize).min(octaves.len() - 1);
        let by_octave = 1.0 / f64::from(1u32 << octave);
        for (k, value) in drawn.iter().enumerate() {
            let middle =
                Vector2::new((k % BORDERED_SIDE) as f64, (k / BORDERED_SIDE) as f64) - Vector2::repeat(f64::from(PATCH_RADIUS + 1));
            let looks = SUBPIXEL_OFFSETS.map(|[x, y]| {
                let artwork = target.artwork + target.artwork_by_frame * (middle + Vector2::new(f64::from(x), f64::from(y)));
                let place = (artwork + Vector2::repeat(0.5)) * by_octave - Vector2::repeat(0.5);
                bilinear(&octaves[octave].image, place.x as f32, place.y as f32)
            });
            let mean = looks.iter().sum::<f32>() / 4.0;
            assert!((value - mean).abs() < 0.05, "{k}: {value} {mean}");
        }
    }
}

#[test]
fn products_with_a_template_are_sums_over_its_pixels() {
    let (drawn, frame) = (texture(BORDERED_SIDE as u32, BORDERED_SIDE as u32, 4), texture(40, 30, 5));
    let wide: [f32; BORDERED_SIDE * BORDERED_SIDE] = std::array::from_fn(|k| f32::from(drawn.as_raw()[k]));
    let t = template(&wide).expect("texture enough");
    let (width, weights) = (frame.width() as usize, [0.3, 0.2, 0.35, 0.15]);
    // In the middle, and in the last rows and columns.
    for [i, j] in [[7, 5], [width - PATCH_SIDE - 1, frame.height() as usize - PATCH_SIDE - 1]] {
        let found = template_products(&t, &frame.as_raw()[j * width + i..], width, &weights);
        let mut sums = [0.0; 5];
        for (v, u) in (0..PATCH_SIDE).flat_map(|v| (0..PATCH_SIDE).map(move |u| (v, u))) {
            let at = |du: usize, dv: usize| f64::from(frame.get_pixel((i + u + du) as u32, (j + v + dv) as u32)[0]);
            let f = weights.iter().zip([at(0, 0), at(1, 0), at(0, 1), at(1, 1)]).map(|(w, grey)| f64::from(*w) * grey).sum::<f64>();
            let factors = [1.0, f, f64::from(t.value[v][u]), f64::from(t.gx[v][u]), f64::from(t.gy[v][u])];
            sums.iter_mut().zip(factors).for_each(|(sum, factor)| *sum += f * factor);
        }
        for (found, sum) in found.iter().zip(sums) {
            assert!((f64::from(*found) - sum).abs() < 1e-5 * sums[1], "{found} {sum}");
        }
    }
}
