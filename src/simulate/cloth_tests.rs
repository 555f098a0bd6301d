use image::{GrayImage, Luma};
use nalgebra::{Point3, Vector1};

use super::*;
use crate::camera::{CameraModel, Normalized};
use crate::geometry::bspline::BicubicSpline;
use crate::geometry::{Pose, Stage, SurfaceFrame};
use crate::simulate::{CameraPath, Draught, LightModel, Renderer, VirtualStage, artwork_surface, upright};
use crate::track::{BentShape, BodySpec};

/// Size of the cloth, metres.
const SIZE_M: [f64; 2] = [3.0, 2.0];

/// Folds of up to 60 mm at a spacing of half a metre, and a print that is some millimetres too
/// long.
fn folds(height_m: f64) -> SurfaceShape {
    let mut height = BicubicSpline::zero([12, 8], SIZE_M);
    for (k, c) in height.coefficients_mut().iter_mut().enumerate() {
        *c = Vector1::new(height_m * (1.6 * (k % 15) as f64 + 0.4 * (k / 15) as f64).sin());
    }
    let mut stretch = BicubicSpline::zero([3, 2], SIZE_M);
    for (k, c) in stretch.coefficients_mut().iter_mut().enumerate() {
        *c = Vector2::new(0.1 * height_m * (k % 6) as f64, 0.05 * height_m * (k as f64).sin());
    }
    SurfaceShape::Bent(std::sync::Arc::new(BentShape { height, stretch, ways: Vec::new() }))
}

/// A running and a standing wave.
const WAVES: [Wave; 2] = [
    Wave { height_m: 0.03, wave_vector: [7.0, 2.0], rate_hz: 0.7, phase_rad: 0.4 },
    Wave { height_m: 0.01, wave_vector: [-3.0, 9.0], rate_hz: 0.0, phase_rad: 2.0 },
];

fn surface(artwork: GrayImage, shape: SurfaceShape) -> SurfaceSpec {
    SurfaceSpec { shape, ..artwork_surface("cloth", artwork, SIZE_M, upright(Vector3::zeros(), 0.0)) }
}

fn cloth(height_m: f64) -> Cloth {
    Cloth::of(&surface(GrayImage::new(120, 80), folds(height_m)), &WAVES).expect("it is bent")
}

#[test]
fn a_ray_intersects_the_surface_at_its_point() {
    let cloth = cloth(0.03);
    for k in 0..300 {
        let point = [f64::from(k % 20) * 0.14 - 1.3, f64::from(k / 20) * 0.12 - 0.85];
        let (eye, time_s) = (Vector3::new(-1.0 + 0.01 * f64::from(k), 0.3, 2.0), 0.01 * f64::from(k));
        let direction = (cloth.at(point, time_s).place - eye) * 0.37;
        let met = cloth.meet(&eye, &direction, 0.02, time_s).expect("it goes through the cloth");
        assert!((met.depth - 1.0 / 0.37).abs() < 1e-8, "{point:?} {met:?}");
        assert!((Vector2::from(met.on_picture_m) - Vector2::from(point)).norm() < 1e-8, "{point:?} {met:?}");
    }
}

/// Returns a ray's first crossing, found by ten thousand steps.
fn by_steps(cloth: &Cloth, eye: &Vector3<f64>, direction: &Vector3<f64>, time_s: f64) -> Option<f64> {
    let above = |depth: f64| {
        let place = eye + direction * depth;
        let point = cloth.beneath(&place, time_s);
        let is_on_it = (0..2).all(|axis| point[axis].abs() <= cloth.half_m[axis]);
        is_on_it.then(|| place.z > cloth.at(point, time_s).place.z)
    };
    let depth = |k: usize| 0.02 + 6.0 * k as f64 / 10_000.0;
    let passes = |k: &usize| matches!((above(depth(*k)), above(depth(k + 1))), (Some(before), Some(after)) if before != after);
    (0..10_000).find(passes).map(depth)
}

#[test]
fn a_fold_hides_what_is_behind_it() {
    let cloth = cloth(0.06);
    let (mut met, mut missed) = (0, 0);
    for k in 0..200 {
        // From the side, along the cloth, starting 0.2 m in front of it.
        let eye = Vector3::new(-2.0, -0.8 + 0.008 * f64::from(k), 0.2);
        let direction = Vector3::new(1.0, 0.05, -0.02 - 0.002 * f64::from(k % 50));
        let found = cloth.meet(&eye, &direction, 0.02, 0.3).map(|m| m.depth);
        let wanted = by_steps(&cloth, &eye, &direction, 0.3);
        match (found, wanted) {
            (Some(found), Some(wanted)) => assert!((found - wanted).abs() < 2e-3, "{k}: {found} {wanted}"),
            (None, None) => missed += 1,
            other => panic!("{k}: {other:?}"),
        }
        met += u32::from(found.is_some());
    }
    assert!(met > 100, "{met} met, {missed} passed by");
}

