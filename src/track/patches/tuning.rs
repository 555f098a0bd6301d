//! The tuning constants of anchors, in the order of the files that use them.
//!
//! Up to three lines each: what it is, its unit, and the effect of raising or lowering it.
//! docs/tuning.md says where each was measured.

tuning! {
    /// Tuning of anchors.
    pub struct PatchesTuning {
        // planar_ambiguity.rs
        /// Minimum excess chi-squared of a reported pose's twin; a tracked pose is dropped if its
        /// twin is better by this. Raised, small or head-on views are refused; lowered, wrong twins
        /// pass.
        min_twin_margin: f64 = 25.0,
        /// Angle below which two poses count as one, radians. Raised, twins of a nearly frontal
        /// view are not told apart; lowered, the same minimum counts as a rival.
        same_pose_angle: f64 = 0.0087,
        /// Cap on the squared residual of an observation, squared scales. Raised, outliers that are
        /// no part of the surface decide.
        max_squared_observation_residual: f64 = 22.0,
        /// Maximum iterations of the twin's refinement. Lowered, a twin that has not converged
        /// looks worse than it is.
        max_twin_iterations: usize = 15,

        // registration.rs
        /// Minimum cosine of a surface's tilt at which it is registered (88.9 degrees). Raised,
        /// starts at a steep view are refused; lowered, artwork by pixels becomes singular.
        min_registration_cosine: f64 = 0.02,
        /// Minimum standard deviation of a drawn patch, grey levels. Raised, faint artwork has too
        /// few anchors; lowered, noise decides where plain patches fit.
        min_patch_contrast: f32 = 4.0,
        /// Minimum correlation of a fitting patch. Raised, noisy or blurred frames have too few
        /// anchors; lowered, more patches fit in wrong places.
        min_patch_correlation: f32 = 0.75,
        /// Sigma of a patch's model error, pixels of the searched picture, which more light does
        /// not reduce. Raised, covariances grow and patches count equally; lowered, strong ones are
        /// overrated.
        patch_model_error_px: f64 = 0.04,
        /// Minimum grey noise that is assumed, grey levels. Raised, covariances grow; lowered,
        /// patches that fit well by chance outweigh the others.
        min_grey_noise: f32 = 1.5,

        // verify.rs
        /// Tiles across and down the frame: errors within one count as common, and a pose must rest
        /// on several. Raised, neighbours count as independent and covariances shrink.
        verification_tiles: [u32; 2] = [8, 6],
        /// Maximum number of anchors searched for in the half-size frame. Raised, verification
        /// costs more in proportion; lowered, poses are less certain and small parts of a stage are
        /// missed.
        max_coarse_anchors: usize = 120,
        /// The same in the full frame.
        max_fine_anchors: usize = 300,
        /// Minimum number of anchors from which a pose is computed. Raised, small stages are
        /// rejected before they are judged.
        min_resection_anchors: usize = 8,
        /// Minimum number of anchors at half size for that pose to replace the start. Raised, rough
        /// starts go to full size, out of reach; lowered, a few wrong anchors spoil a good start.
        min_coarse_fitting_anchors: usize = 24,
        /// Minimum number of fitting anchors. Raised, small or occluded stages are refused;
        /// lowered, chance passes more easily.
        min_fitting_anchors: usize = 16,
        /// Minimum number of tiles that they must lie in, of 48. Raised, stages that appear small
        /// are refused; lowered, a patch of repeated detail can carry a wrong pose.
        min_occupied_tiles: usize = 4,
        /// Minimum fraction of the searched anchors that must fit for a new pose. Raised, partly
        /// occluded stages are refused; lowered, wrong poses pass more easily.
        min_new_fitting_ratio: f64 = 0.35,
        /// The same for a continued track.
        min_continued_fitting_ratio: f64 = 0.2,
        /// Maximum number of anchors found away from their prediction, per fitting one. Raised,
        /// torn frames and wrong poses pass; lowered, repeated detail refuses right ones.
        max_contradiction: f64 = 0.5,
        /// Maximum residual of a fitting anchor, pixels of a frame 1280 pixels wide. Raised, poses
        /// beside the right one pass; lowered, guessed lenses are never verified.
        max_residual_px: f64 = 1.5,
        /// Maximum sigma of a reported pose's direction, radians. Raised, poses that say little are
        /// reported; lowered, distant or small stages are refused.
        max_direction_sigma: f64 = 0.5 * std::f64::consts::PI / 180.0,
        /// The same for its position, fraction of the distance.
        max_position_sigma: f64 = 0.012,
        /// Fraction of the usual alignment rate below which a surface is silent. Raised, surfaces
        /// with little detail are searched in vain; lowered, slightly moved flats are missed.
        silent_surface_ratio: f64 = 0.6,
        /// Minimum number of anchors in view of a surface that is searched for. Raised, small flats
        /// are never searched for; lowered, specks are.
        min_silent_anchors: usize = 10,
    }
}
