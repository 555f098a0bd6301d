//! The camera: projection of rays to pixels and back, and calibration files.

mod doubt;
#[cfg(feature = "calibration-files")]
mod files;
mod guess;
mod model;
mod pixel_doubt;
pub mod plausible;
mod shutter;
#[cfg(any(feature = "calibration-files", feature = "capture"))]
pub(crate) mod utf16;

pub use doubt::{IntrinsicsUncertainty, LENS_WAYS, LensDoubt};
#[cfg(feature = "daemon")]
pub(crate) use files::slips;
#[cfg(feature = "calibration-files")]
pub use files::{Calibration, CalibrationFileError, CalibrationForm, CalibrationProblem, parse_calibration};
pub use guess::LensGuess;
pub use model::{CameraError, CameraModel, Intrinsics, Normalized, Pixel};
pub use shutter::{KnownShutter, Shutter};
