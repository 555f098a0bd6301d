//! Compares two pictures: how points of one map to the other, and how the camera moved between
//! them. This is the source's method, corrected.
//!
//! Features of both pictures are found, described and matched. A homography, a fundamental matrix
//! and, with cameras, an essential matrix are estimated robustly from the matches and refined. Each
//! is tested against chance, and the model that explains the matches best is chosen. The camera's
//! motion follows from it, with the sign that puts the points in front of both cameras.
//!
//! [`compare`] does no file access; [`report`] renders its results.

pub mod detector_scores;
pub mod known_views;
mod relations;
pub mod report;

use image::GrayImage;
use nalgebra::{Matrix3, UnitQuaternion, Vector2, Vector3};

use crate::camera::{CameraModel, Pixel};
use crate::features::two_views::{FeatureSettings, Features, Share, extract_watched};
use crate::geometry::PointPair;
use crate::geometry::relative_pose::{RayPair, TwoViewMotion};
use crate::matching::exact::{ExactMatch, ExactOptions, match_watched};

/// A picture and, if known, its camera.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// Grey levels.
    pub picture: &'a GrayImage,
    /// Its camera, calibrated for this picture size.
    pub camera: Option<&'a CameraModel>,
}

/// Options of a comparison.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct CompareOptions {
    /// Detector and descriptor.
    pub features: FeatureSettings,
    /// Matching criteria.
    pub matching: ExactOptions,
    /// Maximum Sampson distance of an inlier to F or E, pixels. Raised, wrong matches agree;
    /// lowered, less accurate right ones do not. The default is 2.4 times SIFT's worst keypoint
    /// noise: in photographs of planes it is 0.2 to 0.5 pixels. The homography's noise is
    /// estimated, up to 2.5 times this; matches within 1.25 times this always agree with it.
    pub threshold_px: f64,
    /// Distance between the camera positions, metres, if known.
    pub baseline_m: Option<f64>,
    /// Seed of the random sampling.
    pub seed: u64,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self {
            features: FeatureSettings::of(crate::features::two_views::DetectorKind::Sift),
            matching: ExactOptions::default(),
            threshold_px: 1.2,
            baseline_m: None,
            seed: 1,
        }
    }
}

/// The current step of the work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Step {
    /// Finding and describing the keypoints of the first picture.
    FirstFeatures,
    /// Finding and describing the keypoints of the second picture.
    SecondFeatures,
    /// Comparing the descriptors.
    Matching,
    /// Estimating the models.
    Geometry,
}

impl Step {
    /// All steps, in order.
    pub const ALL: [Self; 4] = [Self::FirstFeatures, Self::SecondFeatures, Self::Matching, Self::Geometry];

    /// Names the step in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::FirstFeatures => "features of the first picture",
            Self::SecondFeatures => "features of the second picture",
            Self::Matching => "matching",
            Self::Geometry => "geometry",
        }
    }
}

/// A relation between two pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Model {
    /// A flat scene, or pure camera rotation: a point maps to a point.
    Homography,
    /// A scene with depth: a point maps to a line.
    Fundamental,
    /// The same, for calibrated cameras.
    Essential,
}

/// A matrix that relates two pictures.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Relation {
    /// H (h33 = 1), F or E (unit norm).
    pub matrix: Matrix3<f64>,
    /// Indices of the inlier matches, ascending.
    pub inliers: Vec<usize>,
    /// Error of the inliers, one sigma along each direction that the model predicts, pixels.
    pub sigma_px: f64,
}

/// How the camera moved from the first picture to the second: `x_second ∝ R x_first + t`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct CameraMove {
    /// R.
    pub rotation: UnitQuaternion<f64>,
    /// t / |t| in the second camera's axes; `None` if the pictures show no parallax.
    pub direction: Option<Vector3<f64>>,
    /// Number of inliers in front of both cameras.
    pub in_front: usize,
    /// Median angle between the two cameras' rays to the points, degrees.
    pub parallax_deg: f64,
    /// Whether a second motion explains the matches as well, as with a flat scene seen from afar.
    pub is_ambiguous: bool,
}

impl CameraMove {
    /// Returns the motion, if its direction is known.
    pub fn motion(&self) -> Option<TwoViewMotion> {
        Some(TwoViewMotion { rotation: self.rotation, direction: self.direction? })
    }
}

