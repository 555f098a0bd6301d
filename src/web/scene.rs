//! `GET /api/v1/scene`: the camera and the surfaces of the session, for whoever draws them.

use std::sync::{Mutex, PoisonError};

use nalgebra::Point3;
use serde_json::{Value, json};

use super::routes::Reply;
use crate::camera::CameraModel;
use crate::track::{BodySpec, SurfaceSpec};
use crate::tracker::TrackerSetup;

/// Points along each edge of a surface: where it is bent or the lens bends it, its outline is. Chosen for looks: a wide lens shows no corners.
/// Raised, a larger answer.
const PIECES: u32 = 16;

/// What is known of the session's scene; nothing before its camera is there.
#[derive(Debug, Default)]
pub(super) struct Scene(Mutex<Option<String>>);

impl Scene {
    /// From now on it is this one.
    pub fn set(&self, setup: &TrackerSetup) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(described(setup).to_string());
    }

    /// `GET /api/v1/scene`.
    pub fn reply(&self) -> Reply {
        match &*self.0.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(scene) => Reply::json(200, scene.as_str()),
            None => Reply::json(503, r#"{"error":"the camera has not been opened yet"}"#),
        }
    }
}

fn described(setup: &TrackerSetup) -> Value {
    let objects: Vec<Value> = setup.objects.iter().map(body).collect();
    json!({"camera": camera(&setup.camera), "stage": body(&setup.stage), "objects": objects})
}

/// The lens as a calibration file has it, and how far out its formula may be used.
fn camera(camera: &CameraModel) -> Value {
    let i = camera.intrinsics();
    json!({
        "width": i.width, "height": i.height, "fx": i.fx, "fy": i.fy, "cx": i.cx, "cy": i.cy, "skew": i.skew, "distortion": i.distortion,
        // Infinite without distortion, which JSON has no number for.
        "valid_radius": Some(camera.valid_radius()).filter(|radius| radius.is_finite()),
    })
}

fn body(body: &BodySpec) -> Value {
    let surfaces: Vec<Value> = body.surfaces.iter().map(surface).collect();
    json!({"name": body.name, "surfaces": surfaces})
}

fn surface(surface: &SurfaceSpec) -> Value {
    let (w, h) = surface.artwork.dimensions();
    json!({"name": surface.name, "size_m": surface.size_m, "pose": surface.pose, "picture_px": [w, h], "outline_m": outline(surface)})
}

/// Around the surface from its top left corner, in its body's frame, metres; the last point is before the first.
fn outline(surface: &SurfaceSpec) -> Vec<[f64; 3]> {
    let [w, h] = surface.size_m.map(|m| m / 2.0);
    let corners = [[-w, h], [w, h], [w, -h], [-w, -h]];
    let along = |edge: usize, k: u32| {
        let (from, to, share) = (corners[edge], corners[(edge + 1) % 4], f64::from(k) / f64::from(PIECES));
        let place = surface.shape.at([from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])]).place;
        surface.pose.transform(&Point3::from(place)).coords.into()
    };
    (0..4).flat_map(|edge| (0..PIECES).map(move |k| (edge, k))).map(|(edge, k)| along(edge, k)).collect()
}

#[cfg(test)]
mod tests {
    use image::GrayImage;
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::geometry::Pose;
    use crate::track::{ReferenceKind, SurfaceShape};

    fn setup() -> TrackerSetup {
        let upright = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
        let surface = SurfaceSpec {
            name: "backdrop.png".to_owned(),
            artwork: GrayImage::new(8, 6),
            size_m: [4.0, 3.0],
            pose: Pose::new(upright, Vector3::new(0.0, 0.0, 1.5)),
            kind: ReferenceKind::Artwork,
            shape: SurfaceShape::Flat,
        };
        let camera = CameraModel::pinhole(64, 48, 60.0, 61.0, 31.5, 23.5).unwrap();
        TrackerSetup::new(camera, BodySpec::new("stage", vec![surface]))
    }

    #[test]
    fn it_has_the_lens_and_the_outlines_in_the_stage() {
        let scene = Scene::default();
        assert_eq!(scene.reply().status, 503);
        scene.set(&setup());
        let told: Value = serde_json::from_slice(&scene.reply().body).unwrap();
        assert_eq!((&told["camera"]["fy"], &told["camera"]["valid_radius"]), (&61.0.into(), &Value::Null));
        let surface = &told["stage"]["surfaces"][0];
        let outline: Vec<[f64; 3]> = serde_json::from_value(surface["outline_m"].clone()).unwrap();
        assert_eq!((outline.len(), &surface["name"]), (64, &"backdrop.png".into()));
        // Upright before the origin: x right, z up.
        for (k, [x, z]) in [(0, [-2.0, 3.0]), (16, [2.0, 3.0]), (24, [2.0, 1.5]), (32, [2.0, 0.0]), (48, [-2.0, 0.0])] {
            let off = Vector3::from(outline[k]) - Vector3::new(x, 0.0, z);
            assert!(off.norm() < 1e-12, "{k}: {:?}", outline[k]);
        }
    }
}
