//! Calibration.
pub mod board;
pub mod finder;
pub mod solve;