/// The result of a comparison.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Comparison {
    /// The features used.
    pub settings: FeatureSettings,
    /// Features of both pictures.
    pub features: [Features; 2],
    /// Matches, best ratio first.
    pub matches: Vec<ExactMatch>,
    /// The two positions of each match, pixels; undistorted if cameras are given.
    pub pairs: Vec<PointPair>,
    /// The same as rays of the cameras.
    pub rays: Option<Vec<RayPair>>,
    /// H maps the first picture's pixels to the second's.
    pub homography: Option<Relation>,
    /// F: `x_second^T F x_first = 0`, pixels.
    pub fundamental: Option<Relation>,
    /// E = \[t\]x R.
    pub essential: Option<Relation>,
    /// The camera's motion; only with cameras.
    pub camera_move: Option<CameraMove>,
    /// The model that explains the matches best.
    pub model: Option<Model>,
    cameras: Option<[CameraModel; 2]>,
    baseline_m: Option<f64>,
}

/// Compares two pictures. `goes_on` is called repeatedly with the current step and its progress;
/// when it returns false, the work stops and the result is `None`.
///
/// Cameras are used only if both pictures have one.
pub fn compare(first: &View, second: &View, options: &CompareOptions, goes_on: &dyn Fn(Step, Share) -> bool) -> Option<Comparison> {
    let mut features = Vec::with_capacity(2);
    for (view, step) in [(first, Step::FirstFeatures), (second, Step::SecondFeatures)] {
        features.push(extract_watched(view.picture, &options.features, &|share| goes_on(step, share))?);
    }
    let features: [Features; 2] = features.try_into().ok()?;
    let cameras = first.camera.zip(second.camera).map(|(a, b)| [*a, *b]);
    let mut matches = match_watched(&features[0], &features[1], &options.matching, &|| goes_on(Step::Matching, Share::NOTHING))?;
    let [keys_a, keys_b] = [&features[0].keypoints, &features[1].keypoints];
    let mut rays = Vec::new();
    let mut pairs = Vec::new();
    matches.retain(|m| {
        let [from, to] = [keys_a[m.first as usize].position, keys_b[m.second as usize].position];
        let Some([a, b]) = &cameras else {
            pairs.push(PointPair { from, to });
            return true;
        };
        // Outside a lens model's valid range, a pixel has no ray.
        let both = a.unproject(Pixel(from)).zip(b.unproject(Pixel(to)));
        if let Some((p, q)) = both {
            pairs.push(PointPair { from: a.undistorted_pixel(p), to: b.undistorted_pixel(q) });
            rays.push(RayPair { first: p.0, second: q.0 });
        }
        both.is_some()
    });
    let rays = cameras.is_some().then_some(rays);
    let sizes = [first.picture.dimensions(), second.picture.dimensions()];
    let searching = || goes_on(Step::Geometry, Share::NOTHING);
    let found = relations::find(&pairs, rays.as_deref().zip(cameras.as_ref()), sizes, options, &searching)?;
    let relations::Found { homography, fundamental, essential, camera_move, model } = found;
    Some(Comparison {
        settings: options.features,
        features,
        matches,
        pairs,
        rays,
        homography,
        fundamental,
        essential,
        camera_move,
        model,
        cameras,
        baseline_m: options.baseline_m,
    })
}

impl Comparison {
    /// Returns the two raw positions of a match, pixels, distortion included.
    fn raw_places(&self, k: usize) -> [Vector2<f64>; 2] {
        let m = &self.matches[k];
        [self.features[0].keypoints[m.first as usize].position, self.features[1].keypoints[m.second as usize].position]
    }

    /// Converts an undistorted position in the second picture to its raw one.
    fn raw_in_second(&self, p: Vector2<f64>) -> Vector2<f64> {
        self.cameras.as_ref().map_or(p, |[_, b]| b.project(b.from_undistorted_pixel(p)).0)
    }

    /// Returns t in metres, in the second camera's axes, if the baseline is known.
    pub fn translation_m(&self) -> Option<Vector3<f64>> {
        Some(self.camera_move?.direction? * self.baseline_m?)
    }

    /// Returns the relation of the best model.
    pub fn chosen(&self) -> Option<&Relation> {
        match self.model? {
            Model::Homography => self.homography.as_ref(),
            Model::Fundamental => self.fundamental.as_ref(),
            Model::Essential => self.essential.as_ref(),
        }
    }

