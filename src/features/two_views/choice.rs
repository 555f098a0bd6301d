//! Selects any detector and any descriptor by name, through one interface.

use std::cell::Cell;

use image::GrayImage;

use super::descriptors::{
    BinaryComparisons, Describer, GlohDescriber, PatchDescriber, SiftDescriber, StructureTensorDescriber, SurfDescriber,
};
use super::detectors::{
    AffineDetector, AffineMeasure, CornerMeasure, Detector, HarrisDetector, LiveCorners, MserDetector, SiftDetector, SurfDetector,
};
use super::keypoint::{Descriptors, Features, Keypoint, PictureForms};
use super::view_simulation::ViewSimulation;
use super::watch::{Share, Watch};

/// How keypoints are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum DetectorKind {
    /// The tracker's own corners.
    Live,
    /// Harris and Stephens 1988.
    Harris,
    /// Noble 1988.
    Noble,
    /// Shi and Tomasi 1994.
    ShiTomasi,
    /// Lowe 2004.
    Sift,
    /// Bay et al. 2008.
    Surf,
    /// Matas et al. 2002.
    Mser,
    /// Mikolajczyk and Schmid 2004.
    HarrisAffine,
    /// Mikolajczyk and Schmid 2004.
    HessianAffine,
    /// SIFT on simulated views of both pictures (Morel and Yu 2009).
    Asift,
}

impl DetectorKind {
    /// All kinds with their names.
    pub const ALL: [(&'static str, Self); 10] = [
        ("live", Self::Live),
        ("harris", Self::Harris),
        ("noble", Self::Noble),
        ("shi-tomasi", Self::ShiTomasi),
        ("sift", Self::Sift),
        ("surf", Self::Surf),
        ("mser", Self::Mser),
        ("harris-affine", Self::HarrisAffine),
        ("hessian-affine", Self::HessianAffine),
        ("asift", Self::Asift),
    ];

    /// Returns its name.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, kind)| *kind == self).map_or("", |(name, _)| name)
    }

    /// Returns the descriptor used with it by default.
    pub fn usual_descriptor(self) -> DescriptorKind {
        match self {
            Self::Live => DescriptorKind::Live,
            Self::Harris | Self::Noble | Self::ShiTomasi => DescriptorKind::Patch,
            Self::Surf => DescriptorKind::Surf,
            Self::Sift | Self::Mser | Self::HarrisAffine | Self::HessianAffine | Self::Asift => DescriptorKind::Sift,
        }
    }
}

/// How keypoints are described.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum DescriptorKind {
    /// The tracker's own binary brightness comparisons.
    Live,
    /// The surrounding pixels, zero mean and unit norm.
    Patch,
    /// The three elements of the structure tensor.
    StructureTensor,
    /// Lowe 2004.
    Sift,
    /// Bay et al. 2008.
    Surf,
    /// Mikolajczyk and Schmid 2005.
    Gloh,
}

impl DescriptorKind {
    /// All kinds with their names.
    pub const ALL: [(&'static str, Self); 6] = [
        ("live", Self::Live),
        ("patch", Self::Patch),
        ("structure-tensor", Self::StructureTensor),
        ("sift", Self::Sift),
        ("surf", Self::Surf),
        ("gloh", Self::Gloh),
    ];

    /// Returns its name.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, kind)| *kind == self).map_or("", |(name, _)| name)
    }
}

/// A detector, a descriptor and their options; `None` means the detector's default.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct FeatureSettings {
    /// How keypoints are found.
    pub detector: DetectorKind,
    /// How they are described.
    pub descriptor: DescriptorKind,
    /// Maximum number of keypoints (the source's `nfeat`).
    pub count: Option<usize>,
    /// Minimum response, in the detector's unit (the source's `cmin`).
    pub least_response: Option<f32>,
    /// Minimum distance of two corners, pixels; the weaker one is dropped (the source's
    /// `suppress`).
    pub suppress_px: Option<f64>,
    /// Half the width of a patch, pixels (the source's `patch`).
    pub half_width: Option<usize>,
    /// Harris' k.
    pub k: Option<f64>,
    /// Smoothing of the gradient products, sigma in pixels.
    pub sigma_px: Option<f64>,
}

