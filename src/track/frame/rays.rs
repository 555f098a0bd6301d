//! The ray of every pixel, computed once per level of the frame by the exact inverse of the lens
//! model, so that no picture is ever undistorted.

use crate::track::frame::tuning::TUNING;
use image::GrayImage;
use nalgebra::Vector2;

use super::frame_levels::LEVELS;
use crate::camera::{CameraModel, Pixel};

/// The rays of a camera at all levels, shared by all bodies.
#[derive(Debug)]
pub struct CameraRays {
    camera: CameraModel,
    /// Rays of levels 1 and up.
    tables: [RayTable; LEVELS - 1],
}

impl CameraRays {
    /// Computes the rays of a camera's pixels. `mask`: pixels to leave out (0), of the frame's
    /// size.
    pub fn new(camera: CameraModel, mask: Option<GrayImage>) -> Self {
        let tables = std::array::from_fn(|k| RayTable::new(&camera, k + 1, mask.as_ref()));
        Self { camera, tables }
    }

    /// Returns the rays of a level, from 1.
    pub fn table(&self, level: usize) -> &RayTable {
        &self.tables[level - 1]
    }

    /// Returns the lens.
    pub fn camera(&self) -> &CameraModel {
        &self.camera
    }
}

/// Derivatives of a ray by the level's pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RaySlope {
    /// Of x, across.
    pub x_across: f32,
    /// Of x, down.
    pub x_down: f32,
    /// Of y, across.
    pub y_across: f32,
    /// Of y, down.
    pub y_down: f32,
}

/// Rays through the pixel centres of one level.
#[derive(Debug, Clone)]
pub struct RayTable {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// (x, y) at depth 1, row by row; NaN where the lens has no ray.
    pub rays: Vec<[f32; 2]>,
    slopes: Vec<RaySlope>,
    squares_across: usize,
    /// One bit per pixel: set if it must not be used.
    pub closed: Vec<u64>,
}

impl RayTable {
    /// Computes the rays of level `l` of a camera's frames (see [`frame_pixel`]). `mask`: pixels of
    /// the frame to leave out (0).
    pub fn new(camera: &CameraModel, l: usize, mask: Option<&GrayImage>) -> Self {
        let (width, height) = (camera.width() as usize >> l, camera.height() as usize >> l);
        let ray = |u: f64, v: f64| camera.unproject(Pixel(frame_pixel(l, u, v))).map_or([f32::NAN; 2], |n| [n.0.x as f32, n.0.y as f32]);
        let rays: Vec<[f32; 2]> = (0..width * height).map(|k| ray((k % width) as f64, (k / width) as f64)).collect();
        let squares_across = width.div_ceil(TUNING.ray_square_px);
        let slope = |k: usize| {
            let middle =
                |n: usize, size: usize| ((n * TUNING.ray_square_px + TUNING.ray_square_px / 2).min(size.saturating_sub(2)).max(1)) as f64;
            let (u, v) = (middle(k % squares_across, width), middle(k / squares_across, height));
            let [left, right, above, below] = [ray(u - 1.0, v), ray(u + 1.0, v), ray(u, v - 1.0), ray(u, v + 1.0)];
            RaySlope {
                x_across: 0.5 * (right[0] - left[0]),
                x_down: 0.5 * (below[0] - above[0]),
                y_across: 0.5 * (right[1] - left[1]),
                y_down: 0.5 * (below[1] - above[1]),
            }
        };
        let slopes = (0..squares_across * height.div_ceil(TUNING.ray_square_px)).map(slope).collect();
        let mut table = Self { width, height, rays, slopes, squares_across, closed: vec![0; (width * height).div_ceil(64)] };
        for k in 0..width * height {
            let (u, v) = (k % width, k / width);
            let inside = u > 1 && v > 1 && u + 2 < width && v + 2 < height;
            let slope = table.slope(u, v);
            let is_known = (table.rays[k][0] + slope.x_across + slope.x_down).is_finite();
            if !inside || !is_known || mask.is_some_and(|mask| is_masked(mask, l, u, v)) {
                table.closed[k / 64] |= 1 << (k % 64);
            }
        }
        table
    }

    /// Returns the derivatives at a pixel.
    pub fn slope(&self, u: usize, v: usize) -> RaySlope {
        self.slopes[v / TUNING.ray_square_px * self.squares_across + u / TUNING.ray_square_px]
    }
}

/// Whether any frame pixel that the level's pixel covers is masked.
fn is_masked(mask: &GrayImage, level: usize, u: usize, v: usize) -> bool {
    let n = 1u32 << level;
    let (x, y) = ((u as u32) << level, (v as u32) << level);
    (0..n * n).any(|k| mask.get_pixel_checked(x + k % n, y + k / n).is_none_or(|p| p[0] == 0))
}

/// Converts a level's pixel position to pixels of the frame.
pub fn frame_pixel(l: usize, u: f64, v: f64) -> Vector2<f64> {
    let n = f64::from(1u32 << l);
    Vector2::new(n * u + 0.5 * (n - 1.0), n * v + 0.5 * (n - 1.0))
}
