//! Which pixels are compared, and what they should show. For each level of a frame, in this order:
//!
//! - `level_spec`: the task of one level of one frame: surfaces, camera, shutter, noise, blur, and
//!   how many pixels and samples
//! - `selection`, `runs`: pixels are chosen where the reference is steep, and laid out in runs
//! - `touching_planes`: a bent surface as the planes that touch it
//! - `appearance`: the predicted grey of every chosen pixel, with its derivatives
//!
//! Uses `scene`, `frame`, `align::picture`, `align::learned` and `align::lanes`.

#[allow(clippy::needless_range_loop)]
pub mod appearance;
pub mod level_spec;
pub mod runs;
pub mod selection;
#[allow(clippy::needless_range_loop)]
pub mod touching_planes;
