//! Detectors: from a picture to its keypoints. One a file, with its source.

mod sift;

pub use sift::SiftDetector;

use super::keypoint::{Keypoint, PictureForms};

/// Finds keypoints.
pub trait Detector {
    /// The keypoints of a picture, most distinctive first; among equals in the order of rows and columns, so that the same picture gives the same.
    fn detect(&self, picture: &PictureForms) -> Vec<Keypoint>;
}
