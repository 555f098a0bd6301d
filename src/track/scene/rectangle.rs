//! The rectangle of a surface, and how a camera sees it. Used both to select pixels for alignment
//! and to register anchors.

use crate::track::scene::tuning::TUNING;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::shape::{ShapePoint, SurfaceShape};
use super::surface::SurfaceSpec;
use crate::camera::{CameraModel, Normalized};
use crate::geometry::{Body, Camera, Pose};

/// Maximum points at which a rectangle's size in the frame is measured, so that they need no heap.
const MAX_GRID_POINTS: usize = 100;

/// A rectangle in the frame of its body.
#[derive(Debug, Clone)]
pub struct Rectangle {
    /// Rotation of `T_body_surface`.
    pub rotation: Matrix3<f64>,
    /// Translation of `T_body_surface`, metres.
    pub centre: Vector3<f64>,
    /// Width and height, metres.
    pub size_m: [f64; 2],
    /// Width and height of its picture, pixels.
    pub size_px: [f64; 2],
    /// Where the points of the picture are.
    pub shape: SurfaceShape,
}

/// A point of a rectangle as the frame shows it.
#[derive(Debug, Clone, Copy)]
pub struct SeenPoint {
    /// Pixel of the frame.
    pub pixel: Vector2<f64>,
    /// Derivative of the pixel by metres on the surface.
    pub by_metres: Matrix2<f64>,
}

impl SeenPoint {
    /// Converts it to a copy of the frame whose pixels are `scale` times as wide.
    pub fn in_smaller(self, scale: f64) -> Self {
        let half = Vector2::new(0.5, 0.5);
        Self { pixel: (self.pixel + half) / scale - half, by_metres: self.by_metres / scale }
    }
}

impl Rectangle {
    /// Creates the rectangle of a surface.
    pub fn of(spec: &SurfaceSpec) -> Self {
        Self {
            rotation: spec.pose.rotation_matrix(),
            centre: spec.pose.translation,
            size_m: spec.size_m,
            size_px: [f64::from(spec.artwork.width()), f64::from(spec.artwork.height())],
            shape: spec.shape.clone(),
        }
    }

    /// Returns the pixels of the picture per metre, across and down.
    pub fn texels_per_m(&self) -> [f64; 2] {
        [self.size_px[0] / self.size_m[0], self.size_px[1] / self.size_m[1]]
    }

    /// Returns where a camera sees the point (`x`, `y`), metres from the centre. `None` if it is
    /// behind the camera, beyond the lens model, or the surface is tilted further than
    /// `least_cosine`.
    pub fn see(&self, t_body_camera: &Pose<Body, Camera>, camera: &CameraModel, point: [f64; 2], least_cosine: f64) -> Option<SeenPoint> {
        self.see_place(t_body_camera, camera, &self.shape.at(point), least_cosine)
    }

    /// The same for a point whose place on the surface's shape is known.
    pub fn see_place(
        &self,
        t_body_camera: &Pose<Body, Camera>,
        camera: &CameraModel,
        point: &ShapePoint,
        least_cosine: f64,
    ) -> Option<SeenPoint> {
        let r_camera_body = t_body_camera.rotation_matrix().transpose();
        let r = r_camera_body * self.rotation;
        let ShapePoint { place, by_picture } = point;
        let c = r * place + r_camera_body * (self.centre - t_body_camera.translation);
        let [by_x, by_y] = by_picture.map(|d| r * d);
        let normal = if self.shape.is_flat() { r.column(2).into_owned() } else { by_x.cross(&by_y).normalize() };
        // The face must look at the camera: its normal points against the ray.
        if c.z < 1e-3 || -normal.dot(&c) < least_cosine * c.norm() {
            return None;
        }
        let n = Vector2::new(c.x / c.z, c.y / c.z);
        if n.norm() > camera.valid_radius() {
            return None;
        }
        let (pixel, by_ray) = camera.project_with_jacobian(Normalized(n));
        let by_metre = |d: Vector3<f64>| Vector2::new(d.x - n.x * d.z, d.y - n.y * d.z) / c.z;
        Some(SeenPoint { pixel: pixel.0, by_metres: by_ray * Matrix2::from_columns(&[by_metre(by_x), by_metre(by_y)]) })
    }

    /// Returns log2 of the number of picture pixels along a pixel of a frame of this size: the
    /// median over the visible points. `None` if none is visible.
    pub fn texels_log2(&self, frame: [f64; 2], see: impl Fn([f64; 2]) -> Option<SeenPoint>) -> Option<f64> {
        let [across, down] = self.texels_per_m();
        let mut logs = [0.0; MAX_GRID_POINTS];
        let mut n = 0;
        let grid = (0..TUNING.size_grid_points).flat_map(|i| (0..TUNING.size_grid_points).map(move |k| (i, k)));
        for (i, k) in grid.take(MAX_GRID_POINTS) {
            let place = |k: u32, size_m: f64| ((f64::from(k) + 0.5) / f64::from(TUNING.size_grid_points) - 0.5) * size_m;
            let Some(SeenPoint { pixel, by_metres }) = see([place(i, self.size_m[0]), place(k, self.size_m[1])]) else { continue };
            if pixel.x > 0.0 && pixel.y > 0.0 && pixel.x < frame[0] && pixel.y < frame[1] {
                logs[n] = 0.5 * (across * down / by_metres.determinant().abs().max(1e-12)).log2();
                n += 1;
            }
        }
        logs[..n].sort_by(f64::total_cmp);
        logs[..n].get(n / 2).copied()
    }

    /// Whether the rectangle lies between a camera and any of these points, all in body
    /// coordinates. The shape is taken as flat.
    pub fn hides_any(&self, points: &[Vector3<f64>], from: &Vector3<f64>) -> bool {
        let [across, up, normal] = [0, 1, 2].map(|k| self.rotation.column(k));
        let plane = normal.dot(&self.centre);
        let from_height = normal.dot(from) - plane;
        points.iter().any(|point| {
            let to_height = normal.dot(point) - plane;
            // On the same side, as nearly all are.
            if from_height * to_height > 0.0 {
                return false;
            }
            // The segment crosses the plane before it reaches the point.
            let share = from_height / (from_height - to_height);
            if !(0.0..0.999).contains(&share) {
                return false;
            }
            let hit = from - self.centre + (point - from) * share;
            across.dot(&hit).abs() < 0.5 * self.size_m[0] && up.dot(&hit).abs() < 0.5 * self.size_m[1]
        })
    }
}
