//! A single picture seen by a webcam: the scene that shows how well a picture can be tracked.

use image::GrayImage;
use nalgebra::{Point3, Vector3};

use stagepose::diagnostics::simulate::{artwork_surface, upright};
use stagepose::{BodySpec, CameraModel, CameraPath, LightKey, SensorNoise, Spline, VirtualStage};

/// Frame size of the webcam and its focal length, pixels: 60 degrees horizontally.
const FRAME_PX: [u32; 2] = [640, 480];
const FOCAL_PX: f64 = 550.0;
/// Grey level around the picture.
const AROUND: f32 = 90.0;
/// Rays per pixel: from afar, the marks of a fine picture are smaller than a pixel.
const SAMPLES: u32 = 8;

/// Returns the scene: a picture one metre wide around the origin, so that distances are in picture
/// widths, seen by a webcam of 640x480 pixels that moves along `path`. `light` scales the greys; 1
/// keeps the picture's own.
pub fn one_picture(picture: GrayImage, path: CameraPath, light: f32) -> VirtualStage {
    let [width, height] = FRAME_PX;
    let middle = |size: u32| 0.5 * (f64::from(size) - 1.0);
    let camera =
        CameraModel::pinhole(width, height, FOCAL_PX, FOCAL_PX, middle(width), middle(height)).expect("a pinhole with a focal length");
    let size_m = [1.0, f64::from(picture.height()) / f64::from(picture.width())];
    let surface = artwork_surface("picture", picture, size_m, upright(Vector3::zeros(), 0.0));
    let mut scene = VirtualStage::new(camera, path, BodySpec::new("stage", vec![surface]));
    scene.noise = SensorNoise::webcam();
    scene.background = AROUND;
    scene.samples = SAMPLES;
    scene.light = vec![LightKey { time_s: 0.0, gain: light }];
    scene
}

/// Returns the point at a distance (in picture widths) from the picture's middle, at an angle to
/// its normal.
pub fn in_front(widths: f64, askew_deg: f64) -> Point3<f64> {
    let angle = askew_deg.to_radians();
    Point3::new(angle.sin(), -angle.cos(), 0.0) * widths
}

/// Moves from one place in front (widths, degrees askew) to another in `seconds`, linearly in angle
/// and in the logarithm of the distance. The picture grows and turns evenly, and the camera stops
/// abruptly at the end.
///
/// # Panics
///
/// If `seconds` is not above 0, or a distance is not a number above 0.
pub fn walk(from: (f64, f64), to: (f64, f64), seconds: f64) -> CameraPath {
    const STEPS: u32 = 24;
    let key = |k: u32| {
        let share = f64::from(k) / f64::from(STEPS);
        let widths = from.0 * (to.0 / from.0).powf(share);
        (seconds * share, in_front(widths, from.1 + (to.1 - from.1) * share).coords)
    };
    let keys: Vec<_> = (0..=STEPS).map(key).collect();
    let position = Spline::new(&keys).expect("keys in order of time");
    CameraPath { position, ..CameraPath::fixed(Point3::origin(), Point3::origin()) }
}
