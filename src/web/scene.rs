//! `GET /api/v1/scene`: the session's camera and surfaces, for drawing them.
//! `GET /api/v1/surfaces/N/picture`: the pictures of the stage's surfaces, as the tracker knows
//! them. The pictures are prepared in parallel to the session's start, which does not wait for
//! them.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use image::GrayImage;
use image::imageops::{FilterType, resize};
use jpeg_encoder::{ColorType, Encoder};
use nalgebra::{Point3, Vector2};
use serde_json::{Value, json};

use super::packing::packed;
use super::reply::Reply;
use crate::camera::{CameraModel, Pixel};
use crate::track::{BodySpec, SurfaceShape, SurfaceSpec};
use crate::tracker::TrackerSetup;

/// Points along each edge of a surface's outline, which may be bent by the surface or the lens.
/// Chosen for looks: a wide lens shows no corners. Raised, a larger answer.
const PIECES: u32 = 16;
/// Points along each side of a bent surface's mesh. Chosen: a fold of a tenth of the width has
/// several. Raised, a larger answer.
const MESH: u32 = 33;
/// Maximum pixels along a picture's longer side. Chosen: a camera seldom sees more of a surface.
/// Raised, pages load longer.
const MAX_SIDE: u32 = 2048;
/// JPEG quality of the pictures, 1 to 100. Chosen: its blocks are far below what affects an
/// alignment. Raised, larger files.
const QUALITY: u8 = 92;

/// The session's scene; empty before its camera is there.
#[derive(Debug, Default)]
pub(super) struct Scene(Mutex<Known>);

#[derive(Debug, Default)]
struct Known {
    described: Option<Described>,
    /// The stage's pictures as JPEG, in the config's order; `None` until they are ready.
    pictures: Vec<Option<Vec<u8>>>,
    /// Counts sessions, to discard pictures of an earlier one.
    session: u64,
}

/// A scene as it is sent.
#[derive(Debug)]
struct Described {
    json: String,
    /// The same compressed by gzip: 7 kB of mostly digits of the outlines, which would be a tenth
    /// of the first view.
    packed: Vec<u8>,
}

impl Described {
    fn new(setup: &TrackerSetup) -> Self {
        let json = described(setup).to_string();
        Self { packed: packed(json.as_bytes()), json }
    }
}

impl Scene {
    fn known(&self) -> MutexGuard<'_, Known> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets the scene of a new session.
    pub fn set(self: &Arc<Self>, setup: &TrackerSetup) {
        let artworks: Vec<GrayImage> = setup.stage.surfaces.iter().map(|surface| surface.artwork.clone()).collect();
        let session = {
            let mut known = self.known();
            *known = Known { described: Some(Described::new(setup)), pictures: vec![None; artworks.len()], session: known.session + 1 };
            known.session
        };
        let scene = self.clone();
        let make = move || {
            for (k, artwork) in artworks.into_iter().enumerate() {
                let picture = jpeg(artwork);
                let mut known = scene.known();
                if known.session != session {
                    return;
                }
                known.pictures[k] = picture;
            }
        };
        if let Err(error) = std::thread::Builder::new().name("pictures".to_owned()).spawn(make) {
            tracing::warn!("[http]: the stage's pictures cannot be served ({error}); raise the limit of processes");
        }
    }