impl FeatureSettings {
    /// Creates settings for a detector with its default descriptor.
    pub fn of(detector: DetectorKind) -> Self {
        Self {
            detector,
            descriptor: detector.usual_descriptor(),
            count: None,
            least_response: None,
            suppress_px: None,
            half_width: None,
            k: None,
            sigma_px: None,
        }
    }
}

/// Finds the keypoints of a picture and describes them.
pub fn extract(picture: &GrayImage, settings: &FeatureSettings) -> Features {
    features(&PictureForms::new(picture), settings)
}

/// Like [`extract`]. `goes_on` is called repeatedly with the progress; when it returns false, the
/// work stops and the result is `None`.
pub fn extract_watched(picture: &GrayImage, settings: &FeatureSettings, goes_on: &dyn Fn(Share) -> bool) -> Option<Features> {
    let is_ended = Cell::new(false);
    let report = |share| {
        is_ended.set(is_ended.get() || !goes_on(share));
        !is_ended.get()
    };
    if !report(Share::NOTHING) {
        return None;
    }
    let found = features(&PictureForms::watched(picture, Watch::new(&report)), settings);
    (!is_ended.get()).then_some(found)
}

fn features(forms: &PictureForms, settings: &FeatureSettings) -> Features {
    if (settings.detector, settings.descriptor) == (DetectorKind::Live, DescriptorKind::Live) {
        let features = live_corners(settings).features(forms);
        let keypoints = features.iter().map(LiveCorners::keypoint).collect();
        return Features { keypoints, descriptors: Descriptors::Bits(features.iter().map(|f| f.descriptor).collect()) };
    }
    let describer = describer(settings);
    if settings.detector == DetectorKind::Asift {
        let sift = detector(&FeatureSettings { detector: DetectorKind::Sift, ..*settings });
        return ViewSimulation::default().features(forms, sift.as_ref(), describer.as_ref());
    }
    describer.describe(forms, &found(forms, settings))
}

/// Finds the keypoints of a picture without descriptors.
pub fn detect(picture: &GrayImage, settings: &FeatureSettings) -> Vec<Keypoint> {
    match settings.detector {
        DetectorKind::Asift => extract(picture, settings).keypoints,
        _ => found(&PictureForms::new(picture), settings),
    }
}

/// Returns the detector's keypoints that are strong enough.
fn found(forms: &PictureForms, settings: &FeatureSettings) -> Vec<Keypoint> {
    let mut keypoints = detector(settings).detect(forms);
    keypoints.retain(|k| settings.least_response.is_none_or(|least| k.response >= least));
    keypoints
}

fn live_corners(settings: &FeatureSettings) -> LiveCorners {
    let mut corners = LiveCorners::default();
    corners.options.count = settings.count.unwrap_or(corners.options.count);
    corners
}

fn detector(settings: &FeatureSettings) -> Box<dyn Detector> {
    let corners = |measure| Box::new(harris(settings, measure));
    match settings.detector {
        DetectorKind::Live => Box::new(live_corners(settings)),
        DetectorKind::Harris => corners(CornerMeasure::Harris),
        DetectorKind::Noble => corners(CornerMeasure::Noble),
        DetectorKind::ShiTomasi => corners(CornerMeasure::ShiTomasi),
        DetectorKind::Sift | DetectorKind::Asift => {
            let usual = SiftDetector::default();
            let contrast = settings.least_response.map_or(usual.contrast, f64::from);
            Box::new(SiftDetector { count: settings.count.unwrap_or(usual.count), contrast, ..usual })
        }
        DetectorKind::Surf => {
            let usual = SurfDetector::default();
            let least_determinant = settings.least_response.map_or(usual.least_determinant, f64::from);
            Box::new(SurfDetector { count: settings.count.unwrap_or(usual.count), least_determinant, ..usual })
        }
        DetectorKind::Mser => {
            let usual = MserDetector::default();
            Box::new(MserDetector { count: settings.count.unwrap_or(usual.count), ..usual })
        }
        DetectorKind::HarrisAffine => affine(settings, AffineMeasure::Harris),
        DetectorKind::HessianAffine => affine(settings, AffineMeasure::Hessian),
    }
}

