//! The numbers that a calibration may estimate, which of them are free, and how a pixel depends on each.

use nalgebra::{SMatrix, SVector, Vector2};

use crate::camera::{CameraError, CameraModel, Intrinsics};

/// How many numbers a lens has: Brown's model as in Bouguet's toolbox, with [`LENS_NAMES`].
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
        LENS_NUMBERS - self.held().count()
    }

    /// The numbers that are not estimated.
    pub fn held(&self) -> impl Iterator<Item = usize> {
        (0..LENS_NUMBERS).filter(|&k| !self.is_estimated(k))
    }

    /// Whether a number has an unknown of its own.
    pub fn is_estimated(&self, number: usize) -> bool {
        self.free[number] && !(self.square_pixels && number == 1 && self.free[0])
    }
}

impl Lens {
    /// A lens without distortion.
    pub fn pinhole(focal_px: [f64; 2], centre_px: [f64; 2]) -> Self {
        Self(LensVector::from([focal_px[0], focal_px[1], centre_px[0], centre_px[1], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
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
        CameraModel::new(Intrinsics { width, height, ..self.intrinsics() })
    }

    /// The numbers by name, for pictures of no size.
    fn intrinsics(&self) -> Intrinsics {
        let [fx, fy, cx, cy, skew, k1, k2, p1, p2, k3] = self.0.into();
        Intrinsics { width: 0, height: 0, fx, fy, cx, cy, skew, distortion: [k1, k2, p1, p2, k3] }
    }

    /// Equations 5 to 10: the raw pixel of a normalised point.
    pub fn project(&self, point: Vector2<f64>) -> Vector2<f64> {
        self.intrinsics().project(point)
    }

    /// The pixel, its derivative by the normalised point (2x2, columns x and y), and by the ten numbers (2x10).
    pub fn project_with_derivatives(&self, point: Vector2<f64>) -> (Vector2<f64>, [Vector2<f64>; 2], SMatrix<f64, 2, LENS_NUMBERS>) {
        let i = self.intrinsics();
        let (d, by_point) = i.distort(point);
        (i.affine(d), [0, 1].map(|k| i.shift_px(by_point.column(k).into_owned())), i.by_numbers(point, d))
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
