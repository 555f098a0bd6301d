//! Detectors: find the keypoints of a picture. One per file, with its source.

mod affine;
mod affine_measure;
mod harris;
mod live;
mod mser;
mod shape_adaptation;
mod sift;
mod surf;

pub use affine::AffineDetector;
pub use affine_measure::AffineMeasure;
pub use harris::{CornerMeasure, HarrisDetector};
pub use live::LiveCorners;
pub(super) use live::REGION_SIGMA;
pub use mser::MserDetector;
pub use sift::SiftDetector;
pub use surf::SurfDetector;
pub(in crate::features) use surf::surf_hessian;

use super::keypoint::{Keypoint, PictureForms};

/// Finds keypoints.
pub trait Detector {
    /// Returns the keypoints of a picture, most distinctive first; ties are in reading order, so
    /// that results are reproducible.
    fn detect(&self, picture: &PictureForms) -> Vec<Keypoint>;
}

/// Sorts by strength, strongest first; ties by row, column and scale.
fn strongest_first(keypoints: &mut [Keypoint]) {
    keypoints.sort_by(|a, b| {
        let key = |k: &Keypoint| [k.position.y, k.position.x, k.shape[(0, 0)], k.shape[(1, 1)], k.shape[(0, 1)]];
        let places = key(a).into_iter().zip(key(b)).map(|(a, b)| a.total_cmp(&b));
        b.response.total_cmp(&a.response).then(places.fold(std::cmp::Ordering::Equal, std::cmp::Ordering::then))
    });
}
