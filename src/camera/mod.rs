//! The camera: how a ray becomes a pixel and back, and the files that calibrations come in.

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

pub use doubt::{FOCAL_WAY, IntrinsicsUncertainty, LENS_WAYS, LensDoubt};
#[cfg(feature = "daemon")]
pub(crate) use files::slips;
#[cfg(feature = "calibration-files")]
pub use files::{Calibration, CalibrationFileError, CalibrationForm, CalibrationProblem, parse_calibration};
pub use guess::LensGuess;
pub use model::{CameraError, CameraModel, Intrinsics, Normalized, Pixel};
pub use shutter::{KnownShutter, Shutter};
