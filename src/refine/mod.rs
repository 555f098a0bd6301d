//! Poses of a recorded take, each from the frames before and after it (contract C14).
//!
//! While a show runs, every pose is measured in one frame. Afterwards the whole take is known: a
//! Kalman filter with white jerk runs through it, and a second pass backwards corrects every state
//! by what came later (Rauch, Tung and Striebel 1965). The density of the jerk is the one that
//! explains the take best. Rows in which nothing was seen for a moment are bridged.
//!
//! - `smoother`: the two passes over one stretch of rows
//! - `take`: stretches of a body's rows, and what remains of gaps
//!
//! Only the noise of single frames averages out. Errors that all frames share (lens, layout) stay,
//! and so does their covariance.

mod smoother;
mod take;

pub use take::{Measured, Refined, Row, refine};
