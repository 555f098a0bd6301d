//! The camera: how a ray becomes a pixel and back, and the files that calibrations come in.

mod model;

pub use model::{CameraError, CameraModel, Intrinsics, Normalized, Pixel};
