//! Calibration.
pub mod board;
pub mod finder;
