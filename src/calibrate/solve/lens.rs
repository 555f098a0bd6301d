//! The lens parameters that a calibration may estimate, which of them are free, and the derivatives
//! of a pixel by each.

use nalgebra::{SMatrix, SVector, Vector2};

use crate::camera::{CameraError, CameraModel, Intrinsics};

/// Number of lens parameters: Brown's model as in Bouguet's toolbox, with [`LENS_NAMES`].
pub const LENS_NUMBERS: usize = 10;
/// Names of the parameters, in the order of [`Lens`].
pub const LENS_NAMES: [&str; LENS_NUMBERS] = ["fx", "fy", "cx", "cy", "skew", "k1", "k2", "p1", "p2", "k3"];

/// A symmetric matrix over the ten parameters.
pub type LensMatrix = SMatrix<f64, LENS_NUMBERS, LENS_NUMBERS>;
/// A vector over the ten parameters.
pub type LensVector = SVector<f64, LENS_NUMBERS>;

/// fx, fy, cx, cy (pixels), skew (alpha_c), k1, k2, p1, p2, k3.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens(pub LensVector);

/// Values for parameters that are not estimated. Without a value, the start's is kept: the
/// picture's centre, the closed-form focal length, or no distortion.
pub type Held = [Option<f64>; LENS_NUMBERS];

/// Which parameters are estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FreeNumbers {
    /// One entry per parameter, in the order of [`LENS_NAMES`]; parameters that are not free keep
    /// their start value.
    pub free: [bool; LENS_NUMBERS],
    /// Whether fy is tied to fx (square pixels).
    pub square_pixels: bool,
}

impl Default for FreeNumbers {
    /// Frees everything except skew and k3, as in Bouguet's toolbox.
    fn default() -> Self {
        let mut free = [true; LENS_NUMBERS];
        (free[4], free[9]) = (false, false);
        Self { free, square_pixels: false }
    }
}

impl FreeNumbers {
    /// Returns the number of estimated parameters.
    pub fn count(&self) -> usize {
        LENS_NUMBERS - self.held().count()
    }

    /// Returns the parameters that are not estimated.
    pub fn held(&self) -> impl Iterator<Item = usize> {
        (0..LENS_NUMBERS).filter(|&k| !self.is_estimated(k))
    }

    /// Whether a parameter is an unknown of its own.
    pub fn is_estimated(&self, number: usize) -> bool {
        self.free[number] && !(self.square_pixels && number == 1 && self.free[0])
    }
}

impl Lens {
    /// Creates a lens without distortion.
    pub fn pinhole(focal_px: [f64; 2], centre_px: [f64; 2]) -> Self {
        Self(LensVector::from([focal_px[0], focal_px[1], centre_px[0], centre_px[1], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    }

    /// Takes the parameters from a camera model.
    pub fn of_model(model: &CameraModel) -> Self {
        let i = model.intrinsics();
        let [k1, k2, p1, p2, k3] = i.distortion;
        Self(LensVector::from([i.fx, i.fy, i.cx, i.cy, i.skew, k1, k2, p1, p2, k3]))
    }

    /// Returns the camera model for pictures of this size.
    ///
    /// # Errors
    /// When the parameters are not a valid camera.
    pub fn model(&self, width: u32, height: u32) -> Result<CameraModel, CameraError> {
        CameraModel::new(Intrinsics { width, height, ..self.intrinsics() })
    }

    /// Returns the parameters by name, with a picture size of zero.
    fn intrinsics(&self) -> Intrinsics {
        let [fx, fy, cx, cy, skew, k1, k2, p1, p2, k3] = self.0.into();
        Intrinsics { width: 0, height: 0, fx, fy, cx, cy, skew, distortion: [k1, k2, p1, p2, k3] }
    }

    /// Returns the raw pixel of a normalised point (equations 5 to 10).
    pub fn project(&self, point: Vector2<f64>) -> Vector2<f64> {
        self.intrinsics().project(point)
    }

    /// Returns the pixel, its derivative by the normalised point (2x2, columns x and y), and by the
    /// ten parameters (2x10).
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
    fn lens_derivatives_agree_with_differences() {
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
