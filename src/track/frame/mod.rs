//! One frame and the camera's rays: what is computed once per frame or per camera, whatever is
//! tracked. Nothing here knows a body.
//!
//! - `level_numbers`: the sizes at which a frame is looked at
//! - `frame_levels`: the frame at a half to a sixteenth of its size
//! - `light_levels`: its light at these sizes
//! - `rays`: the ray of every pixel, computed once per level
//! - `tile_grid`: the cells of the frame whose pixels vote together
//! - `frame_look`: whether the frame is dark, white, plain or blurred
//!
//! Uses only the core's camera.

pub mod frame_levels;
pub mod frame_look;
pub mod level_numbers;
pub mod light_levels;
pub mod rays;
pub mod tile_grid;
pub mod tuning;