    /// Splits the matches into inliers of the best model and the others.
    fn split_matches(&self) -> (Vec<usize>, Vec<usize>) {
        let inliers = self.chosen().map_or(&[][..], |relation| &relation.inliers);
        (0..self.matches.len()).partition(|k| inliers.binary_search(k).is_ok())
    }

    /// Returns the matrix for drawing epipolar lines, in pixels: from the essential matrix if there
    /// is one.
    fn essential_or_fundamental(&self) -> Option<(&Relation, Matrix3<f64>)> {
        match (&self.essential, &self.cameras) {
            (Some(essential), Some(cameras)) => Some((essential, relations::in_pixels(&essential.matrix, cameras)?)),
            _ => self.fundamental.as_ref().map(|f| (f, f.matrix)),
        }
    }

    /// Returns each match's distance from the best model, pixels.
    fn errors_px(&self) -> Vec<f64> {
        let Some(chosen) = self.chosen() else { return Vec::new() };
        let matrix = match (self.model, &self.cameras) {
            (Some(Model::Essential), Some(cameras)) => relations::in_pixels(&chosen.matrix, cameras),
            _ => Some(chosen.matrix),
        };
        let Some(matrix) = matrix else { return Vec::new() };
        let is_flat = self.model == Some(Model::Homography);
        self.pairs.iter().map(|pair| relations::error_px(is_flat, &matrix, pair)).collect()
    }

    /// Summarises the result in one sentence.
    pub fn sentence(&self) -> String {
        let Some((model, relation)) = self.model.zip(self.chosen()) else {
            return "No relation found: no evidence that the two pictures show the same thing.".to_owned();
        };
        let how = match model {
            Model::Homography if self.camera_move.is_some_and(|m| m.direction.is_none()) => "The camera turned without moving",
            Model::Homography => "The scene is flat, or the camera only turned",
            Model::Fundamental | Model::Essential => "The scene has depth",
        };
        format!("{how}: {} of {} matches agree, to {:.2} px.", relation.inliers.len(), self.matches.len(), relation.sigma_px)
    }

    /// Returns further remarks, one sentence each.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        if let Some(found) = &self.camera_move {
            let rotation = found.rotation.angle().to_degrees();
            remarks.push(match found.direction {
                Some(t) => format!("The camera turned by {rotation:.2} degrees and moved {}.", direction_words(&t, &found.rotation)),
                None => format!("The camera turned by {rotation:.2} degrees; no translation is visible."),
            });
            if found.is_ambiguous {
                remarks.push(
                    "For a flat scene seen like this, two motions explain the matches equally well; the one that sees the plane \
                              more squarely is reported."
                        .to_owned(),
                );
            }
        } else if self.cameras.is_none() && self.model.is_some() {
            remarks.push("The camera's motion needs its calibration; give --camera.".to_owned());
        }
        let count = self.chosen().map_or(0, |relation| relation.inliers.len());
        remarks.extend(self.model.map(|_| stage_words(count).to_owned()));
        remarks
    }
}

/// Describes the second camera's position relative to the first, in words.
fn direction_words(t: &Vector3<f64>, rotation: &UnitQuaternion<f64>) -> String {
    let centre = -(rotation.inverse() * t);
    let words = [["right", "left"], ["down", "up"], ["forward", "back"]];
    let parts: Vec<String> = (0..3)
        .filter(|k| centre[*k].abs() >= 0.05)
        .map(|k| format!("{:.2} {}", centre[k].abs(), words[k][usize::from(centre[k] < 0.0)]))
        .collect();
    format!("{} (of 1 in all)", parts.join(", "))
}

/// Inlier counts from which a picture suffices for tracking, and for tracking while largely
/// occluded. Derived from acquisition's own minimum: a homography needs at least a dozen, and half
/// of the stage is often occluded. Raised, the remarks are more cautious.
const ENOUGH: [usize; 2] = [30, 120];

/// Rates the picture as a stage picture by its inliers.
fn stage_words(agreeing: usize) -> &'static str {
    match agreeing {
        n if n >= ENOUGH[1] => "As a stage picture it has plenty of detail to track.",
        n if n >= ENOUGH[0] => "As a stage picture it is sufficient; more detail would help when parts are hidden.",
        _ => {
            "As a stage picture it has too little detail to track from this view; take a picture closer to this view, or one with more \
             detail."
        }
    }
}
