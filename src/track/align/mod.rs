//! Alignment: the pose that makes the reference, as the camera should see it, agree with the frame pixel by pixel.
//!
//! From where the motion filter expects the camera, pixels are chosen where the reference is steep (`selection`), their
//! grey is predicted with its derivatives (`appearance`), and pose, motion, light and point spread are solved for
//! together (`normal`, `system`), from small copies of the frame to its half size. Every frame is compared with the
//! reference; earlier frames only give the start and the motion.
//!
//! Source: direct alignment in the manner of Lucas and Kanade (1981) and Baker and Matthews (2004), iteratively
//! reweighted; the joint state follows the continuous-time rolling-shutter literature (Hedborg et al. 2012).

mod aligner;
mod aperture;
// Index loops: what closures do would not be compiled for the wider registers of the function around them.
#[allow(clippy::needless_range_loop)]
mod appearance;
mod clue;
#[allow(clippy::needless_range_loop)]
mod columns;
mod enlarge;
#[allow(clippy::needless_range_loop)]
mod evidence;
mod exposure;
mod exposure_watch;
mod frame_levels;
mod frame_problem;
#[allow(clippy::needless_range_loop)]
mod gradient_gain;
mod jump_instant;
mod kernels;
mod lanes;
mod level_problem;
mod level_spec;
mod light;
mod noise;
#[allow(clippy::needless_range_loop)]
mod noise_sums;
#[allow(clippy::needless_range_loop)]
mod normal;
mod pixels;
#[allow(clippy::needless_range_loop)]
mod plane_table;
mod rays;
mod rows;
mod selection;
mod shutter_clue;
#[allow(clippy::needless_range_loop)]
mod sight;
mod slow_estimates;
mod surface;
#[allow(clippy::needless_range_loop)]
mod system;
mod texture;
mod tile_correlation;
mod tile_equations;
mod tile_grid;
#[allow(clippy::needless_range_loop)]
mod tile_products;
#[allow(clippy::needless_range_loop)]
mod touching_planes;
mod velocity_by_blur;
mod velocity_jump;
mod verdict;

pub use aligner::Aligner;
pub use clue::Clue;
pub use frame_levels::{FrameLevels, LEVELS};
pub use kernels::AlignKernels;
pub use level_problem::patches::Patch;
pub use level_problem::solution::UsedPixel;
pub use rays::CameraRays;
#[cfg(test)]
pub use shutter_clue::ReadoutClue;
pub use shutter_clue::{ReadoutQuestion, ShutterClue};
pub use surface::AlignSurface;
pub use verdict::{Alignment, is_sharp};

#[cfg(test)]
mod kernel_tests;
