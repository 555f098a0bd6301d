//! Two-view vision as a library (feature `two-views`): features, matching, two-view solvers, and
//! with the feature `compare` all of it in one call, `compare`, which `stagepose compare` runs.
//!
//! Data flows one way. A grey picture becomes [`features::Features`]; two of them become matches.
//! The matched positions, as [`geometry::PointPair`] in pixels or [`geometry::RayPair`] of
//! calibrated cameras, become a homography, a fundamental or an essential matrix, and these become
//! the camera's motion. Each step can be used alone. The randomised steps take a seed and are
//! reproducible.

/// Two-view relations: one solver per function, each with its source. docs/solvers.md compares
/// them.
///
/// H maps points of the first picture to the second, `x2 ∝ H x1`. F and E constrain them,
/// `x2ᵀ F x1 = 0`. A motion is `x2 ∝ R x1 + t`.
pub mod geometry {
    pub use crate::geometry::correspondence::Correspondence;
    pub use crate::geometry::distances::squared_sampson;
    pub use crate::geometry::five_point::five_point;
    pub use crate::geometry::ransac::Order;
    pub use crate::geometry::relative_pose::{RayPair, TwoViewMotion};
    pub use crate::geometry::robust::{RobustModel, RobustOptions};
    pub use crate::geometry::robust_homography::robust_homography;
    pub use crate::geometry::triangulation::depths;
    pub use crate::geometry::two_views::corrected_rays::corrected;
    pub use crate::geometry::two_views::distances::{
        squared_epipolar, squared_sampson_of_homography, squared_symmetric_epipolar, squared_symmetric_transfer,
    };
    pub use crate::geometry::two_views::eight_point::eight_point;
    pub use crate::geometry::two_views::epipolar::{epipolar_line, epipoles};
    pub use crate::geometry::two_views::false_alarms::{chance_at_a_line, chance_at_a_point, ln_false_alarms};
    pub use crate::geometry::two_views::frame_chain::{FirstView, SecondView, first_from_second, object_in_camera, rotation_xyz};
    pub use crate::geometry::two_views::fundamental_refinement::refine_fundamental;
    pub use crate::geometry::two_views::gold_standard::{GoldStandard, gold_standard};
    pub use crate::geometry::two_views::homography_decomposition::{PlanarMotion, decompose_homography};
    pub use crate::geometry::two_views::judged_motion::{JudgedMotion, judged_motion};
    pub use crate::geometry::two_views::marginal_homography::homography_of_unknown_noise;
    pub use crate::geometry::two_views::model_choice::{EpipolarKind, ModelChoice, TwoViewModel, choose_model};
    pub use crate::geometry::two_views::motion_in_pixels::refine_motion_in_pixels;
    pub use crate::geometry::two_views::robust_essential::robust_essential;
    pub use crate::geometry::two_views::robust_fundamental::robust_fundamental;
    pub use crate::geometry::two_views::seven_point::seven_point;
    pub use crate::geometry::{Homography, PointPair};
}

/// Detectors and descriptors; any can be combined with any other.
///
/// [`extract`](features::extract) selects them by name. The detectors' and describers' own types
/// expose all their options.
pub mod features {
    pub use crate::features::Descriptor;
    pub use crate::features::two_views::descriptors::{
        Basis, BinaryComparisons, Describer, GlohDescriber, PatchDescriber, SiftDescriber, StructureTensorDescriber, SurfDescriber,
    };
    pub use crate::features::two_views::detectors::{
        AffineDetector, AffineMeasure, CornerMeasure, Detector, HarrisDetector, LiveCorners, MserDetector, SiftDetector, SurfDetector,
    };
    pub use crate::features::two_views::repeatability::{Repeatability, repeatability};
    pub use crate::features::two_views::{
        DescriptorKind, Descriptors, DetectorKind, FeatureSettings, Features, Keypoint, PictureForms, Share, ViewSimulation, detect,
        extract, extract_watched,
    };
}

/// Matching features of the first picture with those of the second.
pub mod matching {
    pub use crate::matching::exact::{ExactMatch, ExactOptions, match_exactly, match_watched};
}

#[cfg(feature = "compare")]
pub use crate::compare::{CameraMove, CompareOptions, Comparison, Model, Relation, Step, View, compare};
