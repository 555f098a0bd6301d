//! Pictures with known content, for tests of detectors: exact at every position, each pixel the
//! mean over its square.

use image::{GrayImage, Luma};
use nalgebra::{Matrix2, Matrix3, Rotation2, Vector2};

use crate::geometry::Homography;

/// Samples per pixel each way.
const SAMPLES: u32 = 4;

/// Renders a picture with `level` at each position.
pub fn rendered(width: u32, height: u32, level: impl Fn(Vector2<f64>) -> f64) -> GrayImage {
    GrayImage::from_fn(width, height, |x, y| {
        let offset = |k: u32| (f64::from(k) + 0.5) / f64::from(SAMPLES) - 0.5;
        let sample = |k: u32| level(Vector2::new(f64::from(x) + offset(k % SAMPLES), f64::from(y) + offset(k / SAMPLES)));
        let sum: f64 = (0..SAMPLES * SAMPLES).map(sample).sum();
        Luma([(sum / f64::from(SAMPLES * SAMPLES)).round().clamp(0.0, 255.0) as u8])
    })
}

/// An ellipse on a plane.
#[derive(Debug, Clone, Copy)]
pub struct Ellipse {
    pub middle: Vector2<f64>,
    /// Half axes.
    pub axes: [f64; 2],
    /// Direction of the first axis, radians.
    pub angle: f64,
}

impl Ellipse {
    /// Symmetric map from the unit circle to it.
    pub fn shape(&self) -> Matrix2<f64> {
        let rotation = Rotation2::new(self.angle).into_inner();
        rotation * Matrix2::from_diagonal(&self.axes.into()) * rotation.transpose()
    }

    /// Distance from its centre in half axes.
    pub fn distance(&self, p: Vector2<f64>) -> f64 {
        let (sin, cos) = self.angle.sin_cos();
        let d = p - self.middle;
        ((cos * d.x + sin * d.y) / self.axes[0]).hypot((cos * d.y - sin * d.x) / self.axes[1])
    }
}

/// A shape of a painting.
struct Stroke {
    middle: Vector2<f64>,
    /// Maps its interior to the unit circle, or for a bar to the square around it.
    frame: Matrix2<f64>,
    is_bar: bool,
    level: f64,
}

/// A plane of 300 x 300 pixels with overlapping ellipses and bars.
pub struct Painting(Vec<Stroke>);

impl Painting {
    /// Deterministic.
    pub fn new() -> Self {
        let mut state = 7u32;
        let mut random = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1u32 << 24)
        };
        let stroke = |k: u32| {
            let middle = Vector2::new(random(), random()) * 300.0;
            let scale = Matrix2::new(1.0 / (4.0 + 16.0 * random()), 0.0, 0.0, 1.0 / (4.0 + 10.0 * random()));
            Stroke {
                middle,
                frame: scale * Rotation2::new(3.2 * random()).into_inner(),
                is_bar: k.is_multiple_of(3),
                level: 20.0 + 210.0 * random(),
            }
        };
        Self((0..160).map(stroke).collect())
    }

    /// Grey level at a position.
    fn level(&self, p: Vector2<f64>) -> f64 {
        let inside = |stroke: &&Stroke| {
            let d = stroke.frame * (p - stroke.middle);
            if stroke.is_bar { d.amax() < 1.0 } else { d.norm_squared() < 1.0 }
        };
        self.0.iter().rev().find(inside).map_or(128.0, |stroke| stroke.level)
    }

    /// A picture of 300 x 300 pixels; `view` maps the plane's pixels to it.
    pub fn seen(&self, view: &Homography) -> GrayImage {
        let back = view.inverse().expect("views are regular");
        rendered(300, 300, |p| back.map(p).map_or(128.0, |p| self.level(p)))
    }
}

/// A view of the painting about its centre: rotated, tilted about an axis, scaled.
pub fn view(rotation: f64, tilt: f64, scale: f64) -> Homography {
    let rotated = Rotation2::new(rotation).into_inner();
    let axis = Rotation2::new(0.6).into_inner();
    let matrix = rotated * axis * Matrix2::new(tilt.cos(), 0.0, 0.0, 1.0) * axis.transpose() * scale;
    let middle = Vector2::new(149.5, 149.5);
    let offset = middle - matrix * middle;
    Homography(Matrix3::new(matrix.m11, matrix.m12, offset.x, matrix.m21, matrix.m22, offset.y, 0.0, 0.0, 1.0))
}

/// Deterministic noise.
pub fn noise(width: u32, height: u32) -> GrayImage {
    let mut state = 1u32;
    GrayImage::from_fn(width, height, |_, _| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        Luma([(state >> 24) as u8])
    })
}

/// Sizes with no inner pixel, or hardly any.
pub const DEGENERATE: [(u32, u32); 9] = [(0, 0), (0, 9), (1, 1), (1, 40), (300, 1), (2, 2), (5000, 3), (13, 12), (7, 300)];
