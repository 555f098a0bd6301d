//! The camera: how a ray becomes a pixel and back, and the files that calibrations come in.

mod doubt;
mod files;
mod guess;
mod model;
pub mod plausible;

pub use doubt::{IntrinsicsUncertainty, LENS_WAYS, LensDoubt};
pub use files::{
    Calibration, CalibrationFileError, CalibrationForm, CalibrationProblem, calibration_bytes, parse_calibration, read_calibration,
};
pub use guess::LensGuess;
pub use model::{CameraError, CameraModel, Intrinsics, Normalized, Pixel};
