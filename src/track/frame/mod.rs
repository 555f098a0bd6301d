//! One frame and the camera's rays. Nothing here knows a body.
//!
//! - `frame_levels`: the frame at a half to a sixteenth of its size
//! - `rays`: the ray of every pixel, computed once per level
//! - `tile_grid`: the cells of the frame whose pixels vote together
//! - `frame_look`: whether the frame is dark, white, plain or blurred
//!
//! Uses the core's camera only.

pub mod frame_levels;
pub mod frame_look;
pub mod rays;
pub mod tile_grid;
