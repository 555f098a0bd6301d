//! The ray of every pixel, computed once per level of the frame: the exact inverse of the lens, so that no picture
//! is ever undistorted.

use nalgebra::Vector2;

use crate::camera::{CameraModel, Pixel};

/// Rays through the pixel centres of one level.
#[derive(Debug, Clone)]
pub struct RayTable {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// (x, y) at depth 1, row by row; not a number where the lens has no ray.
    pub rays: Vec<[f32; 2]>,
}

impl RayTable {
    /// The rays of level `l` of a camera's frames (see [`frame_pixel`]).
    pub fn new(camera: &CameraModel, l: usize) -> Self {
        let (width, height) = (camera.width() as usize >> l, camera.height() as usize >> l);
        let ray = |k: usize| {
            let p = frame_pixel(l, (k % width) as f64, (k / width) as f64);
            camera.unproject(Pixel(p)).map_or([f32::NAN; 2], |n| [n.0.x as f32, n.0.y as f32])
        };
        Self { width, height, rays: (0..width * height).map(ray).collect() }
    }
}

/// A level's pixel centre in pixels of the frame.
pub fn frame_pixel(l: usize, u: f64, v: f64) -> Vector2<f64> {
    let n = f64::from(1u32 << l);
    Vector2::new(n * u + 0.5 * (n - 1.0), n * v + 0.5 * (n - 1.0))
}