fn affine(settings: &FeatureSettings, measure: AffineMeasure) -> Box<dyn Detector> {
    let usual = AffineDetector { measure, ..AffineDetector::default() };
    Box::new(AffineDetector { count: settings.count.unwrap_or(usual.count), ..usual })
}

fn harris(settings: &FeatureSettings, measure: CornerMeasure) -> HarrisDetector {
    let usual = HarrisDetector { measure, ..HarrisDetector::default() };
    HarrisDetector {
        k: settings.k.unwrap_or(usual.k),
        sigma: settings.sigma_px.unwrap_or(usual.sigma),
        count: settings.count.unwrap_or(CORNERS),
        least_strength: settings.least_response.map_or(usual.least_strength, f64::from),
        suppress: settings.suppress_px.unwrap_or(usual.suppress),
        ..usual
    }
}

/// Default maximum number of corners: every pixel may be a local maximum, and matching takes
/// quadratic time. Raised, matching takes longer.
const CORNERS: usize = 5000;

fn describer(settings: &FeatureSettings) -> Box<dyn Describer> {
    match settings.descriptor {
        DescriptorKind::Live => Box::new(BinaryComparisons),
        DescriptorKind::Patch => {
            let usual = PatchDescriber::default();
            Box::new(PatchDescriber { half_width: settings.half_width.unwrap_or(usual.half_width) })
        }
        DescriptorKind::StructureTensor => {
            let usual = StructureTensorDescriber::default();
            Box::new(StructureTensorDescriber { sigma: settings.sigma_px.unwrap_or(usual.sigma), ..usual })
        }
        DescriptorKind::Sift => Box::new(SiftDescriber::default()),
        DescriptorKind::Surf => Box::new(SurfDescriber::default()),
        DescriptorKind::Gloh => Box::new(GlohDescriber::default()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kind_has_its_own_name() {
        for (name, kind) in DetectorKind::ALL {
            assert_eq!(kind.name(), name);
        }
        for (name, kind) in DescriptorKind::ALL {
            assert_eq!(kind.name(), name);
        }
    }

    /// Rings, squares and spots on a brightness gradient, each at its own place.
    fn picture() -> GrayImage {
        GrayImage::from_fn(240, 180, |x, y| {
            let (cx, cy) = ((x % 40) as f32 - 20.0, (y % 45) as f32 - 22.0);
            let kind = (x / 40 + 3 * (y / 45)) % 3;
            let radius = 6.0 + ((x / 40) * 7 + (y / 45) * 5).rem_euclid(8) as f32;
            let inside = match kind {
                0 => cx.hypot(cy) < radius,
                1 => cx.abs().max(cy.abs()) < radius,
                _ => (cx + 0.5 * cy).abs().max(cy.abs()) < radius,
            };
            image::Luma([if inside { 200 - (x / 6) as u8 } else { 60 + (y / 4) as u8 }])
        })
    }

    #[test]
    fn every_detector_goes_with_every_descriptor() {
        for (_, detector) in DetectorKind::ALL {
            for (_, descriptor) in DescriptorKind::ALL {
                let settings = FeatureSettings { descriptor, count: Some(60), half_width: Some(5), ..FeatureSettings::of(detector) };
                let found = extract(&picture(), &settings);
                assert_eq!(found.keypoints.len(), found.descriptors.len(), "{detector:?} {descriptor:?}");
                assert!(found.keypoints.len() >= 10, "{detector:?} {descriptor:?}: {}", found.keypoints.len());
                assert_eq!(found, extract(&picture(), &settings), "{detector:?} {descriptor:?}");
            }
        }
    }

    #[test]
    fn pictures_without_anything_have_no_features() {
        for (width, height) in [(0, 0), (1, 1), (640, 1), (1, 480), (90, 70)] {
            for (_, detector) in DetectorKind::ALL {
                let even = GrayImage::from_pixel(width, height, image::Luma([90]));
                assert!(extract(&even, &FeatureSettings::of(detector)).keypoints.is_empty(), "{detector:?} {width} x {height}");
            }
        }
    }
}
