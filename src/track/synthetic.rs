//! Synthetic pictures for the tests of `track`: smooth random texture, surfaces as a still or
//! moving camera sees them, and matching anchors. Light is averaged, not grey.

use image::{GrayImage, Luma};
use nalgebra::{Matrix2, UnitQuaternion, Vector2, Vector3};

use super::patches::fitted_anchor::FittedAnchor;
use super::scene::reference::PreparedBody;
use super::scene::surface::{BodySpec, SurfaceSpec};
use crate::camera::{CameraModel, Intrinsics, Normalized, Pixel, Shutter};
use crate::geometry::resection::Observation;
use crate::geometry::{Body, Camera, Pose};
use crate::light::Transfer;
use crate::light::transfer::FULL;
use crate::motion::Motion;

/// Returns smooth random texture: noise on lattices of three pitches, so that there is detail of
/// every size.
pub fn texture(width: u32, height: u32, seed: u32) -> GrayImage {
    let pitches = [(23.0, 110.0), (9.0, 80.0), (5.0, 40.0)];
    GrayImage::from_fn(width, height, |x, y| {
        let wave = |(k, (pitch, amplitude)): (usize, &(f64, f64))| {
            amplitude * (lattice(f64::from(x) / pitch, f64::from(y) / pitch, seed ^ (k as u32) << 8) - 0.5)
        };
        Luma([(128.0 + pitches.iter().enumerate().map(wave).sum::<f64>()).clamp(0.0, 255.0) as u8])
    })
}

/// Value noise from 0 to 1, smoothly interpolated between lattice points.
fn lattice(x: f64, y: f64, seed: u32) -> f64 {
    let (i, j) = (x.floor(), y.floor());
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (a, b) = (smooth(x - i), smooth(y - j));
    let corner = |di: u32, dj: u32| f64::from(hash(i as u32 + di, j as u32 + dj, seed)) / f64::from(u32::MAX);
    let (top, bottom) = (corner(0, 0) * (1.0 - a) + corner(1, 0) * a, corner(0, 1) * (1.0 - a) + corner(1, 1) * a);
    top * (1.0 - b) + bottom * b
}

fn hash(x: u32, y: u32, seed: u32) -> u32 {
    let mut h = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ seed.wrapping_mul(0xc2b2_ae3d);
    for _ in 0..2 {
        h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    }
    h ^ (h >> 16)
}

pub fn lens(width: u32, height: u32) -> CameraModel {
    let (w, h) = (f64::from(width), f64::from(height));
    let distortion = [-0.1, 0.05, 0.0005, -0.0003, 0.0];
    CameraModel::new(Intrinsics { width, height, fx: w, fy: 1.01 * w, cx: 0.5 * w, cy: 0.49 * h, skew: 0.0, distortion }).expect("a camera")
}

/// Returns a surface of 4 x 3 m at the body's origin; x right and y up, as in the body.
pub fn cloth(seed: u32) -> SurfaceSpec {
    SurfaceSpec::from_artwork("cloth".into(), texture(640, 480, seed), [4.0, 3.0], Pose::identity()).expect("texture enough")
}

/// Returns a [`cloth`] and a smaller flat in front of it, at an angle.
pub fn with_flat() -> Vec<SurfaceSpec> {
    let mut flat = cloth(2);
    flat.pose = Pose::new(UnitQuaternion::from_euler_angles(0.0, 0.4, 0.0), Vector3::new(0.7, 0.1, 0.9));
    flat.size_m = [1.2, 0.9];
    vec![cloth(1), flat]
}

/// Returns the [`lens`] of 640 x 480 pixels with its focal length multiplied by `by`.
pub fn zoomed(by: f64) -> CameraModel {
    let i = *lens(640, 480).intrinsics();
    CameraModel::new(Intrinsics { fx: by * i.fx, fy: by * i.fy, ..i }).expect("a camera")
}

pub fn prepared(surfaces: Vec<SurfaceSpec>) -> PreparedBody {
    PreparedBody::new(&BodySpec::new("stage", surfaces)).with_anchors()
}

/// Instants per exposure at which a row is rendered. Raised, blur is smoother and tests are slower.
const INSTANTS: u32 = 8;

/// Renders what a moving camera sees of a surface: each row is the mean over instants of its own
/// exposure.
pub fn moving_view(surface: &SurfaceSpec, motion: &Motion, shutter: &Shutter, lens: &CameraModel) -> GrayImage {
    view_along(surface, |t| motion.after(t).pose, shutter, lens)
}

/// Renders a surface as a camera sees it that moves along a path: its pose at a time in seconds
/// from the stamp.
pub fn view_along(surface: &SurfaceSpec, pose_at: impl Fn(f64) -> Pose<Body, Camera>, shutter: &Shutter, lens: &CameraModel) -> GrayImage {
    let (width, height) = (lens.width(), lens.height());
    let reach_s = 0.5 * (shutter.readout_s + shutter.exposure_s);
    let step_s = shutter.exposure_s / f64::from(INSTANTS);
    let mut sums = vec![[0.0, 0.0]; (width * height) as usize];
    let count = (2.0 * reach_s / step_s).round() as u32;
    for k in 0..count {
        let t = (f64::from(k) + 0.5) * step_s - reach_s;
        let seen = view(surface, &pose_at(t).inverse(), lens);
        for (row, (sums, seen)) in sums.chunks_mut(width as usize).zip(seen.chunks(width as usize)).enumerate() {
            if (t - shutter.delay_s(row as f64 + 0.5, height)).abs() < 0.5 * shutter.exposure_s {
                sums.iter_mut().zip(seen).for_each(|(sum, grey)| *sum = [sum[0] + light_of(f64::from(*grey)), sum[1] + 1.0]);
            }
        }
    }
    GrayImage::from_raw(width, height, sums.iter().map(|[sum, n]| grey_of(sum / n)).collect()).expect("one byte for each pixel")
}

