//! The camera: projection of rays to pixels and back, and calibration files.
//!
//! `model` has the lens model, `doubt` and `pixel_doubt` its uncertainty, `guess` a lens without
//! calibration, `plausible` the checks of its parameters, and `shutter` the exposure and readout
//! times. `files` reads and writes calibrations. Uses `geometry` only.

mod doubt;
#[cfg(feature = "calibration-files")]
mod files;
mod guess;
mod model;
mod pixel_doubt;
#[cfg(feature = "calibration-files")]
pub mod plausible;
mod shutter;
#[cfg(any(feature = "calibration-files", feature = "capture"))]
pub mod size;
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
