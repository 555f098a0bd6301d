//! The inner loops: residuals and their products, summed per run of pixels (one surface in one
//! tile). Eight pixels are handled at a time.
//!
//! - `columns`, `rows`: the unknowns of a tile, and how they change from row to row
//! - `normal`: residuals, their derivatives and robust weights
//! - `tile_equations`, `tile_products`: the normal equations of a tile
//! - `evidence`, `noise_sums`, `curve_sums`: what the residuals say about the pose, the noise and
//!   the camera's curve
//!
//! Uses `align::pixels`, `align::learned` and `align::lanes`.

#[allow(clippy::needless_range_loop)]
pub mod columns;
pub mod curve_sums;
#[allow(clippy::needless_range_loop)]
pub mod evidence;
#[allow(clippy::needless_range_loop)]
pub mod noise_sums;
#[allow(clippy::needless_range_loop)]
pub mod normal;
pub mod rows;
pub mod tile_equations;
#[allow(clippy::needless_range_loop)]
pub mod tile_products;
