//! Calibration: pictures of a chessboard in, a camera model with its uncertainty out, and how far to trust it.
//!
//! [`finder`] finds the [`board`]'s corners in each [`picture`], [`solve`] estimates the lens and every board's pose,
//! [`session`] puts both together until nothing moves, [`judge`] says what the result is worth, [`guide`] which views are
//! missing, [`pick`] takes views from a clip, [`origin`] says which camera took a picture, [`report`] and
//! [`table`] show it all.

pub mod board;
pub mod finder;
pub mod guide;
pub mod judge;
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
