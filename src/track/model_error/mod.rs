//! What residuals say of lens, shape, layout and shutter: covariance to add, events to raise, poses
//! to withhold. Nothing here moves a pose.
//!
//! - `tile_residuals`: the displacements that a solution leaves in its tiles
//! - `smooth_field`, `field_error`: the covariance if they were one smooth field of shifts
//! - `lens_doubt`, `surface_doubt`, `shape_doubt`: the covariance by what the config leaves open
//! - `focal_clue`, `focal_step`, `lens_watch`: whether the focal length has changed
//! - `model_unknowns`, `model_study`, `model_watch`, `misfit`: which part of the model is wrong
//! - `moments`: frames that show two moments at once
//!
//! Uses `scene`, `patches` and `align`.

pub mod field_error;
pub mod focal_clue;
pub mod focal_step;
pub mod lens_doubt;
pub mod lens_watch;
pub mod misfit;
pub mod model_study;
pub mod model_unknowns;
pub mod model_watch;
pub mod moments;
pub mod shape_doubt;
pub mod smooth_field;
pub mod surface_doubt;
pub mod tile_residuals;
