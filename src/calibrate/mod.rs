//! Calibration: from pictures of a chessboard to a camera model with its uncertainty, and a verdict
//! on how far to trust it.
//!
//! [`finder`] finds the [`board`]'s corners in each [`picture`], [`solve`] estimates the lens and
//! every board's pose, [`session`] alternates both until nothing moves, and [`judge`] assesses the
//! result. [`lateral_colour`] measures how much the colours differ in size. [`guide`] determines
//! which views are missing, [`pick`] takes views from a clip, [`origin`] reads which camera took a
//! picture, and [`report`] and [`table`] show the results.

pub mod board;
pub mod finder;
pub mod guide;
pub mod judge;
pub mod lateral_colour;
pub mod origin;
pub mod other_target;
pub mod pick;
pub mod picture;
mod recompute;
#[cfg(test)]
#[path = "../../tests/calibrate/rendered.rs"]
mod rendered;
pub mod report;
pub mod session;
pub mod solve;
pub mod table;
