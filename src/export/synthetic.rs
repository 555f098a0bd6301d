//! A short take with gaps, a lens that is not centred, and a stage with cloth, for tests.

use image::GrayImage;
use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use serde_json::json;

use super::scenery::Scenery;
use super::take::Take;
use crate::camera::Intrinsics;
use crate::geometry::{Camera, Pose, Stage};
use crate::track::{BodySpec, SurfaceSpec, folds};

/// Rows of the take that have no pose.
pub const MISSING: [usize; 4] = [0, 5, 6, 11];

pub fn lens() -> Intrinsics {
    Intrinsics {
        width: 960,
        height: 540,
        fx: 810.5,
        fy: 807.25,
        cx: 491.3,
        cy: 260.8,
        skew: 0.0,
        distortion: [-0.1, 0.05, 1e-3, -2e-3, 0.0],
    }
}

/// The same with square pixels and the principal point in the middle.
pub fn centred_lens() -> Intrinsics {
    Intrinsics { fy: 810.5, cx: 479.5, cy: 269.5, ..lens() }
}

pub fn pose(row: usize) -> Pose<Stage, Camera> {
    let t = row as f64;
    let upstage = UnitQuaternion::from_scaled_axis(Vector3::x() * -std::f64::consts::FRAC_PI_2);
    let turn = UnitQuaternion::from_euler_angles(0.03 * t, 0.2 - 0.04 * t, 0.5 * t);
    Pose::new(upstage * turn, Vector3::new(0.3 - 0.1 * t, -5.0 + 0.2 * t, 1.4 + 0.01 * t))
}

/// Twelve rows at 29.97 frames per second whose stamps scatter; the object is seen in rows 1 to 3.
pub fn text() -> String {
    let row = |k: usize| {
        let stamp = 5_000_000_000 + (k as f64 * 1001.0 / 30_000.0 * 1e9).round() as i64 + [0, 90_000, -40_000][k % 3];
        let state = if MISSING.contains(&k) { "lost" } else { "tracking" };
        let placed = Some(pose(k)).filter(|_| state == "tracking");
        let prop = Some(pose(k + 20)).filter(|_| (1..4).contains(&k));
        let prop = json!({"name": "prop \"1\"", "state": if prop.is_some() { "tracking" } else { "lost" }, "pose": prop});
        json!({"sequence": k, "timestamp_ns": stamp, "state": state, "pose": placed, "objects": [prop]}).to_string() + "\n"
    };
    (0..12).map(row).collect()
}

pub fn take() -> Take {
    Take::parse(text().into_bytes()).unwrap()
}

/// A folded backdrop and a flat.
pub fn stage() -> BodySpec {
    let upright = UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::FRAC_PI_2);
    let surface = |name: &str, size_m: [f64; 2], at: Vector3<f64>| {
        SurfaceSpec::from_any_artwork(name.to_owned(), GrayImage::new(80, 64), size_m, Pose::new(upright, at)).unwrap()
    };
    let mut cloth = surface("cloth.png", [4.0, 3.0], Vector3::new(0.0, 0.5, 1.5));
    cloth.shape = folds();
    BodySpec::new("stage", vec![cloth, surface("flat 2.png", [1.1, 1.7], Vector3::new(1.0, -0.5, 0.85))])
}

pub fn scenery() -> Scenery {
    let prop = BodySpec::new("prop \"1\"", vec![stage().surfaces.remove(1)]);
    Scenery::new(&stage(), &[prop], vec![vec![0; 5], vec![1; 5]], vec![vec![vec![7; 3]]], "take")
}

/// The corners of all surfaces of the stage, metres.
pub fn corners() -> Vec<Vector3<f64>> {
    scenery().stage.iter().flat_map(|sheet| sheet.mesh.corners()).collect()
}

/// Projects a point as the tracker does, to undistorted pixels.
pub fn project(lens: &Intrinsics, t_stage_camera: &Pose<Stage, Camera>, point: &Point3<f64>) -> Vector2<f64> {
    let p = t_stage_camera.inverse().transform(point);
    assert!(p.z > 0.5, "{p} is in front of the camera");
    Vector2::new(lens.fx * p.x / p.z + lens.cx, lens.fy * p.y / p.z + lens.cy)
}
