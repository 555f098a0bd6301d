//! Descriptors: turn a keypoint into numbers or bits that describe its surroundings. One per file,
//! with its source.

mod binary;
mod gloh;
mod gradients;
mod orientation;
mod patch;
mod region;
mod shares;
mod sift;
mod structure_tensor;
mod surf;
mod window;

pub use binary::BinaryComparisons;
pub use gloh::{Basis, GlohDescriber};
pub use patch::PatchDescriber;
pub use sift::SiftDescriber;
pub use structure_tensor::StructureTensorDescriber;
pub use surf::SurfDescriber;

use super::keypoint::{Features, Keypoint, PictureForms};

/// Describes keypoints.
pub trait Describer {
    /// Returns the keypoints that can be described, with their descriptors. A keypoint too close to
    /// the border is dropped; one with two orientations occurs twice. Orientations of the input
    /// keypoints are recomputed.
    fn describe(&self, picture: &PictureForms, keypoints: &[Keypoint]) -> Features;
}
