//! The tuning constants of acquisition, in the order of the files that use them.
//!
//! Up to three lines each: what it is, its unit, and the effect of raising or lowering it.
//! docs/tuning.md says where each was measured.

tuning! {
    /// Tuning of acquisition.
    pub struct AcquireTuning {
        // candidate.rs
        /// Minimum inliers of a homography: twice the four that define it. Raised, small or dim
        /// pictures are not found; lowered, frames without the stage cost more.
        min_homography_inliers: usize = 8,
        /// Minimum places that agree on an affine map: two more than define one. Raised, weak
        /// pictures are not found; lowered, frames without them cost more.
        min_affine_inliers: usize = 5,
        /// Matches above which a pose is well supported and no affine maps are tried. Raised,
        /// well-visible bodies cost more; lowered, a homography through wrong matches may be the
        /// only one tried.
        well_supported_inliers: usize = 20,
        /// Maximum candidates: both planar poses of a homography and of an affine map. Raised,
        /// wrong ones cost more.
        max_candidates: usize = 4,
        /// How far from a match its surface's affine map is sampled to get planar poses, pixels of
        /// the match's level. Raised, perspective distorts the sample; lowered, no effect.
        affine_reach_px: f64 = 10.0,
        /// Position noise of a feature, one sigma, pixels of its level. Raised, wrong matches come
        /// within reach of a pose; lowered, right ones fall out of reach of an inaccurate start.
        feature_noise_px: f64 = 1.0,
        /// Maximum distance of matches that refine a pose, sigmas: from the start, then from the
        /// refined pose. Raised, wrong matches pull it; lowered, right ones of other surfaces are
        /// excluded.
        refinement_gate_sigmas: [f64; 2] = [20.0, 8.0],
        /// Maximum steps of either refinement; alignment continues from the result. Raised,
        /// candidates cost more.
        max_refinement_steps: usize = 5,
        /// Matches that one planar pose must explain for its twin to be tested. Lowered, right ones
        /// are skipped.
        twin_test_matches: usize = 60,
        /// Minimum fraction of these matches that the twin must explain. Raised, right ones are
        /// skipped; lowered, wrong ones cost time.
        min_twin_match_ratio: f64 = 0.5,
        /// Upper bound of a squared residual, sigmas; its root is the inlier limit. Raised, wrong
        /// matches decide between candidates.
        max_squared_match_residual: f64 = 16.0,
        /// Maximum samples of the robust homography. Raised, frames without the stage cost more;
        /// lowered, homographies among many wrong matches are missed.
        max_homography_samples: usize = 1500,

        // expected_candidate.rs
        /// Sigma of a pose found by features, fraction of the distance. Raised, alignment starts at
        /// coarser levels than necessary; lowered, such a pose pulls the aligned one.
        feature_pose_shift_sigma: f64 = 0.003,
        /// The same for its rotation, radians.
        feature_pose_rotation_sigma: f64 = 0.003,
        /// Maximum distance of a body from its predicted place, fraction of the frame's width.
        /// Raised, wrong matches agree by chance; lowered, bodies whose motion changed are found
        /// later.
        max_predicted_distance: f64 = 0.05,
        /// Minimum places that must agree on a shift. Raised, emerging bodies are found a frame
        /// later; lowered, wrong candidates cost time.
        min_agreeing_places: usize = 3,

        // feature_search.rs
        /// Lowe's ratio (2004, section 7.1): a match counts if its distance is less than this
        /// fraction of the second nearest's. Raised, more matches are wrong; lowered, dim stages
        /// keep too few.
        lowe_ratio: f32 = 0.85,
        /// Matches of a body that make a glance sufficient. Raised, more frames need a quick look
        /// as well; lowered, alignment starts further off.
        sufficient_glance_matches: usize = 60,
        /// Maximum width of the levels that a glance or a quick look uses, pixels. Raised, every
        /// frame of a search takes longer; lowered, stages that are seen small need the close look.
        max_quick_width_px: u32 = 800,
        /// Comparisons per slice: features of the frame times features of the missing bodies'
        /// views. Raised, frames in which a body is missing take longer; lowered, props are found
        /// less often.
        comparisons_per_slice: usize = 3_000_000,
        /// Minimum features per slice. Raised, slices take longer; lowered, small and dim props are
        /// not found.
        min_slice_features: usize = 150,
        /// Maximum features per slice. Raised, slices take longer; lowered, small and dim props are
        /// not found.
        max_slice_features: usize = 400,
        /// Maximum missing surfaces that one slice is compared with; the others take turns. Raised,
        /// slices have too few features; lowered, each surface waits longer.
        max_slice_surfaces: usize = 5,

        // matched_focal.rs
        /// Minimum matches for an estimate. Raised, wrong lenses pass where a stage has little
        /// detail.
        min_focal_matches: usize = 24,
        /// Maximum matches used, evenly spaced. Raised, the frame that finds the stage takes
        /// longer.
        max_focal_matches: usize = 120,
        /// Minimum excess of the mean truncated square over that of free homographies, sigmas.
        /// Raised, small errors of the focal length pass; lowered, frames that fit are tested as
        /// well.
        min_focal_misfit: f64 = 0.1,
        /// Step between the focal lengths that are tried (logarithm). Raised, modes that crop more
        /// are found, less exactly.
        log_focal_step: f64 = 0.09,
        /// Number of steps each way; a best fit at either end is rejected. Raised, modes that crop
        /// more are found, in more time.
        focal_steps_each_way: i32 = 8,
        /// Minimum drop of the cost, in mean squared residuals of the better fit: five sigmas.
        /// Raised, wrong lenses pass; lowered, noise widens the covariance.
        min_focal_cost_drop: f64 = 25.0,
        /// Minimum drop of the cost, as a fraction of its excess over free homographies. Raised,
        /// wrong lenses pass where other parts do not fit either; lowered, other faults pass for a
        /// wrong lens.
        min_focal_cost_drop_ratio: f64 = 0.5,
        /// Upper bound of a squared residual, sigmas; as in `candidate`. Raised, wrong matches
        /// decide.
        max_squared_focal_residual: f64 = 16.0,
        /// Maximum steps of a resection. Raised, focal lengths far off are judged better, in more
        /// time.
        max_resection_steps: usize = 10,
        /// How far pictures may be distorted or stretched unless more is configured, one sigma.
        /// Raised, wrong lenses pass; lowered, careless measurements are taken for a wrong lens.
        surface_skew_sigma: f64 = 0.005,
        /// How far the camera may move while the rows are read, one sigma: metres and radians.
        /// Raised, wrong lenses of moving cameras are found later.
        readout_motion_sigma: [f64; 2] = [0.02, 0.02],

        // search_windows.rs
        /// Maximum area of a slice with more than one window, pixels. Raised, frames in which a
        /// body is missing take longer; lowered, searching everywhere takes more frames.
        max_slice_px: u64 = 280_000,
        /// Maximum side of a window at a predicted place, pixels. Raised, a body that is elsewhere
        /// is found late; lowered, one that changes its speed leaves its window.
        max_predicted_window_px: u32 = 340,
        /// Minimum mean wait (looks) of a window that shares the slice with a predicted place.
        /// Raised, a body elsewhere is found later; lowered, a partly occluded one gets too few
        /// features.
        min_joining_wait: f32 = 6.0,

        // unexplained.rs
        /// Minimum correlation of an explained cell with its prediction. Raised, moving shadows and
        /// folds are searched as well, which costs time; lowered, a prop that resembles its
        /// background is not.
        min_explained_correlation: f32 = 0.9,
        /// Minimum standard deviation of a cell that is worth searching, grey levels. Raised, faint
        /// pictures are not found; lowered, plain walls are searched.
        min_searched_contrast: f32 = 3.0,
        /// Weight of features in a window at a predicted place, relative to another window of the
        /// same size. Raised, what is new elsewhere is found later; lowered, a briefly occluded
        /// body is.
        predicted_window_weight: f64 = 2.0,

        // unexplained_cells.rs
        /// Minimum cells of a region that is searched. Raised, props that come into view are found
        /// later; lowered, specks are searched.
        min_region_cells: usize = 6,
        /// Maximum regions searched in a frame, largest first. Raised, a frame full of specks costs
        /// more.
        max_regions: usize = 24,
        /// Margin around a region that is searched too, pixels of the frame. Raised, searches cost
        /// more; lowered, corners near a region's border are found at full size only.
        region_margin_px: u32 = 64,
        /// Initial wait of a cell that becomes unexplained, looks. Raised, a body that emerges from
        /// behind a person waits longer; lowered, one that comes into view waits until the people
        /// were searched.
        initial_wait: u8 = 6,

        // view_bank.rs
        /// Frontal features of all surfaces together. Raised, matching costs more in proportion;
        /// lowered, less is recognised of a stage that is seen in part or small.
        max_reference_features: usize = 4000,
        /// Minimum frontal features per surface. Raised, matching costs more; lowered, small
        /// surfaces are not recognised.
        min_surface_features: usize = 700,
        /// Features of all tilted views together. Raised, a close look takes longer; lowered, steep
        /// views of a partly occluded stage are not recognised.
        max_tilted_features: usize = 8000,
        /// Minimum features per tilted view. Raised, a close look takes longer; lowered, steep
        /// views are not recognised.
        min_tilted_view_features: usize = 60,
        /// Maximum side of the artwork's copy from which frontal features are taken, pixels.
        /// Raised, features go to detail that no frame shows; lowered, close views find fewer.
        max_reference_px: u32 = 2000,
        /// The same for tilted views, which no frame shows as large. Raised, the start takes
        /// longer, by the square.
        max_tilted_px: u32 = 1300,
        /// Pyramid levels of a reference picture, 1.2 apart: a factor of 15 in scale. Lowered,
        /// stages that are seen small are not recognised.
        reference_levels: usize = 16,
    }
}
