//! The tracker's own corners: FAST-9 on a pyramid, ranked by the smaller eigenvalue of the
//! structure tensor (see `corners`).

use std::cell::RefCell;

use nalgebra::{Matrix2, Rotation2};

use super::Detector;
use crate::features::extractor::{ExtractorOptions, Feature, FeatureExtractor};
use crate::features::pattern::PATCH_RADIUS;
use crate::features::two_views::keypoint::{Keypoint, PictureForms};
use crate::features::workers::Workers;

/// The corners that a running tracker detects.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LiveCorners {
    /// Extraction options.
    pub options: ExtractorOptions,
}

/// One sigma of a corner's region, pixels of its level: that of a uniform disc as large as the
/// descriptor's patch.
pub(in crate::features::two_views) const REGION_SIGMA: f64 = PATCH_RADIUS as f64 / 2.0;

impl LiveCorners {
    /// Finds and describes the corners in one pass.
    pub fn features(&self, picture: &PictureForms) -> Vec<Feature> {
        thread_local! {
            /// Its buffers, and the contrast that the last picture needed, only speed up the next
            /// picture.
            static EXTRACTOR: RefCell<FeatureExtractor> = RefCell::default();
        }
        let mut features = Vec::new();
        EXTRACTOR.with_borrow_mut(|extractor| extractor.extract(picture.grey, None, &self.options, &Workers::new(1), &mut features));
        features
    }

    /// Converts a corner to a keypoint. All have the same response: strengths on different levels
    /// are not comparable, and each level has its quota.
    pub fn keypoint(feature: &Feature) -> Keypoint {
        let rotation: Matrix2<f64> = Rotation2::new(f64::from(feature.angle)).into_inner();
        Keypoint { position: feature.position, shape: rotation * (REGION_SIGMA * feature.scale), response: 1.0 }
    }
}

impl Detector for LiveCorners {
    fn detect(&self, picture: &PictureForms) -> Vec<Keypoint> {
        self.features(picture).iter().map(Self::keypoint).collect()
    }
}
