//! What two-view vision needs beyond the tracker's geometry, compiled with the feature `two-views`:
//! further solvers, robust estimators, and the choice between relations.
//!
//! These modules use those of `geometry`, which use none of them. docs/solvers.md lists all
//! solvers.

pub mod corrected_rays;
pub mod distances;
pub mod eight_point;
pub mod epipolar;
mod epipolar_scoring;
pub mod false_alarms;
pub mod frame_chain;
pub mod fundamental_refinement;
pub mod gold_standard;
pub mod homography_decomposition;
pub mod judged_motion;
mod line_noise;
pub mod marginal_homography;
mod marginal_noise;
pub mod model_choice;
pub mod motion_in_pixels;
pub mod robust_essential;
pub mod robust_fundamental;
mod sampson_refinement;
pub mod seven_point;
mod shared_errors;

use super::robust::RobustModel;

impl<M> RobustModel<M> {
    /// Replaces the model.
    pub fn map<N>(self, other: impl FnOnce(M) -> N) -> RobustModel<N> {
        RobustModel { model: other(self.model), inliers: self.inliers, score: self.score, sigma: self.sigma }
    }
}