    /// `GET /api/v1/scene`, compressed by gzip for clients that accept it.
    pub fn reply(&self, is_packed: bool) -> Reply {
        match &self.known().described {
            Some(scene) if is_packed => {
                let reply = Reply::new(200, "application/json", scene.packed.clone());
                reply.with("content-encoding", "gzip").with("vary", "accept-encoding")
            }
            Some(scene) => Reply::json(200, scene.json.as_str()).with("vary", "accept-encoding"),
            None => Reply::json(503, r#"{"error":"the camera has not been opened yet"}"#),
        }
    }

    /// `GET /api/v1/surfaces/N/picture`.
    pub fn picture(&self, number: &str) -> Reply {
        let known = self.known();
        if known.described.is_none() {
            return Reply::text(503, "the camera has not been opened yet\n");
        }
        let picture = number.parse::<usize>().ok().and_then(|number| known.pictures.get(number));
        match picture {
            Some(Some(bytes)) => Reply::new(200, "image/jpeg", bytes.clone()),
            Some(None) => Reply::text(503, "the picture is being made ready; ask again in a second\n"),
            None => Reply::text(404, format!("the stage has {} surfaces, counted from 0\n", known.pictures.len())),
        }
    }
}

/// Returns a picture as JPEG, not larger than a page needs; `None` if it does not fit a JPEG.
fn jpeg(artwork: GrayImage) -> Option<Vec<u8>> {
    let (w, h) = artwork.dimensions();
    let longest = w.max(h);
    let picture = if longest > MAX_SIDE {
        let scaled = |side: u32| (u64::from(side) * u64::from(MAX_SIDE)).div_ceil(u64::from(longest)) as u32;
        resize(&artwork, scaled(w), scaled(h), FilterType::Triangle)
    } else {
        artwork
    };
    let (width, height) = (u16::try_from(picture.width()).ok()?, u16::try_from(picture.height()).ok()?);
    let mut bytes = Vec::new();
    Encoder::new(&mut bytes, QUALITY).encode(&picture, width, height, ColorType::Luma).ok()?;
    Some(bytes)
}

fn described(setup: &TrackerSetup) -> Value {
    let objects: Vec<Value> = setup.objects.iter().map(body).collect();
    let model = &setup.camera;
    json!({
        "camera": camera(model), "readout_s": setup.shutter.or_zero().readout_s, "overscan": overscan(model),
        "stage": body(&setup.stage), "objects": objects,
    })
}

/// Returns the lens as in a calibration file, and the valid radius of its formula.
fn camera(camera: &CameraModel) -> Value {
    let i = camera.intrinsics();
    json!({
        "width": i.width, "height": i.height, "fx": i.fx, "fy": i.fy, "cx": i.cx, "cy": i.cy, "skew": i.skew, "distortion": i.distortion,
        // Infinite without distortion; JSON has no number for that.
        "valid_radius": Some(camera.valid_radius()).filter(|radius| radius.is_finite()),
    })
}

/// Points along each side of the frame whose rays are computed. Chosen, not tuned: a lens bends the
/// border smoothly. Raised, sessions start a little later; lowered, the border's farthest point may
/// be missed.
const ALONG_BORDER: u32 = 64;

/// Returns what a pinhole camera must see to cover the whole frame: the bounds of the frame's
/// undistorted border as x / z and y / z, and the pixels that this takes at the lens's own focal
/// length.
fn overscan(camera: &CameraModel) -> Value {
    let (w, h) = (camera.width(), camera.height());
    let (right, bottom) = (f64::from(w) - 0.5, f64::from(h) - 0.5);
    let along = |k: u32, end: f64| -0.5 + f64::from(k) / f64::from(ALONG_BORDER) * (end + 0.5);
    let border = (0..=ALONG_BORDER).flat_map(|k| {
        let (x, y) = (along(k, right), along(k, bottom));
        [Vector2::new(x, -0.5), Vector2::new(x, bottom), Vector2::new(-0.5, y), Vector2::new(right, y)]
    });
    let rays = border.filter_map(|pixel| camera.unproject(Pixel(pixel)).map(|n| n.0));
    let bounds = rays.fold(None, |bounds: Option<(Vector2<f64>, Vector2<f64>)>, ray| {
        Some(bounds.map_or((ray, ray), |(least, most)| (least.inf(&ray), most.sup(&ray))))
    });
    let Some((least, most)) = bounds else { return Value::Null };
    let i = camera.intrinsics();
    let pixels = [(most.x - least.x) * i.fx, (most.y - least.y) * i.fy].map(f64::ceil);
    json!({"left": least.x, "right": most.x, "top": least.y, "bottom": most.y, "width": pixels[0], "height": pixels[1]})
}

fn body(body: &BodySpec) -> Value {
    let surfaces: Vec<Value> = body.surfaces.iter().map(surface).collect();
    json!({"name": body.name, "surfaces": surfaces})
}

fn surface(surface: &SurfaceSpec) -> Value {
    let (w, h) = surface.artwork.dimensions();
    let mut described =
        json!({"name": surface.name, "size_m": surface.size_m, "pose": surface.pose, "picture_px": [w, h], "outline_m": outline(surface)});
    if let SurfaceShape::Bent(_) = surface.shape {
        described["mesh_m"] = json!(mesh(surface));
    }
    described
}

/// Returns a bent surface's points in its body's frame, metres: rows from the picture's top, each
/// from the left, evenly spread over the picture.
fn mesh(surface: &SurfaceSpec) -> Vec<Vec<[f64; 3]>> {
    let share = |k: u32| f64::from(k) / f64::from(MESH - 1) - 0.5;
    let [width, height] = surface.size_m;
    let row = |j: u32| (0..MESH).map(|i| hanging(surface, [share(i) * width, -share(j) * height])).collect();
    (0..MESH).map(row).collect()
}

/// Returns where a point of a surface's plane hangs, in its body's frame.
fn hanging(surface: &SurfaceSpec, point: [f64; 2]) -> [f64; 3] {
    surface.pose.transform(&Point3::from(surface.shape.at(point).place)).coords.into()
}

/// Returns points around the surface from its top left corner, in its body's frame, metres; the
/// outline is not closed.
fn outline(surface: &SurfaceSpec) -> Vec<[f64; 3]> {
    let [w, h] = surface.size_m.map(|m| m / 2.0);
    let corners = [[-w, h], [w, h], [w, -h], [-w, -h]];
    let along = |edge: usize, k: u32| {
        let (from, to, share) = (corners[edge], corners[(edge + 1) % 4], f64::from(k) / f64::from(PIECES));
        hanging(surface, [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])])
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
            doubt: crate::track::SurfaceDoubt::default(),
            transfer: crate::light::Transfer::default(),
        };
        let camera = CameraModel::pinhole(64, 48, 60.0, 61.0, 31.5, 23.5).unwrap();
        TrackerSetup::new(camera, BodySpec::new("stage", vec![surface]))
    }

    #[test]
    fn the_scene_has_the_lens_and_outlines_in_the_stage_frame() {
        let scene = Arc::new(Scene::default());
        assert_eq!((scene.reply(true).status, scene.picture("0").status), (503, 503));
        scene.set(&setup());
        let whole = scene.reply(false).body;
        let mut unpacked = Vec::new();
        std::io::copy(&mut flate2::read::GzDecoder::new(scene.reply(true).body.as_slice()), &mut unpacked).unwrap();
        assert_eq!(unpacked, whole);
        let value: Value = serde_json::from_slice(&whole).unwrap();
        assert_eq!((&value["camera"]["fy"], &value["camera"]["valid_radius"]), (&61.0.into(), &Value::Null));
        // The border of a pinhole's frame, half a pixel outside the outer pixel centres.
        let left = value["overscan"]["left"].as_f64().unwrap();
        assert!((left - (-0.5 - 31.5) / 60.0).abs() < 1e-9, "{left}");
        let surface = &value["stage"]["surfaces"][0];
        let outline: Vec<[f64; 3]> = serde_json::from_value(surface["outline_m"].clone()).unwrap();
        assert_eq!((outline.len(), &surface["name"]), (64, &"backdrop.png".into()));
        // Upright at the origin: x right, z up.
        for (k, [x, z]) in [(0, [-2.0, 3.0]), (16, [2.0, 3.0]), (24, [2.0, 1.5]), (32, [2.0, 0.0]), (48, [-2.0, 0.0])] {
            let off = Vector3::from(outline[k]) - Vector3::new(x, 0.0, z);
            assert!(off.norm() < 1e-12, "{k}: {:?}", outline[k]);
        }
    }
    #[test]
    fn scene_pictures_are_the_stages() {
        let scene = Arc::new(Scene::default());
        let mut setup = setup();
        setup.stage.surfaces[0].artwork = GrayImage::from_fn(3000, 20, |x, _| image::Luma([if x < 1500 { 40 } else { 200 }]));
        scene.set(&setup);
        let picture = loop {
            match scene.picture("0") {
                Reply { status: 503, .. } => std::thread::yield_now(),
                ready => break ready,
            }
        };
        assert_eq!((picture.status, picture.content_type), (200, "image/jpeg"));
        let seen = crate::capture::decode_grey(&picture.body).unwrap();
        assert_eq!(seen.dimensions(), (2048, 14));
        assert!(seen.get_pixel(500, 7)[0].abs_diff(40) < 4 && seen.get_pixel(1500, 7)[0].abs_diff(200) < 4);
        for wrong in ["1", "-1", "x", "", "99999999999999999999"] {
            assert_eq!(scene.picture(wrong).status, 404, "{wrong}");
        }
    }
}
