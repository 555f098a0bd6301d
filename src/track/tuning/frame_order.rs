//! The tuning constants of the order of a frame, in the order of the files that use them.
//!
//! Up to three lines each: what it is, its unit, and the effect of raising or lowering it.
//! docs/tuning.md says where each was measured.

tuning! {
    /// Tuning of the order of a frame.
    pub struct FrameOrderTuning {
        // body_search.rs
        /// Maximum candidates per body that are aligned in a frame, best first. Raised, frames
        /// without the stage cost more; lowered to 1, only the wrong one of two planar poses may be
        /// tried.
        max_candidates_per_body: usize = 3,
        /// Minimum features at the first look for a closer look; fewer mean a black or blank frame.
        /// Raised, dim stages are not searched for; lowered, black frames cost more.
        min_glance_features: usize = 16,
        /// Maximum attempts per frame once the stage is known: follows in vain, candidates, patch
        /// checks. Raised, frames take longer; lowered, only the wrong one of two planar poses may
        /// be tried.
        max_attempts_when_known: usize = 2,
        /// Candidates of a second copy of a body that are checked: both planar poses. Raised,
        /// frames that find a body take longer; lowered to 1, only the wrong one may be tried.
        max_copy_candidates: usize = 2,

        // failure.rs
        /// Minimum matches on one homography for the picture to count as recognised. Raised, a
        /// picture that is barely seen counts as not recognised. Only the reported reason depends
        /// on it.
        min_recognised_matches: usize = 12,
        /// Minimum side of the picture (root of its area), as a fraction of the frame's width.
        /// Raised, other faults of a small picture are attributed to its size.
        min_recognisable_width_ratio: f64 = 0.09,
        /// The same in pixels.
        min_recognisable_side_px: f64 = 60.0,
        /// Maximum residual of the best pose beyond that of the homographies (see
        /// `Recognition::misfit`) for the geometry to count as right. Raised, wrong sizes are not
        /// reported as the reason.
        max_geometry_misfit: f64 = 0.6,

        // body_tracker/
        /// Maximum sigma of an object's direction by residual tile displacements, radians (one
        /// degree). Raised, false poses of small pictures are reported; lowered, blurred objects
        /// are given up.
        max_misfit_direction_sigma: f64 = std::f64::consts::PI / 180.0,
        /// How long a second copy of the stage's picture counts as still there, seconds. Raised,
        /// the stage returns later once the copy is gone; lowered, a copy that is hard to see is
        /// forgotten.
        copy_memory_s: f64 = 0.5,
        /// Minimum interval between recognitions of a followed stage for the focal length that its
        /// matches imply, seconds. Raised, a doubt lasts longer; lowered, more frames cost a
        /// search.
        focal_match_interval_s: f64 = 1.0,

        // tile_observer.rs
        /// Sigma of a frame's motion after the model changed, fraction of the distance. Raised,
        /// frames start at coarser levels than necessary; lowered, a large change loses frames.
        start_shift_sigma: f64 = 0.02,
        /// The same for the rotation, radians.
        start_rotation_sigma: f64 = 0.01,
        /// Maximum anchors searched for in a frame. Raised, it costs time.
        max_anchors: usize = 400,
        /// Minimum anchors found in a frame. Raised, frames that show little of the stage are
        /// dropped.
        min_anchors: usize = 16,

        // two_view.rs
        /// Minimum correspondences of a reported homography: three times the four that define one.
        /// Raised, small stages have none; lowered, its eight numbers are mostly noise.
        min_homography_matches: usize = 12,
        /// Minimum baseline of an essential matrix, as a fraction of the distance. Raised, fewer
        /// frames have one; lowered, its direction is noise near the reference camera.
        min_baseline: f64 = 0.01,
        /// Minimum fraction of correspondences that fit the motion refined from the metric pose to
        /// accept it. Raised, more frames pay for five-point samples; lowered, a worse motion may
        /// be kept.
        min_refined_inlier_ratio: f64 = 0.8,
        /// Five-point samples. Raised, frames that need them cost more.
        five_point_samples: usize = 12,
        /// Five-point models kept for refinement. Raised, frames that need them cost more.
        kept_models: usize = 6,
    }
}
