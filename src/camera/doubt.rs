//! Uncertainty of the lens parameters.
//!
//! A calibration file states the uncertainty of each parameter separately; a guessed lens has one
//! for its focal length and centre. Neither states correlations, so errors count as independent.
//! The exception is the two focal lengths: they mostly err together (square pixels).

/// 3 sigma of the parameters of [`Intrinsics`](super::Intrinsics), in the same units; 0 for a
/// parameter that was held fixed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct IntrinsicsUncertainty {
    /// Of fx and fy.
    pub focal_px: [f64; 2],
    /// Of cx and cy.
    pub centre_px: [f64; 2],
    /// Of alpha_c.
    pub skew: f64,
    /// Of k1, k2, p1, p2 and k3.
    pub distortion: [f64; 5],
}

/// Uncertainty of the lens parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct LensDoubt {
    /// 3 sigma of each parameter.
    pub uncertainty: IntrinsicsUncertainty,
    /// Whether fx and fy are known to be equal, so that they can only err together.
    pub has_square_pixels: bool,
}

/// Number of independent lens error modes: both focal lengths together, their difference, and the
/// eight other parameters.
pub const LENS_WAYS: usize = 10;

impl LensDoubt {
    /// Takes the uncertainty a calibration states; `None` if it states none or only zeros.
    pub fn of_calibration(uncertainty: Option<IntrinsicsUncertainty>) -> Option<Self> {
        let doubt = uncertainty.map(|uncertainty| Self { uncertainty, has_square_pixels: false });
        doubt.filter(|doubt| doubt.uncertainty != IntrinsicsUncertainty::default())
    }

    /// Scales the doubt to another picture size.
    pub(super) fn scaled(self, sx: f64, sy: f64) -> Self {
        let u = self.uncertainty;
        let scaled = |[x, y]: [f64; 2]| [x * sx, y * sy];
        Self { uncertainty: IntrinsicsUncertainty { focal_px: scaled(u.focal_px), centre_px: scaled(u.centre_px), ..u }, ..self }
    }
}
