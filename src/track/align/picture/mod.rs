//! The reference picture as alignment reads it. All of it is prepared once, when a surface is
//! loaded, except `sight`, which is computed for each frame.
//!
//! - `texture`, `enlarge`: the picture at all levels, in tiles that share a cache line
//! - `plane_table`: the tangent planes of a bent surface
//! - `surface`: a surface with its texture, place and shape
//! - `sight`: the camera's pose relative to a surface, per row
//!
//! Uses `scene` and `align::lanes`.

pub mod enlarge;
#[allow(clippy::needless_range_loop)]
pub mod plane_table;
#[allow(clippy::needless_range_loop)]
pub mod sight;
pub mod surface;
pub mod texture;
