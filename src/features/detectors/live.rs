//! The tracker's own corners: FAST-9 on a pyramid, ranked by the smaller eigenvalue of the structure tensor (see `corners`).

use std::cell::RefCell;

use nalgebra::{Matrix2, Rotation2};

use super::Detector;
use crate::features::extractor::{ExtractorOptions, Feature, FeatureExtractor};
use crate::features::keypoint::{Keypoint, PictureForms};
use crate::features::pattern::PATCH_RADIUS;
use crate::features::workers::Workers;

/// The corners that a running tracker looks for.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LiveCorners {
    /// How they are found.
    pub options: ExtractorOptions,
}

/// One sigma of a corner's region, pixels of its level: that of an even disc as large as the patch that describes it.
pub(in crate::features) const REGION_SIGMA: f64 = PATCH_RADIUS as f64 / 2.0;

impl LiveCorners {
    /// The corners with their binary descriptions, found and described in one go.
    pub fn features(&self, picture: &PictureForms) -> Vec<Feature> {
        thread_local! {
            /// Its buffers, and the contrast that the last picture needed, make the next picture quicker and change nothing else.
            static EXTRACTOR: RefCell<FeatureExtractor> = RefCell::default();
        }
        let mut features = Vec::new();
        EXTRACTOR.with_borrow_mut(|extractor| extractor.extract(picture.grey, None, &self.options, &Workers::new(1), &mut features));
        features
    }

    /// A corner as a keypoint. All have the same response: those of different levels cannot be compared, and each level had its share.
    pub fn keypoint(feature: &Feature) -> Keypoint {
        let turn: Matrix2<f64> = Rotation2::new(f64::from(feature.angle)).into_inner();
        Keypoint { position: feature.position, shape: turn * (REGION_SIGMA * feature.scale), response: 1.0 }
    }
}

impl Detector for LiveCorners {
    fn detect(&self, picture: &PictureForms) -> Vec<Keypoint> {
        self.features(picture).iter().map(Self::keypoint).collect()
    }
}
