//! The camera: how a ray becomes a pixel and back, and the files that calibrations come in.

mod files;
mod model;

pub use files::{
    Calibration, CalibrationFileError, CalibrationForm, CalibrationProblem, IntrinsicsUncertainty, calibration_bytes, parse_calibration,
    read_calibration,
};
pub use model::{CameraError, CameraModel, Intrinsics, Normalized, Pixel};