#[test]
fn a_cloth_without_folds_is_a_plane() {
    let artwork = GrayImage::from_fn(1200, 800, |x, y| Luma([((x * 7 + y * 13) % 200) as u8 + 20]));
    let picture = |shape: SurfaceShape| {
        let camera = CameraModel::pinhole(200, 150, 180.0, 182.0, 101.3, 73.8).unwrap();
        let path = CameraPath::fixed(Point3::new(0.6, -1.7, 0.2), Point3::new(0.1, 0.0, 0.0));
        Renderer::new(VirtualStage::new(camera, path, BodySpec::new("stage", vec![surface(artwork.clone(), shape)]))).render(0.0, 1)
    };
    assert!(Cloth::of(&surface(artwork.clone(), SurfaceShape::Flat), &[]).is_none());
    let (flat, bent) = (picture(SurfaceShape::Flat), picture(folds(0.0)));
    let different = flat.pixels().zip(bent.pixels()).filter(|(a, b)| a[0].abs_diff(b[0]) > 1).count();
    assert!(different == 0 && flat.pixels().any(|p| p[0] > 100), "{different}");
}

#[test]
fn edges_of_a_moving_cloth_are_at_their_projection() {
    // Artwork left of column 700 is dark, right of it light.
    let artwork = GrayImage::from_fn(1200, 800, |x, _| Luma([if x < 700 { 30 } else { 220 }]));
    let camera = CameraModel::pinhole(200, 150, 180.0, 182.0, 101.3, 73.8).unwrap();
    let path = CameraPath::fixed(Point3::new(0.6, -1.7, 0.2), Point3::new(0.1, 0.0, 0.0));
    let spec = surface(artwork, folds(0.03));
    let cloth = Cloth::of(&spec, &WAVES).expect("it is bent");
    let mut scene = VirtualStage::new(camera, path, BodySpec::new("stage", vec![spec]));
    scene.draughts = vec![Draught { surface: 0, waves: WAVES.to_vec() }];
    // Averages grey levels, so that the area under a step of grey is the place of an edge.
    (scene.light_model, scene.samples) = (LightModel::GreyAverages, 36);
    let renderer = Renderer::new(scene);
    let (mut checked, mut bent_by_px) = (0, 0.0_f64);
    for time_s in [0.0, 0.35, 0.8] {
        let image = renderer.render(time_s, 1);
        let in_stage: Pose<Stage, SurfaceFrame> = renderer.stage().stage.surfaces[0].pose.renamed();
        let pose = renderer.stage().truth(time_s).inverse() * in_stage;
        let projected = |point: Vector3<f64>| {
            let seen = pose.transform(&point.into());
            camera.project(Normalized(Vector2::new(seen.x / seen.z, seen.y / seen.z))).0
        };
        let edge_m = 699.5_f64.mul_add(SIZE_M[0] / 1200.0, 0.5 * SIZE_M[0] / 1200.0 - 0.5 * SIZE_M[0]);
        for row in (10..140).step_by(9) {
            let along = |k: i32| [edge_m, f64::from(k) * 2.5e-4];
            let seen = |k: i32| projected(cloth.at(along(k), time_s).place);
            let Some(k) = (-3990..3990).find(|k| (seen(*k).y - row as f64).abs() < 0.02) else { continue };
            let expected = seen(k);
            let flat = projected(Vector3::new(edge_m, along(k)[1], 0.0));
            bent_by_px = bent_by_px.max((flat - expected).norm());
            let (from, to) = (expected.x as u32 - 6, expected.x as u32 + 7);
            let dark: f64 = (from..=to).map(|x| (220.0 - f64::from(image.get_pixel(x, row)[0])) / 190.0).sum();
            let found = f64::from(from) - 0.5 + dark;
            assert!((found - expected.x).abs() < 0.08, "{time_s} s, row {row}: found {found}, projected {}", expected.x);
            checked += 1;
        }
    }
    assert!(checked > 20 && bent_by_px > 2.0, "{checked} {bent_by_px}");
}
