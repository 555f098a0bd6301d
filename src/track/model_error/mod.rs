//! Model errors: what the residual tile displacements of a solved pose say about errors in the
//! lens, the shapes and layout of surfaces, and the shutter. The results are covariance to add,
//! events to report, and reasons to withhold a pose. Nothing here moves a pose.
//!
//! - `tile_residuals`: the residual displacements of the tiles, which everything below reads
//! - `smooth_field`, `field_error`: covariance of the pose if the residuals were one smooth field
//!   of shifts
//! - `lens_doubt`, `surface_doubt`, `shape_doubt`: covariance from the uncertainties stated in the
//!   config
//! - `focal_clue`, `focal_step`, `lens_watch`: whether the focal length has changed
//! - `model_unknowns`, `model_study`, `model_watch`, `misfit`: which part of the model is wrong
//! - `moments`: frames that mix two moments in time
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
pub mod tuning;