/// Returns where a camera sees a place of a surface's artwork, pixels, and the derivative of that
/// by the place.
pub fn seen(camera: &CameraModel, pose: &Pose<Camera, Body>, spec: &SurfaceSpec, artwork: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
    let at = |artwork: Vector2<f64>| {
        let point = pose.transform(&spec.body_point(artwork));
        camera.project(Normalized(point.coords.xy() / point.z)).0
    };
    (at(artwork), Matrix2::from_columns(&[Vector2::x(), Vector2::y()].map(|step| at(artwork + step) - at(artwork))))
}

/// Returns `T_camera_body` of a camera that faces a [`cloth`], tilted by rotations about its x and
/// y.
pub fn facing(tilt_x: f64, tilt_y: f64, shift: Vector3<f64>) -> Pose<Camera, Body> {
    let flip = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    Pose::new(UnitQuaternion::from_euler_angles(tilt_x, tilt_y, 0.02) * flip, shift)
}

/// Returns anchors on a grid over every surface, `across` per side, with one pixel of noise each in
/// their information. `shift_px` returns the offset from the projected position, given the anchor's
/// number on its surface and its pixel.
pub fn seen_anchors(
    body: &PreparedBody,
    pose: &Pose<Camera, Body>,
    camera: &CameraModel,
    across: u32,
    mut shift_px: impl FnMut(u32, Vector2<f64>) -> Vector2<f64>,
) -> Vec<FittedAnchor> {
    let mut anchors = Vec::new();
    for (surface, prepared) in body.surfaces.iter().enumerate() {
        for k in 0..across * across {
            let artwork = Vector2::new(f64::from(k % across) + 0.5, f64::from(k / across) + 0.5).component_mul(&Vector2::new(640.0, 480.0));
            let artwork = artwork / f64::from(across);
            let point = prepared.spec.body_point(artwork);
            let c = pose.transform(&point);
            let pixel = camera.project(Normalized(Vector2::new(c.x / c.z, c.y / c.z))).0;
            let pixel = pixel + shift_px(k, pixel);
            let observation = Observation { point, pixel, information: Matrix2::identity(), delay_s: 0.0, group: 0 };
            anchors.push(FittedAnchor { surface: surface as u32, artwork, observation, corrected_px: pixel });
        }
    }
    anchors
}

/// Returns the light of an sRGB grey, 0 to 1.
pub fn light_of(grey: f64) -> f64 {
    f64::from(Transfer::Srgb.decoded(grey as f32 / FULL))
}

/// Returns the sRGB grey of an amount of light, 0 to 1.
pub fn grey_of(light: f64) -> u8 {
    (FULL * Transfer::Srgb.encoded(light as f32)).round() as u8
}

/// Renders what a still camera sees of a surface: 3 x 3 samples per pixel; grey 30 where there is
/// nothing.
pub fn view(surface: &SurfaceSpec, pose: &Pose<Camera, Body>, camera: &CameraModel) -> GrayImage {
    let to_surface = (*pose * surface.pose).inverse();
    let look = |u: f64, v: f64| -> f64 {
        let Some(ray) = camera.unproject(Pixel(Vector2::new(u, v))) else { return light_of(NOTHING_GREY) };
        let direction = to_surface.rotation * ray.0.push(1.0);
        let eye = to_surface.translation;
        surface
            .shape
            .meet(&eye, &direction)
            .map_or_else(|| light_of(NOTHING_GREY), |hit| light_at(&surface.artwork, surface.to_artwork(hit.into())))
    };
    let steps = [-1.0 / 3.0, 0.0, 1.0 / 3.0];
    GrayImage::from_fn(camera.width(), camera.height(), |x, y| {
        let all = steps.iter().flat_map(|dy| steps.iter().map(move |dx| (f64::from(x) + dx, f64::from(y) + dy)));
        Luma([grey_of(all.map(|(u, v)| look(u, v)).sum::<f64>() / 9.0)])
    })
}

/// Grey where there is nothing.
const NOTHING_GREY: f64 = 30.0;

/// Returns the bilinear light; that of [`NOTHING_GREY`] outside the picture.
fn light_at(picture: &GrayImage, p: Vector2<f64>) -> f64 {
    let (i, j) = (p.x.floor(), p.y.floor());
    if i < 0.0 || j < 0.0 || i + 1.0 >= f64::from(picture.width()) || j + 1.0 >= f64::from(picture.height()) {
        return light_of(NOTHING_GREY);
    }
    let (a, b) = (p.x - i, p.y - j);
    let at = |dx: u32, dy: u32| light_of(f64::from(picture.get_pixel(i as u32 + dx, j as u32 + dy)[0]));
    (at(0, 0) * (1.0 - a) + at(1, 0) * a) * (1.0 - b) + (at(0, 1) * (1.0 - a) + at(1, 1) * a) * b
}
