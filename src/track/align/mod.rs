//! Alignment: the pose at which the reference pictures, as the camera should see them, agree with
//! the frame pixel by pixel.
//!
//! Pixels are chosen where the reference is steep. Their light is predicted with its derivatives,
//! and pose, motion, light and point spread are solved for together, from small copies of the frame
//! up to its half size. Each frame is compared with the reference; earlier frames only give the
//! start and the predicted motion.
//!
//! Each room uses only the rooms above it:
//!
//! - `picture`: the reference picture as alignment reads it
//! - `learned`: the last frame's light; noise and exposure, learnt over many frames
//! - `pixels`: which pixels are compared, and what they should show
//! - `kernel`: the inner loops: residuals and their products, per tile
//! - `solve`: one level: all tiles together
//! - `frame_problem`: one frame for one body: all levels
//! - `hypotheses`: the list of what a frame may show
//!
//! `request` is what a caller asks for, `aligner` is what the rest of `track` uses, `lanes` has the
//! vector registers of the inner loops, and `kernels` opens these to benches.
//!
//! Source: direct alignment in the manner of Lucas and Kanade (1981) and Baker and Matthews (2004),
//! iteratively reweighted; the joint state follows the continuous-time rolling-shutter literature
//! (Hedborg et al. 2012).

mod aligner;
mod frame_problem;
mod hypotheses;
mod kernel;
mod kernels;
mod lanes;
mod learned;
mod picture;
mod pixels;
mod request;
mod solve;

pub use crate::track::frame::frame_levels::{FrameLevels, LEVELS};
pub use crate::track::frame::rays::CameraRays;
pub use aligner::Aligner;
pub use kernels::AlignKernels;
#[cfg(any(test, feature = "survey"))]
pub use learned::clue::Clue;
pub use picture::surface::AlignSurface;
pub use request::{AlignRequest, Start};
pub use solve::level_problem::patches::Patch;
#[cfg(feature = "cli")]
pub use solve::level_problem::pixel_shifts::PixelShift;
pub use solve::level_problem::solution::UsedPixel;
#[cfg(test)]
pub use solve::shutter_clue::ReadoutClue;
pub use solve::shutter_clue::{ReadoutQuestion, ShutterClue};
pub use solve::verdict::{Alignment, is_sharp};

#[cfg(test)]
mod kernel_tests;
pub mod tuning;
