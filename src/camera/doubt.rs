//! How far the numbers of a lens may be off.
//!
//! A calibration file tells the uncertainty of each number by itself, a guessed lens one of its focal length and centre.
//! Neither tells how the errors hang together, so each number's error counts alone; only of the two focal lengths it is known that they mostly err together (pixels are square).

/// 3 sigma of the numbers of [`Intrinsics`](super::Intrinsics), in the same units; 0 for a number that was held fixed.
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

/// How far the numbers of a lens may be off.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct LensDoubt {
    /// 3 sigma of each number.
    pub uncertainty: IntrinsicsUncertainty,
    /// True where fx and fy are known to be equal, so that they can only err together.
    pub has_square_pixels: bool,
    /// True where nothing says so: it is what calibrations usually are off by.
    pub is_assumed: bool,
}

/// One sigma of the focal length of a calibration that does not say its uncertainty, as a share of it. Raised, poses are less sure until frames show the focal length; lowered, calibrations that
/// are a little off are believed.
const ASSUMED_FOCAL_SHARE: f64 = 0.003;

/// Ways in which a lens may be off: both focal lengths together, one against the other, and the eight other numbers.
pub const LENS_WAYS: usize = 10;
/// Which of them is both focal lengths together.
pub const FOCAL_WAY: usize = 0;

impl LensDoubt {
    /// Of a calibration that tells its uncertainty; none where it claims to have none.
    pub fn of_calibration(uncertainty: Option<IntrinsicsUncertainty>) -> Option<Self> {
        let doubt = uncertainty.map(|uncertainty| Self { uncertainty, has_square_pixels: false, is_assumed: false });
        doubt.filter(|doubt| doubt.uncertainty != IntrinsicsUncertainty::default())
    }

    /// Of a calibration of this focal length as a file has it: one that says nothing of its uncertainty is off by what is usual.
    pub fn of_file(focal_px: f64, uncertainty: Option<IntrinsicsUncertainty>) -> Option<Self> {
        let usual = IntrinsicsUncertainty { focal_px: [3.0 * ASSUMED_FOCAL_SHARE * focal_px; 2], ..IntrinsicsUncertainty::default() };
        let assumed = Self { uncertainty: usual, has_square_pixels: true, is_assumed: true };
        uncertainty.map_or(Some(assumed), |uncertainty| Self::of_calibration(Some(uncertainty)))
    }

    /// The doubt about the same lens at another picture size.
    pub(super) fn scaled(self, sx: f64, sy: f64) -> Self {
        let u = self.uncertainty;
        let scaled = |[x, y]: [f64; 2]| [x * sx, y * sy];
        Self { uncertainty: IntrinsicsUncertainty { focal_px: scaled(u.focal_px), centre_px: scaled(u.centre_px), ..u }, ..self }
    }
}
