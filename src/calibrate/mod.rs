//! Calibration.
pub mod board;
pub mod finder;
pub mod guide;
pub mod judge;
mod recompute;
pub mod session;
pub mod solve;
