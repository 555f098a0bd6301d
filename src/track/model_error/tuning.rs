//! The tuning constants of model errors, in the order of the files that use them.
//!
//! Up to three lines each: what it is, its unit, and the effect of raising or lowering it.
//! docs/tuning.md says where each was measured.

tuning! {
    /// Tuning of model errors.
    pub struct ModelErrorTuning {
        // field_error.rs
        /// Correlation length of the field, as a fraction of the width of the picture or object.
        /// Lowered, covariances miss what the pose absorbed; raised, noise adds more to them.
        field_correlation_length: f64 = 0.4,
        /// Maximum variance of independent tile errors that counts as noise, in variances of pixel
        /// noise. Raised, folds as narrow as tiles pass for noise; lowered, noise passes for a
        /// field.
        max_independent_variance: f64 = 4.0,
        /// Factor on the variance of the field that explains residuals beyond
        /// `max_independent_variance`, whose correlation length is unknown. Raised, poses of stages
        /// that do not fit are withheld needlessly.
        unknown_length_variance_factor: f64 = 2.0,
        /// Minimum number of measurements beyond the pose's six from which the field is estimated.
        /// Raised, small stages claim to fit.
        min_field_freedom: f64 = 12.0,
        /// Exponent of the pair weights: a pair's weight is its correlation to this power (length
        /// 0.08 of the width). Lowered, short folds pass for noise; raised, there are too few
        /// pairs.
        pair_weight_power: i32 = 25,
        /// Minimum distance of a pair, as a fraction of the width: touching tiles share
        /// compression, sharpening and light. Raised, there are too few pairs; at 0, noise passes
        /// for a field.
        min_pair_distance: f64 = 0.055,
        /// Minimum weight of a pair. Lowered, frames that do not fit cost more.
        min_pair_weight: f64 = 0.05,
        /// Frames over which the field's variance is averaged. Raised, a small change of the stage
        /// enters the covariance later.
        field_memory_frames: f64 = 60.0,
        /// Standard errors subtracted from that mean, because only its positive chance values would
        /// widen the covariance. Raised, small model errors are in no covariance.
        field_standard_errors: f64 = 1.0,

        // focal_clue.rs
        /// Prior sigma of the radial coefficient in the focal clue. Raised, fewer views reveal a
        /// zoom; lowered, bad measurements pass for one.
        clue_radial_sigma: f64 = 0.05,
        /// The same for a surface's side ratio.
        clue_ratio_sigma: f64 = 0.01,
        /// Prior sigma of shear and keystone if the corners are not in doubt. Raised, small zooms
        /// head-on are not withheld; lowered, skewed pictures convict a correct lens.
        clue_skew_sigma: f64 = 0.003,
        /// Prior sigma of a surface's position in the focal clue, metres. Raised, fewer views
        /// reveal a zoom; lowered, bad measurements pass for one.
        clue_place_sigma_m: f64 = 0.01,
        /// The same for its direction, radians.
        clue_direction_sigma: f64 = 0.01,
        /// The same for the motion during readout, m/s and rad/s.
        clue_motion_sigma: [f64; 2] = [1.0, 1.0],
        /// Readout time assumed if none is configured, seconds. Raised, fast pans pass less for a
        /// zoom.
        assumed_readout_s: f64 = 0.02,
        /// Relative sigma up to which a readout time counts as described. Raised, rows displaced by
        /// the readout pass for a lens error; lowered, a learnt readout time is of less use.
        max_described_readout_sigma: f64 = 0.1,
        /// Minimum sigma of the motion during readout, m/s and rad/s; keeps the equations regular
        /// at rest. Raised, it acts like a raised `clue_motion_sigma`.
        min_clue_motion_sigma: f64 = 1e-4,
        /// Minimum relative change of the focal length that counts. Raised, poses with larger
        /// errors pass; lowered, lenses that breathe with focus are refused.
        min_focal_change: f64 = 0.005,
        /// Minimum change of the focal length, in sigmas of the frame's estimate. Raised, a zoom is
        /// noticed later; lowered, patterns of other causes pass for one.
        min_focal_change_sigmas: f64 = 8.0,
        /// The same in sigmas of the calibration's uncertainty.
        min_focal_change_calibration_sigmas: f64 = 4.0,
        /// And minimum fraction of the residual (after all other unknowns) that it must explain.
        /// Raised, a zoom of a stage that does not fit goes unnoticed; lowered, other patterns pass
        /// for a zoom.
        min_focal_explained_ratio: f64 = 0.5,
        /// Residual after motion over residual after the focal length, below which motion is the
        /// explanation. Raised, zooms pass for motion; lowered, shaken rolling-shutter cameras are
        /// refused.
        max_motion_rival_ratio: f64 = 0.93,
        /// Deviation from earlier frames, in sigmas, that enters the covariance as a possible zoom.
        /// Raised, zooms get too small a covariance; lowered, a draught makes poses less certain.
        deviation_sigmas: f64 = 3.0,
        /// The same, beyond which the deviation is clear. Raised, a zoom of a stage that does not
        /// fit is noticed later; lowered, a draught passes for one.
        clear_deviation_sigmas: f64 = 4.0,
        /// Maximum sigma of the log focal length at which a frame can show a change. Raised,
        /// coloured light passes for a zoom; lowered, fewer views reveal a zoom of a stage that
        /// does not fit.
        max_changed_focal_sigma: f64 = 0.02,
        /// Maximum sigma of the log focal length at which a frame can show that it is the usual one
        /// again. Raised, views from ahead bring poses back.
        max_restored_focal_sigma: f64 = 0.01,
        /// Sigmas within which a focal length is the usual one, and margin in sigmas by which a
        /// frame must show the calibrated one. Raised, poses are withheld for longer after a zoom.
        restored_focal_sigmas: f64 = 3.0,
        /// Squared sigmas by which the focal length must beat a skewed picture. Raised, small zooms
        /// head-on are not withheld; lowered, skewed pictures convict a correct lens.
        min_focal_over_skew_gain: f64 = 4.0,
        /// Maximum change of the log focal length that a linear step can report; larger ones only
        /// widen the covariance. Raised, wrong corners pass for a zoom; lowered, large zooms are
        /// not withheld.
        max_focal_change: f64 = 0.26,
        /// Prior sigma of unknowns that are held fixed; keeps the equations regular. Raised, they
        /// are less fixed.
        fixed_sigma: f64 = 1e-6,

        // focal_step.rs
        /// Minimum step of the log focal length. Raised, small zooms head-on go unnoticed; lowered,
        /// jolts put the lens in doubt.
        min_focal_step: f64 = 0.01,
        /// Minimum jump, in usual prediction errors. Raised, small zooms head-on go unnoticed;
        /// lowered, jolts put the lens in doubt.
        min_focal_jump_ratio: f64 = 5.0,
        /// Minimum fraction of the jump that the step must explain; a jolt rotates the camera too.
        /// Raised, zooms while the camera rotates go unnoticed; lowered, jolts put the lens in
        /// doubt.
        min_focal_step_explained_ratio: f64 = 0.9,
        /// Weight that the usual prediction error keeps per frame. Raised, a camera that has come
        /// to rest counts as shaken for longer.
        prediction_error_memory: f64 = 0.9,

        // lens_watch.rs
        /// Consecutive contradicting frames before the lens counts as changed. Raised, a zoom is
        /// reported later; frames until then are withheld anyway.
        frames_to_changed_lens: u32 = 2,
        /// Consecutive frames with the calibrated focal length before the lens counts as restored.
        /// Raised, poses are reported later.
        frames_to_restored_lens: u32 = 3,
        /// Weight that the usual estimate keeps per frame. Raised, a path around folds passes for a
        /// zoom; lowered, a slow zoom passes for the usual estimate.
        focal_mean_memory: f64 = 0.93,
        /// Weight of a deviating frame in the usual estimate. Raised, a slow zoom passes for the
        /// usual estimate; lowered, a path around a stage that does not fit passes for a zoom for
        /// longer.
        deviating_frame_weight: f64 = 0.1,
        /// Sigmas of a single frame at which the usual estimate contradicts the calibration.
        /// Raised, a guessed lens passes for a changed one; lowered, a zoom before cloth is noticed
        /// later.
        uncalibrated_sigmas: f64 = 5.0,
        /// Minimum number of frames before there is a usual estimate. Raised, a zoom soon after the
        /// start is noticed later; lowered, a single frame makes one.
        min_focal_mean_frames: u32 = 5,
        /// Sigma of the log focal length of a frame with nothing but noise, which counts as
        /// calibrated. Raised, the first frames of a misfit weigh more; lowered, a stage that
        /// fitted must stay so.
        fitting_frame_focal_sigma: f64 = 0.01,
        /// Minimum sigma of a frame, so that none outweighs all others. Raised, frames count more
        /// equally.
        min_frame_focal_sigma: f64 = 1e-4,

        // misfit.rs
        /// Error of the focal length, percent, above which whole pictures must decide. Raised, the
        /// linear answer is used where it is a few percent of itself off.
        small_focal_error_percent: f64 = 5.0,
        /// The same for the side ratio.
        small_ratio_error_percent: f64 = 2.5,

        // model_study.rs
        /// Tukey scale of the weights, in robust sigmas of the tile's own surface, so that a moved
        /// one is no outlier. Raised, people and shadows count; lowered, the ends of a pattern do
        /// not.
        study_tukey_sigmas: f64 = 2.0,
        /// Frames up to which the effective number of tiles grows, with their square root. Raised,
        /// finer folds are accepted from a camera at rest; lowered, folds that a walk shows are
        /// not.
        max_differing_frames: f64 = 16.0,
        /// Minimum fall of the criterion for a part to be named. Raised, fewer are named; lowered,
        /// look-alikes of the true one are.
        min_part_gain: f64 = 30.0,
        /// Minimum fall of the residual (as a fraction, first and later parts) for a part to be
        /// named. Raised, fewer are named; lowered, look-alikes of the true one are.
        min_part_gain_ratio: [f64; 2] = [0.4, 0.1],
        /// Each later part must reduce the residual to this fraction. Raised, parts are named that
        /// only resemble the remainder of the first one.
        max_later_residual_ratio: f64 = 0.5,
        /// The first surface, which defines the stage's frame, is named as moved only if that
        /// leaves less than this fraction of the best alternative. Raised, it is blamed more often.
        max_first_surface_residual_ratio: f64 = 0.8,
        /// Maximum number of named parts. Raised, users get more faults than they can fix one by
        /// one.
        max_parts: usize = 3,
        /// Minimum pose error (or displacement of a surface) of a named part, as a fraction of the
        /// distance. Raised, faults go unnamed; lowered, accurate stages are sent to a survey.
        min_part_pose_error: f64 = 0.0005,
        /// Points along each side at which a shape's heights are sampled. Raised, reports cost more
        /// time.
        shape_points_per_side: u32 = 24,

        // model_unknowns.rs
        /// Minimum number of half waves of the heights (across plus up). Raised, coarse folds cost
        /// more time.
        min_shape_waves: usize = 3,
        /// Maximum number of heights of all surfaces together. Raised, finer folds are told from
        /// other causes, in more time.
        max_shape_heights: usize = 240,
        /// Prior sigma of the log focal length in the study. Lowered, large faults are missed.
        study_focal_sigma: f64 = 0.2,
        /// The same for the principal point, pixels.
        study_centre_sigma_px: f64 = 60.0,
        /// The same for the radial coefficient.
        study_radial_sigma: f64 = 0.5,
        /// The same for the logarithm of a surface's side ratio.
        study_ratio_sigma: f64 = 0.1,
        /// The same for a surface's shear and keystones.
        study_skew_sigma: f64 = 0.05,
        /// The same for a surface's position, metres.
        study_place_sigma_m: f64 = 0.3,
        /// The same for a surface's direction, radians.
        study_direction_sigma: f64 = 0.2,
        /// The same for a surface's height, metres per half wave.
        study_height_sigma_m: f64 = 0.1,

        // model_watch.rs
        /// One frame in this many is studied; those between show much the same. Raised, a fault is
        /// reported later; lowered, frames cost more.
        study_interval_frames: u32 = 8,
        /// Number of studied frames before the parts are compared. Raised, a fault is reported
        /// later; lowered, from views that differ less.
        frames_per_comparison: u32 = 8,
        /// Weight that these frames keep after the comparison. Raised, a changed stage is noticed
        /// later.
        studied_frame_weight_kept: f64 = 0.6,
        /// Consecutive comparisons that must find a part before it is reported. Raised, a fault is
        /// reported later.
        comparisons_to_report: u32 = 3,
        /// Fraction of the squared displacements at which a part is reported at once. Raised, a
        /// moved flat is reported later; lowered, a part that only resembles the true one is.
        decisive_ratio: f64 = 0.9,
        /// One frame of a map in this many is studied: moved pieces are left out of poses. Raised,
        /// they pull at poses longer; lowered, frames cost more.
        map_study_interval_frames: u32 = 3,
        /// Number of studied frames of a map before its pieces are compared. Raised, moved pieces
        /// pull at poses longer; lowered, a piece that somebody passes may be left out.
        map_frames_per_comparison: u32 = 5,
        /// Fraction of the squared displacements at which a piece of a map is left out at once.
        /// Raised, moved pieces pull at poses longer; lowered, an unmoved one may be left out.
        map_decisive_ratio: f64 = 0.7,
        /// Maximum number of named pieces of a map: a crate has five.
        max_pieces: usize = 12,
        /// Minimum fraction of the residual that a moved piece of a map explains.
        min_piece_gain_ratio: f64 = 0.1,
        /// Maximum half waves of the shapes that are tried during tracking. Raised, finer folds are
        /// told from other parts, in more time.
        max_tracking_waves: usize = 8,
        /// Minimum distance between views, as a fraction of the distance. Raised, only long walks
        /// count as evidence that no part explains the misfit.
        min_view_distance: f64 = 0.09,
        /// Maximum number of such views. Raised, later views count as well.
        max_views: usize = 16,

        // smooth_field.rs
        /// Maximum error of a correlation from the omitted powers; only differences of correlations
        /// show in the residuals. Lowered, frames cost more.
        max_correlation_error: f64 = 1e-10,
        /// Minimum number of powers, for nearby tiles too. Lowered, small stages seem to fit.
        min_correlation_powers: usize = 8,

        // tile_residuals.rs
        /// Minimum sum of tile weights. Raised, small stages are not checked; lowered, single tiles
        /// pass for a pattern.
        min_tile_weight_sum: f64 = 12.0,
        /// Reweighted solutions, the first with equal weights. Raised, frames cost more; at 1,
        /// outliers count fully.
        reweighting_rounds: usize = 3,
        /// Minimum mean square residual, in variances of noise, that counts as a model misfit.
        /// Raised, small faults go unreported; lowered, time is spent on studying noise.
        min_model_misfit: f64 = 3.0,
        /// Cap on a tile's squared residual, in variances of noise. Raised, a single tile passes
        /// for a misfit; lowered, a small flat that was moved does not.
        max_squared_tile_residual: f64 = 400.0,
        /// Minimum residual scale, in sigmas of noise, so that exact data get weights too. At 0,
        /// they get none.
        min_residual_scale: f64 = 1e-6,
        /// Relative increase of the focal length's information that keeps the equations regular:
        /// head-on, focal length and distance cannot be told apart. Raised, the focal length counts
        /// as known.
        focal_ridge: f64 = 1e-9,

        // moments/evidence.rs
        /// Minimum standard deviation of a tested cell, grey levels. Raised, faint pictures are not
        /// tested; lowered, noise is.
        min_cell_contrast: f32 = 4.0,
        /// Maximum fraction of a cell's variance that the regression leaves. Raised, people in
        /// front of the stage count; lowered, noisy cells do not.
        max_cell_residual_ratio: f64 = 0.3,

        // moments/mod.rs
        /// Cells drawn per frame. Raised, a tested frame costs more; lowered, an occluder of some
        /// cells decides.
        cells_per_frame: usize = 40,
        /// Places in the pictures where tears are searched for, whatever is visible there. Raised,
        /// a tested frame costs more; lowered, tears have too few cells.
        tear_places: usize = 144,
        /// Minimum cells by which a frame is judged. Raised, small stages are not tested; lowered,
        /// a few cells decide.
        min_moment_cells: usize = 8,
        /// Minimum displacement of the picture per frame for a test, pixels (rms). Raised, slow
        /// mixtures are noticed later; lowered, the point spread passes for a second moment.
        min_test_motion_px: f64 = 1.2,
        /// Maximum displacement per frame, pixels of the copy of the frame; beyond it a smaller
        /// copy is used. Raised, a cell's moments share less of its width; lowered, fields are seen
        /// less often.
        max_test_motion_px: f64 = 6.0,
        /// Maximum relative change of the motion from frame to frame for evidence of a second
        /// moment. Raised, jerks of a hand pass for a second moment; lowered, only smooth motion
        /// counts.
        max_motion_change: f64 = 0.3,
        /// Share of a second moment above which a frame is blended (long exposure: a third;
        /// mixture: 1). Raised, mixtures pass; lowered, long exposures are refused.
        min_blended_share: f64 = 0.7,
        /// Share above which rows are woven: 1 for fields a frame interval apart, a half for half
        /// of it. Raised, fields pass; lowered, stripes may pass for fields.
        min_woven_share: f64 = 0.3,
        /// Fraction of the evidence kept at each tested frame. Raised, a repaired source is trusted
        /// later; lowered, single frames decide.
        moment_evidence_kept: f64 = 0.8,
        /// Tested frames with the same result before it is announced. Raised, it is announced
        /// later; lowered, a chance result may be announced.
        frames_to_announce: u32 = 5,
        /// Moving frames that are all tested at first. Raised, frames cost more; lowered, mixtures
        /// are noticed later.
        first_tested_frames: u32 = 12,
        /// Interval of tests after those, frames. Raised, mixtures that begin later are noticed
        /// later; lowered, frames cost more.
        test_interval_frames: u32 = 6,
        /// Displacement per frame, pixels (rms), from which a mixture's pose is withheld; the
        /// covariance covers slower ones. Raised, poses far less certain than usual are reported.
        min_withheld_motion_px: f64 = 1.0,

        // moments/tear.rs
        /// Number of lines tried. Raised, a tested frame costs more; lowered, tears between the
        /// lines are missed.
        tear_lines: usize = 12,
        /// Minimum step, in displacements per frame interval. Raised, tears near the border are
        /// missed; lowered, a jerk under a rolling shutter passes for one.
        min_tear_step: f64 = 0.4,
        /// Maximum fraction of a smooth fit's residual that a step may leave. Raised, noise passes
        /// for a tear; lowered, noisy tears are missed.
        max_tear_residual_ratio: f64 = 0.4,
        /// Minimum cells on either side of a line. Raised, tears near the border are missed;
        /// lowered, a few cells decide.
        min_cells_beside_tear: usize = 6,
    }
}
