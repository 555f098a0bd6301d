//! Descriptors: from a keypoint to numbers or bits that say what surrounds it. One a file, with its source.

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
    /// The keypoints that can be described, each with its description. A keypoint too close to the border is left out; one with two directions
    /// comes twice. Directions of the keypoints that came are assigned anew.
    fn describe(&self, picture: &PictureForms, keypoints: &[Keypoint]) -> Features;
}
