//! The numbers that a calibration may estimate, which of them are free, and how a pixel depends on each.

use nalgebra::{SMatrix, SVector, Vector2};

use crate::camera::{CameraError, CameraModel, Intrinsics};

/// How many numbers a lens has.
pub const LENS_NUMBERS: usize = 10;
/// Their names, in the order of [`Lens`].
pub const LENS_NAMES: [&str; LENS_NUMBERS] = ["fx", "fy", "cx", "cy", "skew", "k1", "k2", "p1", "p2", "k3"];

/// A symmetric matrix over the ten numbers.
pub type LensMatrix = SMatrix<f64, LENS_NUMBERS, LENS_NUMBERS>;
/// A vector over the ten numbers.
pub type LensVector = SVector<f64, LENS_NUMBERS>;

/// fx, fy, cx, cy (pixels), skew (alpha_c), k1, k2, p1, p2, k3.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens(pub LensVector);

/// Values for numbers that are not estimated; without one, the picture's centre, square pixels' focal length, or no distortion.
pub type Held = [Option<f64>; LENS_NUMBERS];

/// Which numbers are estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FreeNumbers {
    /// One entry a number, in the order of [`LENS_NAMES`]; what is not free keeps the value of the start.
    pub free: [bool; LENS_NUMBERS],
    /// fy follows fx (pixels are square).
    pub square_pixels: bool,
}

impl Default for FreeNumbers {
    /// All but skew and k3, as Bouguet's toolbox has it.
    fn default() -> Self {
        let mut free = [true; LENS_NUMBERS];
        (free[4], free[9]) = (false, false);
        Self { free, square_pixels: false }
    }
}

impl FreeNumbers {
    /// How many numbers are estimated.
    pub fn count(&self) -> usize {
        (0..LENS_NUMBERS).filter(|&k| self.is_estimated(k)).count()
    }

    /// Whether a number has an unknown of its own.
    pub fn is_estimated(&self, number: usize) -> bool {
        self.free[number] && !(self.square_pixels && number == 1 && self.free[0])
    }
}

impl Lens {
    /// A lens without distortion.
    pub fn pinhole(focal_px: [f64; 2], centre_px: [f64; 2]) -> Self {
        let mut numbers = LensVector::zeros();
        numbers.fixed_rows_mut::<4>(0).copy_from_slice(&[focal_px[0], focal_px[1], centre_px[0], centre_px[1]]);
        Self(numbers)
    }

    /// The numbers of a camera model.
    pub fn of_model(model: &CameraModel) -> Self {
        let i = model.intrinsics();
        let [k1, k2, p1, p2, k3] = i.distortion;
        Self(LensVector::from([i.fx, i.fy, i.cx, i.cy, i.skew, k1, k2, p1, p2, k3]))
    }

    /// The camera model for pictures of this size.
    ///
    /// # Errors
    /// When the numbers are no camera.
    pub fn model(&self, width: u32, height: u32) -> Result<CameraModel, CameraError> {
        let n = &self.0;
        let distortion = [n[5], n[6], n[7], n[8], n[9]];
        CameraModel::new(Intrinsics { width, height, fx: n[0], fy: n[1], cx: n[2], cy: n[3], skew: n[4], distortion })
    }

    /// Equations 5 to 10: the raw pixel of a normalised point.
    pub fn project(&self, point: Vector2<f64>) -> Vector2<f64> {
        let [d, ..] = self.distorted(point);
        self.affine(d)
    }

    fn affine(&self, d: Vector2<f64>) -> Vector2<f64> {
        let n = &self.0;
        Vector2::new(n[0] * (d.x + n[4] * d.y) + n[2], n[1] * d.y + n[3])
    }

    /// The distorted point and its derivatives by x and by y.
    fn distorted(&self, point: Vector2<f64>) -> [Vector2<f64>; 3] {
        let n = &self.0;
        let (k1, k2, p1, p2, k3) = (n[5], n[6], n[7], n[8], n[9]);
        let (x, y) = (point.x, point.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
        let d =
            Vector2::new(radial * x + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), radial * y + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y);
        let cross = 2.0 * slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y;
        let by_x = Vector2::new(radial + 2.0 * slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x, cross);
        let by_y = Vector2::new(cross, radial + 2.0 * slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x);
        [d, by_x, by_y]
    }

    /// The pixel, its derivative by the normalised point (2x2, columns x and y), and by the ten numbers (2x10).
    pub fn project_with_derivatives(&self, point: Vector2<f64>) -> (Vector2<f64>, [Vector2<f64>; 2], SMatrix<f64, 2, LENS_NUMBERS>) {
        let n = &self.0;
        let [d, by_x, by_y] = self.distorted(point);
        let turn = |v: Vector2<f64>| Vector2::new(n[0] * (v.x + n[4] * v.y), n[1] * v.y);
        let (x, y) = (point.x, point.y);
        let r2 = x * x + y * y;
        let mut by_lens = SMatrix::<f64, 2, LENS_NUMBERS>::zeros();
        by_lens[(0, 0)] = d.x + n[4] * d.y;
        by_lens[(1, 1)] = d.y;
        by_lens[(0, 2)] = 1.0;
        by_lens[(1, 3)] = 1.0;
        by_lens[(0, 4)] = n[0] * d.y;
        by_lens.set_column(5, &turn(point * r2));
        by_lens.set_column(6, &turn(point * (r2 * r2)));
        by_lens.set_column(7, &turn(Vector2::new(2.0 * x * y, r2 + 2.0 * y * y)));
        by_lens.set_column(8, &turn(Vector2::new(r2 + 2.0 * x * x, 2.0 * x * y)));
        by_lens.set_column(9, &turn(point * (r2 * r2 * r2)));
        (self.affine(d), [turn(by_x), turn(by_y)], by_lens)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_the_differences() {
        let lens = Lens(LensVector::from([800.0, 790.0, 320.0, 240.0, 0.01, -0.3, 0.1, 0.001, -0.002, 0.05]));
        let point = Vector2::new(0.3, -0.2);
        let (pixel, by_point, by_lens) = lens.project_with_derivatives(point);
        assert!((pixel - lens.model(640, 480).unwrap().project(crate::camera::Normalized(point)).0).norm() < 1e-12);
        let h = 1e-6;
        for (k, column) in by_point.iter().enumerate() {
            let mut moved = point;
            moved[k] += h;
            assert!(((lens.project(moved) - pixel) / h - column).norm() < 1e-2);
        }
        for (k, name) in LENS_NAMES.iter().enumerate() {
            let mut moved = lens;
            moved.0[k] += h;
            assert!(((moved.project(point) - pixel) / h - by_lens.column(k)).norm() < 1e-3, "{name}");
        }
    }
}
