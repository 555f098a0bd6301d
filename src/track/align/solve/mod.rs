//! Solves one pyramid level: all tiles together, for motion, light and point spread.
//!
//! - `system`: the linear system of one step
//! - `minimiser`: the loop over steps, whatever is minimised
//! - `level_problem`: linearises, weights, solves and judges one level
//! - `tile_correlation`, `aperture`, `verdict`: whether tiles show the picture, and whether the
//!   result may be reported
//! - `jump_instant`: when a velocity jump happened
//! - `shutter_clue`: what the solution says of the shutter
//!
//! Uses `align::kernel`.

pub mod aperture;
pub mod jump_instant;
pub mod level_problem;
pub mod minimiser;
pub mod shutter_clue;
#[allow(clippy::needless_range_loop)]
pub mod system;
pub mod tile_correlation;
pub mod verdict;
