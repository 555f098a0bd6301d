//! The tuning constants of alignment, in the order of the files that use them.
//!
//! Up to three lines each: what it is, its unit, and the effect of raising or lowering it.
//! docs/tuning.md says where each was measured.

tuning! {
    /// Tuning of alignment.
    pub struct AlignTuning {
        // kernel/noise_sums.rs
        /// Maximum squared residual that counts as noise, in squared robust sigmas. Raised, pixels
        /// that show something else count as noise; lowered, `TRUNCATED_VARIANCE` falls too.
        max_squared_noise_residual: f32 = 9.0,

        // kernel/normal.rs
        /// Cauchy's weight in a first pass is one half at this many sigmas, and never 0. Raised,
        /// outliers bias the first step more; lowered, fewer pixels correct a start that is off.
        first_pass_half_weight_sigmas: f32 = 2.7,

        // hypotheses/blurred.rs
        /// Pixels whose blur is estimated. Raised, the frame that finds a body takes longer;
        /// lowered, the velocity is less certain.
        blur_pixels: usize = 1500,
        /// Minimum ratio of tiles that take part in a pose whose blur is estimated; half always do.
        /// Raised, strongly blurred bodies are not tried; lowered, wrong poses cost more.
        min_blur_inlier_ratio: f64 = 0.55,
        /// Minimum residuals (sigmas) of an occluded body's fitting tiles for blur to be estimated.
        /// Raised, fast bodies are found later as they reappear; lowered, bodies at rest cost more.
        min_occluded_blur_sigma: f64 = 1.4,

        // hypotheses/enlargement.rs
        /// The other enlargement is adopted if it leaves less than this fraction of the misfit.
        /// Raised to 1, it changes by chance; lowered, a wrong one is kept where pictures have
        /// little fine detail.
        max_enlargement_misfit_ratio: f64 = 0.97,
        /// Pixels in a trial of either enlargement. Raised, the frame of a trial takes longer;
        /// lowered, the choice changes by chance.
        enlargement_trial_pixels: usize = 3000,

        // hypotheses/jump_within_frame.rs
        /// Prior probability that a camera that left its line was shaken (jerk), rather than
        /// started or stopped. Raised, starts and stops are more often explained by jerk, whose
        /// prior is wider.
        jerk_probability: f64 = 0.01,

        // hypotheses/unchanged.rs
        /// Pixels used while nothing moves; their prediction is kept from frame to frame. Raised,
        /// only frames of larger cameras cost more; lowered, poses scatter more.
        still_pixels: usize = 130_000,
        /// A prediction is kept while nothing moved by more, pixels of the level (the solution:
        /// twice that). Raised, outdated slopes are used; lowered, pixels are selected anew and
        /// poses scatter.
        max_still_motion_px: f64 = 0.05,
        /// Still frames in a row before all steep pixels are selected, which takes as long as
        /// several frames. Raised, still cameras scatter for longer; at 1, every pause costs that
        /// time.
        still_frames: u32 = 3,
        /// Still frames in a row after which the prediction is renewed, once. Raised, the first
        /// prediction's error stays longer; lowered, the filter does not know the pose well enough
        /// yet.
        prediction_renewal_frames: u32 = 12,

        // hypotheses/velocity_by_blur.rs
        /// Maximum steps. Raised, what does not converge costs more; lowered, long blur is not
        /// reached.
        max_blur_steps: usize = 5,
        /// Change of blur below which a step is the last, pixels of the level. Raised, velocities
        /// are less exact; lowered, they cost more steps.
        converged_blur_px: f64 = 0.03,
        /// Maximum last change of blur, pixels of the level; beyond it the result is rejected.
        /// Raised, velocities are less exact; lowered, some are missed.
        max_last_blur_change_px: f64 = 0.3,
        /// Length of the trial blur that measures the missing blur, pixels of the level. Raised,
        /// fine detail is lost where blur is short; lowered, long blur is found too short.
        trial_blur_px: f64 = 1.5,
        /// Sigmas by which the squared blur must exceed zero. Raised, slow bodies are taken to be
        /// at rest; lowered, noise passes for blur.
        min_blur_sigmas: f64 = 5.0,
        /// Minimum variance of the missing blur, in multiples of `blur_error_px2`. Raised and
        /// lowered as `min_blur_sigmas`.
        min_blur_errors: f64 = 1.5,
        /// Squared sigmas by which rows must prefer a direction to its opposite. Raised, more
        /// frames wait for a second one; lowered, a velocity is taken for its opposite.
        min_direction_preference: f64 = 20.0,
        /// Prior information of the length of an image velocity's blur, per squared pixel of the
        /// level: almost none. Raised, slow bodies are taken to be at rest.
        blur_prior_information: f64 = 1.6e-3,
        /// Fraction of the other information that remains when blur is solved alone, which keeps
        /// the system regular. Raised, blur repeats what was known anyway.
        remaining_information_ratio: f64 = 1e-4,
        /// Sigma of a blur's variance from other causes than motion, pixels² of the level. Raised,
        /// blur says less of slow motions; lowered, poses of sharpened pictures are trusted too
        /// much.
        blur_error_px2: f64 = 0.08,
        /// Number of parts of a frame whose blur is wider or narrower independently. Raised, blur
        /// is trusted more.
        independent_blur_parts: f64 = 6.0,
        /// Maximum squared Mahalanobis distance of a velocity from that of rows and prior. Raised,
        /// defocused or sharpened pictures pass for moving ones; lowered, thrown bodies have no
        /// velocity.
        max_blur_squared_mahalanobis: f64 = 100.0,
        /// Maximum relative sigma of the exposure for using blur under a rolling shutter. Raised,
        /// the first pose may be further off than its covariance says; lowered, first frames wait
        /// for a second one.
        max_exposure_sigma: f64 = 0.3,
        /// Minimum depth of a point over its distance, for computing its motion in the picture.
        /// Lowered, the middle of a stage that begins behind the camera moves without bounds.
        min_depth_ratio: f64 = 0.2,

        // hypotheses/velocity_jump.rs
        /// Sigma of the acceleration for which rows take a jump, times the usual velocity over a
        /// frame's time. Raised, the acceleration is less certain after jumps; lowered, the bend
        /// shifts the pose.
        jump_acceleration_sigma: f64 = 2.0,
        /// Sigma of the pose's error, as a fraction of its distance from the prediction. Raised,
        /// the covariance of every surprise is wider; lowered, it is too narrow for starts within
        /// the exposure.
        jump_prediction_error_ratio: f64 = 0.22,
        /// The same, as a fraction of the distance from the line that the camera was following.
        /// Raised, the covariance of every start and stop is wider; lowered, errors exceed it.
        jump_line_error_ratio: f64 = 0.4,
        /// Sigmas of the largest jump at mid-exposure that such an error is attributed to. Raised,
        /// poses that are far off for other reasons get a wider covariance than any start needs.
        max_jump_sigmas: f64 = 3.0,
        /// Sigma of the pose's error, as a fraction of the velocity's change within a frame times
        /// exposure and readout. Raised, covariances of shaken cameras are wider.
        jump_velocity_error_ratio: f64 = 0.1,

        // pixels/appearance.rs
        /// Minimum samples across a sharp pixel of a tilted surface. Raised, the cost grows with
        /// its square.
        tilted_samples_across: usize = 5,
        /// Cosine of the tilt below which a surface counts as tilted (53 degrees). Raised, more
        /// views pay for more samples.
        tilted_cosine: f64 = 0.6,
        /// Maximum number of places along a blur that get nine samples each. Raised, blurred frames
        /// cost more; lowered, errors grow.
        max_places_with_nine_samples: usize = 3,
        /// Maximum number of places along a blur that get five samples each; beyond, three. Raised,
        /// blurred frames cost more; lowered, errors grow.
        max_places_with_five_samples: usize = 5,
        /// Offset across and down of four of five samples, pixels. Raised, the prediction is more
        /// blurred than the pixel; lowered, less.
        corner_sample_px: f32 = 0.3227,
        /// Offset across and down of the outer two of three samples, pixels. Raised, the prediction
        /// is more blurred than the pixel; lowered, less.
        diagonal_sample_px: f32 = 0.3536,
        /// Groups of pixels by which texels are prefetched. Lowered, texels arrive too late;
        /// raised, they may have left the cache.
        prefetch_groups: usize = 2,
        /// Reach of the prefetch around a pixel, pixels. Lowered, fewer texels are prefetched.
        prefetch_reach_px: f32 = 0.4,
        /// log2 of the texel size that suits a sample of a sharp pixel, pixels. Raised, the
        /// prediction loses detail; lowered, samples skip texels.
        sharp_texel_log2: f32 = -2.8,
        /// The same for a tilted surface.
        tilted_texel_log2: f32 = -3.5,
        /// The same for a blurred pixel.
        blurred_texel_log2: f32 = -1.9,

        // pixels/level_spec.rs
        /// Blur below which a frame is sharp, pixels of the frame. Raised, blur passes for point
        /// spread; lowered, a camera that always moves never informs its noise.
        max_sharp_blur_px: f64 = 1.0,
        /// Pixels per level, from full size down, of a frame `reference_width_px` wide; wider
        /// frames use more in proportion. Raised, frames cost more in proportion; lowered, errors
        /// grow.
        pixels_per_level: [usize; 5] = [10_000, 10_000, 4000, 1500, 500],
        /// Width of the frame that `pixels_per_level` is for, pixels. Lowered, all frames use more
        /// pixels.
        reference_width_px: f64 = 1280.0,
        /// Samples across a pixel above the finest level. Raised, the cost grows with the square;
        /// lowered, the prediction is less accurate.
        coarse_samples_across: usize = 3,
        /// The same at the finest level.
        fine_samples_across: usize = 5,
        /// Samples along a blur: (length below which they suffice, pixels of the level; number,
        /// odd). Lengths raised, blur is predicted as ghost images; lowered, frames cost more.
        places_by_blur: [(f64, usize); 4] = [(0.4, 1), (1.5, 3), (3.0, 5), (5.5, 9)],
        /// Samples along a longer blur. Raised, frames cost more; lowered, blur is predicted as
        /// ghost images.
        max_places: usize = 15,
        /// Places along a blur up to which a coarse level converges without more. Raised, it does
        /// not converge under longer blur; lowered, it costs more without need.
        short_blur_places: usize = 3,
        /// Time over which the speed of the picture is measured, seconds. Hardly matters, as motion
        /// is smooth.
        speed_baseline_s: f64 = 0.005,

        // pixels/selection.rs
        /// Margin inside the border of a surface where no pixel is chosen, pixels of the level.
        /// Raised, surfaces seen small have fewer pixels; lowered, the surroundings bias the pose.
        surface_border_px: f64 = 3.0,
        /// Minimum cosine of the tilt at which a surface is used (86.6 degrees). Raised, steep
        /// views lose their pixels; lowered, their predictions are wrong.
        min_tilt_cosine: f64 = 0.06,

        // pixels/touching_planes.rs
        /// Maximum iterations for where a ray meets the surface; each squares the error. At 1,
        /// steep views of deep folds are off by a fraction of a millimetre; raised, nothing is
        /// gained.
        max_intersection_steps: usize = 3,
        /// Distance from a ray's meeting point within which the plane counts as tangent there,
        /// metres. Raised, steep views of sharp folds are off by more; lowered, each pixel costs
        /// another lookup.
        tangent_plane_reach_m: f32 = 2e-3,

        // frame_problem/blur_doubt.rs
        /// Minimum ratio of a blurred body's residuals to the level above's, where blur is half as
        /// long. Raised, blurred bodies are refused where they are found; lowered, wrong poses cost
        /// more.
        min_blur_residual_ratio: f64 = 1.5,
        /// Ratio of tiles that take part at the level above, from which
        /// `min_blur_residual_ratio_of_coarse_fit` replaces `min_blur_residual_ratio`. Raised and
        /// lowered as `min_blur_residual_ratio`.
        min_coarse_inlier_ratio: f64 = 0.67,
        /// Minimum ratio of a blurred body's residuals to those of the level above, where most
        /// tiles fit there. Raised and lowered as `min_blur_residual_ratio`.
        min_blur_residual_ratio_of_coarse_fit: f64 = 0.75,

        // frame_problem/descent.rs
        /// The first descent's search radius, as a multiple of the decaying maximum of the start
        /// error. Raised, levels are solved that the start does not need; lowered, more frames are
        /// solved twice.
        search_radius_ratio: f64 = 2.0,
        /// Two descents have met if their motions at a level differ by less, pixels of the level.
        /// Raised, a better minimum is missed; lowered, frames of occluded bodies are solved twice.
        same_minimum_px: f64 = 0.5,

        // frame_problem/level_minimisation.rs
        /// Maximum last step of a reported pose, pixels of the level. Raised, solutions that creep
        /// along outside their basin are reported; lowered, good ones that converge slowly are not.
        max_last_step_px: f64 = 0.15,
        /// Maximum step after `settling_rounds`, pixels of the level; with a longer one the level
        /// is given up. Raised, starts that lead nowhere cost more; lowered, slow convergence is
        /// given up.
        max_settled_step_px: f64 = 1.0,
        /// The same limit for residuals beyond `poor_fit_sigma`, or a barely fitting new body.
        /// Raised, hopeless starts cost 2 to 3 followed frames; lowered, slow convergence is given
        /// up.
        max_settled_step_of_poor_fit_px: f64 = 0.3,
        /// Residual sigma beyond which that limit holds. Raised, hopeless starts cost more.
        poor_fit_sigma: f64 = 10.0,
        /// Rounds after which the finest level is given up if it is hopeless. Raised, hopeless
        /// starts cost several frames.
        hopeless_rounds: usize = 2,
        /// Residual sigma beyond which a level is hopeless. Raised, hopeless starts cost several
        /// frames; lowered, half-occluded bodies are lost.
        hopeless_sigma: f64 = 6.0,
        /// Ratio of inlier tiles below which barely half the body fits: only then may a level be
        /// poor, occluded or hopeless. Lowered, hopeless starts cost several frames.
        hopeless_inlier_ratio: f64 = 0.6,
        /// First rounds of a level, in which long steps are allowed; counted anew when its blur
        /// turns out to be longer. Raised and lowered as `max_settled_step_px`.
        settling_rounds: usize = 4,
        /// Maximum rounds at the finest level for a newly found body when barely half its tiles
        /// fit, and those poorly. Raised, frames of occluded bodies cost more; lowered, they are
        /// found later.
        max_poor_rounds: usize = 6,

        // frame_problem/mod.rs
        /// Sigma about the slow estimate of the point spread's variance (kernel's unit) in a sharp
        /// frame. Lowered, refocusing is followed late.
        psf_variance_sigma: f64 = 0.5,
        /// The same in a blurred frame. Raised, motion passes for point spread.
        blurred_psf_variance_sigma: f64 = 0.05,
        /// Maximum linearisations at a coarse level. Raised, frames that do not converge cost more;
        /// lowered, distant starts are given up.
        max_coarse_rounds: usize = 8,
        /// The same at the finest level.
        max_fine_rounds: usize = 10,
        /// A coarse level has converged when a step moves no tile by more, pixels of the level.
        /// Raised, more of the last step is missing from the pose; lowered, frames take more
        /// rounds.
        coarse_converged_px: f64 = 0.1,
        /// The same at the finest level.
        fine_converged_px: f64 = 0.045,
        /// Sigma of what is still missing from the pose, as a fraction of the frame's last step.
        /// Raised, covariances are wider than the errors; lowered, they are too narrow for a moving
        /// camera.
        missing_step_ratio: f64 = 0.2,
        /// Start error from which a level converges, pixels of the level. Raised, starts are solved
        /// twice or lost; lowered, levels are solved that the start does not need.
        basin_px: f64 = 2.5,
        /// Pose change, pixels of the level, after which the finest level's pixels are selected
        /// anew. Raised, they lie beside their edges and pull the pose; lowered, selection costs
        /// more.
        reselection_px: f64 = 0.25,
        /// Maximum residual sigma of a clearly right pose. Lowered, more frames are solved twice;
        /// raised, local minima are taken for the pose.
        clear_fit_sigma: f64 = 2.0,
        /// Minimum ratio of inlier tiles of a clearly right pose, as a fraction of the last
        /// accepted frame's. Raised, more frames are solved twice; lowered, local minima are taken
        /// for the pose.
        clear_fit_inlier_ratio: f64 = 0.8,
        /// Maximum steps of a frame whose velocity jumped or is found by blur. Raised, only frames
        /// that do not converge cost more; lowered, the pose may stay short of the solution.
        max_settling_steps: usize = 8,

        // picture/plane_table.rs
        /// Grid steps per interval of the height's spline, along each axis. Raised, the table grows
        /// with the square and leaves the cache; lowered, edges of sharp folds are off.
        grid_steps_per_interval: usize = 4,
        /// Step of the finite differences of the slopes, as a fraction of the grid spacing. Any
        /// small value would do.
        slope_step_ratio: f64 = 0.25,

        // picture/texture.rs
        /// Maximum candidates per block of 256 texels. Raised, the lists take more memory; lowered,
        /// a still camera uses fewer pixels of detailed pictures.
        candidates_per_block: usize = 160,
        /// Maximum size of a picture that is enlarged, pixels. Raised, large pictures take more
        /// memory and load longer; lowered, more of them lose detail to interpolation.
        max_enlarged_px: u32 = 6_000_000,
        /// The chain of halved copies ends before a side falls below this, texels. Raised, pictures
        /// seen from afar are sampled too finely and alias.
        min_copy_side_texels: usize = 8,

        // solve/aperture.rs
        /// Ratio of agreeing tiles above which an occluder cannot hide all evidence of a direction.
        /// Raised, poses slide along stripes behind people; lowered, an occluder may look like a
        /// slide.
        max_hidden_direction_inlier_ratio: f64 = 0.4,
        /// Minimum support of the worst direction relative to the best. Raised, stages of fine
        /// level lines are lost; lowered, poses slide along stripes.
        min_direction_support: f64 = 0.3,
        /// Standard deviations by which a direction must be unsupported, or supported. Raised,
        /// poses slide along stripes with faint grain; lowered, plain stripes are lost by chance.
        direction_support_sigmas: f64 = 3.0,
        /// One of so many selected pixels is compared. Raised, the regression's deviation grows;
        /// lowered, frames cost more.
        aperture_stride: usize = 3,

        // solve/minimiser.rs
        /// Minimum and maximum fraction of a step that is tried where the whole raised the cost.
        /// Minimum lowered: poor predictions end in steps of no length. Maximum raised: a step that
        /// is far too long takes more rounds.
        shortened_step_ratios: [f64; 2] = [0.1, 0.5],

        // solve/jump_instant.rs
        /// Instants of a jump tried within a frame's exposure and readout. Raised, frames cost
        /// more.
        jump_instants_within_frame: usize = 9,
        /// Instants tried between the last frame and this one, where a jump looks like another
        /// velocity. Raised, frames cost more.
        jump_instants_before_frame: usize = 3,
        /// Prior probability of a jump in the time of a frame. Raised, the covariance of every
        /// frame grows; lowered, more frames near starts and stops are off.
        jump_probability: f64 = 0.003,
        /// Members less likely than this, relative to the likeliest, are dropped. Raised, jumps are
        /// dropped that the covariance should include; lowered, frames cost more and nothing
        /// changes.
        negligible_likelihood: f64 = 1e-6,

        // solve/verdict.rs
        /// Minimum agreeing tiles of a reported pose. Raised, pictures seen small are lost;
        /// lowered, a few tiles that agree by chance are enough.
        min_agreeing_tiles: usize = 8,
        /// Minimum ratio of agreeing tiles of a pose that neither a prediction nor a sharp
        /// covariance supports. Raised, partly occluded stages are lost; lowered, wrong poses pass.
        min_new_inlier_ratio: f64 = 0.5,
        /// The same for a pose where the motion filter predicted it. Raised, partly occluded stages
        /// are lost; below 0.1, wrong poses pass.
        min_continued_inlier_ratio: f64 = 0.12,
        /// Minimum ratio of agreeing tiles to find a partly occluded body again. Raised, such
        /// bodies are found later; lowered, the occluder pulls their poses.
        min_occluded_inlier_ratio: f64 = 0.4,
        /// Maximum residuals of such a pose, sigmas. Raised, something else that fits in part may
        /// pass; lowered, blurred bodies are found later.
        max_occluded_sigma: f64 = 1.5,
        /// Maximum squared Mahalanobis distance of a pose at its predicted place. Raised, a jump
        /// into a local minimum passes for motion; lowered, starts and stops are judged like new
        /// poses.
        max_prediction_squared_mahalanobis: f64 = 100.0,
        /// Maximum residuals of a pose at its predicted place, sigmas of the tiles that take part.
        /// Raised, wrong poses return; lowered, partly occluded stages are lost sooner.
        max_continued_sigma: f64 = 2.5,
        /// Minimum tiles with detail, agreeing or not, of a frame that is conclusive by itself.
        /// Raised, bodies are found a frame later; lowered, a single wrong frame could be reported.
        conclusive_tiles: usize = 40,
        /// Minimum ratio of these that agree. Raised and lowered as `conclusive_tiles`.
        conclusive_inlier_ratio: f64 = 0.7,
        /// Agreeing tiles that suffice where something occludes the rest. Raised, stages behind
        /// people are found late; lowered, poses that fit only in a corner may be reported.
        sufficient_tiles: usize = 24,
        /// The same for their ratio.
        sufficient_inlier_ratio: f64 = 0.15,
        /// Minimum variance of a tile's prediction, in variances of a pixel's noise. Raised, hazy
        /// and dim stages are not found; lowered, noise is judged.
        min_tile_detail: f64 = 0.5,
        /// Minimum sum of that variance over the tile's pixels. Raised, hazy and dim stages are not
        /// found; lowered, noise is judged.
        min_tile_detail_sum: f64 = 25.0,
        /// Minimum fraction of a tile's observed variance that is not noise. Raised, right tiles in
        /// haze do not agree; lowered, plain tiles agree by chance.
        min_signal_ratio: f64 = 0.25,
        /// Minimum correlation of an agreeing tile. Raised, tiles behind gauze and in changing
        /// light disagree; lowered, tiles of other pictures agree by chance.
        min_agreeing_correlation: f64 = 0.9,
        /// Maximum sigma of a position that one frame may report, fraction of the distance. Raised,
        /// first poses of a shaken camera may be wrong; lowered, they wait for a second frame.
        max_single_frame_shift_sigma: f64 = 0.0033,
        /// The same for the direction, radians.
        max_single_frame_rotation_sigma: f64 = 0.00175,

        // solve/level_problem/blur.rs
        /// Reweightings of a step, as many as an alignment's. Raised, a step costs more; lowered,
        /// occluders weigh more.
        blur_reweightings: usize = 2,
        /// Prior information of the unknowns that are not estimated, which keeps the system
        /// regular. Raised, blur is found too short.
        regularising_information: f64 = 1.0,
        /// The same for the squared blur.
        squared_blur_information: f64 = 1e-6,

        // solve/level_problem/mod.rs
        /// Minimum pixels of a level. Raised, pictures seen small are given up or started at finer
        /// levels; lowered, the prior decides the result.
        min_level_pixels: usize = 60,
        /// Minimum correlation of a run with its prediction; the better half always takes part.
        /// Raised, tiles in haze or glare are excluded; lowered, people in front of the stage pull
        /// the pose.
        min_run_correlation: f32 = 0.9,
        /// Correlation above which a run surely shows the body: such runs count for the bias of the
        /// first guess, and in the test for occlusion.
        /// Raised, too few runs are left; lowered, runs of something else take part.
        min_bias_run_correlation: f32 = 0.8,
        /// Maximum bias of that guess, in units of light. Raised, a line through runs with little
        /// contrast can leave almost no gain; lowered, haze is guessed too thin.
        max_initial_bias: f64 = 60.0,
        /// Minimum residuals from which their robust spread is taken, if there are as many. Raised,
        /// the median costs more; lowered, the spread is less certain.
        min_scale_residuals: usize = 1500,
        /// Pixels of a rough step, which is used only for weights and noise. Raised, frames cost
        /// more; lowered, the weights are worse.
        rough_step_pixels: usize = 2500,
        /// Maximum stride of a rough step over groups of pixels. Lowered, frames cost more.
        max_group_stride: usize = 16,
        /// Correlation below which a run shows something else. Raised, a lens error passes for
        /// occlusion; lowered, people in front of the stage pull the pose.
        max_occluded_correlation: f32 = 0.5,

        // solve/level_problem/patches.rs
        /// Mean shift from which patches are sampled again, pixels of the level. Lowered,
        /// miscalibrated cameras cost more.
        resampling_shift_px: f64 = 0.05,
        /// Correction that ends the resampling, pixels of the level. Lowered, miscalibrated cameras
        /// cost more.
        resampling_converged_px: f64 = 0.015,
        /// Maximum rounds of resampling. Raised, miscalibrated cameras cost more.
        max_resampling_rounds: usize = 3,
        /// Minimum fitting pixels of a patch. Raised, pictures seen small have fewer
        /// correspondences; lowered, some of them are chance.
        min_patch_pixels: f64 = 12.0,

        // solve/level_problem/solution.rs
        /// Maximum squared residual, sigmas²; larger ones count as this. Raised, occluders
        /// influence the choice of enlargement; lowered, fewer pixels decide it.
        max_squared_misfit: f32 = 9.0,

        // solve/system/mod.rs
        /// Usual relative difference of gain between neighbouring nodes, one sigma. Raised, gains
        /// absorb what is not light; lowered, spots and shadows are smeared out and pull the pose.
        gain_roughness: f64 = 0.15,
        /// Sigma of the bias, in units of light. Raised, frames of nearly one light trade bias for
        /// gain; lowered, haze pulls the gain.
        bias_sigma: f64 = 60.0,

        // learned/exposure.rs
        /// Initial exposure of an unknown camera, seconds. Raised, the first frames are predicted
        /// with blur that they may not have.
        initial_exposure_s: f64 = 0.004,
        /// Minimum learnt exposure, seconds; above 0, because changes are relative. Raised, cameras
        /// with short exposures are predicted too blurred.
        min_exposure_s: f64 = 5e-4,
        /// Maximum learnt exposure, seconds: the frame interval at 25 per second. Raised,
        /// misleading frames can do more harm.
        max_exposure_s: f64 = 0.04,
        /// Blur that a frame needs for a clue to the exposure, pixels of the frame. Lowered, point
        /// spread passes for motion.
        min_exposure_blur_px: f64 = 0.8,
        /// Blur at which that clue has its full weight, pixels of the frame. Raised, a slow camera
        /// learns later.
        full_weight_blur_px: f64 = 1.5,
        /// Fraction of a frame's clue that is applied, once the first frames, which count more, are
        /// in. Raised, the exposure follows the noise of single frames.
        exposure_learning_rate: f64 = 0.2,
        /// Maximum relative decrease of the squared exposure per frame. Raised, a misleading frame
        /// does more harm; lowered, a wrong start is left later.
        max_exposure_decrease: f64 = 0.5,
        /// The same for its increase.
        max_exposure_increase: f64 = 1.0,
        /// Relative sigma of a learnt exposure before any frame. Raised, the speed of a newly found
        /// body is less certain.
        initial_exposure_sigma: f64 = 1.0,
        /// The same after many frames.
        learnt_exposure_sigma: f64 = 0.05,

        // learned/exposure_watch.rs
        /// Minimum total weight of blurred frames. Raised, a wrong exposure is reported later;
        /// lowered, a few unusual frames contradict a right one.
        min_contradicting_frames: f64 = 30.0,
        /// Minimum factor between the fitted and the configured exposure, up or down. Raised,
        /// smaller errors pass; lowered, rounding by drivers and strong sharpening contradict right
        /// exposures.
        min_exposure_factor: f64 = 1.5,
        /// Minimum reported ratio of fitted to configured exposure. Raised, an exposure configured
        /// too long passes; lowered, sharpening contradicts right ones.
        min_reported_exposure_ratio: f64 = 0.3,
        /// Minimum distance of the mean exposure change from zero, standard errors. Raised, wrong
        /// exposures are reported later.
        min_exposure_standard_errors: f64 = 5.0,
        /// Consecutive frames that count as one, because their errors are alike. Raised, wrong
        /// exposures are reported later.
        correlated_frames: f64 = 5.0,
        /// Maximum relative change that a single frame may ask for, either way; at 1.5 the exposure
        /// is doubled.
        max_exposure_clue: f64 = 1.5,

        // learned/gradient_gain.rs
        /// Initial gain of the gradients. Too large a gain makes steps too short, too small a gain
        /// too long.
        initial_gradient_gain: f64 = 0.95,
        /// Minimum gain. Lowered, misleading frames do more harm.
        min_gradient_gain: f64 = 0.7,
        /// Maximum gain. Raised, misleading frames do more harm.
        max_gradient_gain: f64 = 1.1,
        /// Fraction of the difference to a frame's estimate that is applied per frame. Raised, the
        /// gain follows single frames; lowered, steps have a wrong length for longer after the view
        /// changes.
        gradient_gain_learning_rate: f64 = 0.2,
        /// Minimum mean squared change of a step that is learnt from, squared light. Raised, slow
        /// cameras never learn the gain; lowered, rounding to whole levels biases it.
        min_step_change: f64 = 0.01,

        // learned/light.rs
        /// Weight of the usual gain at a node in the first guess, where each adjacent tile weighs
        /// 1. At 0, nodes without a tile have no gain; raised, shadows are guessed too bright.
        usual_gain_weight: f64 = 0.2,

        // learned/noise.rs
        /// Initial noise variance at black, grey levels². Raised, first covariances are wider.
        initial_dark_variance: f64 = 2.25 + 1.0 / 12.0,
        /// Initial growth of the noise variance per grey level. Raised, first covariances are
        /// wider.
        initial_shot_variance: f64 = 0.03,
        /// Initial error of the prediction, pixels of the level. Raised, first covariances are
        /// wider.
        initial_model_error_px: f64 = 0.02,
        /// Minimum variance at black, grey levels²: that of rounding to whole levels. Raised, quiet
        /// cameras are trusted less than they deserve.
        min_dark_variance: f64 = 1.0 / 12.0,
        /// Minimum error of the prediction, pixels of the level. Raised, the pose of a still camera
        /// scatters more.
        min_model_error_px: f64 = 0.003,
        /// Minimum error of the prediction for a moving camera at the finest level, pixels of the
        /// level. Raised, edges weigh less beside flat texture, and covariances are wider.
        min_moving_model_error_px: f64 = 0.02,
        /// The same above the finest level.
        min_coarse_model_error_px: f64 = 0.04,
        /// Fraction of the memory that fades per frame. Raised, the estimate is noisier; lowered, a
        /// change of the camera's gain is learnt later.
        noise_forgetting_rate: f64 = 0.005,
        /// Weight of the initial noise as a prior, pixels; it holds what frames cannot determine.
        /// Raised, the noise is learnt later.
        initial_noise_weight_pixels: f64 = 200.0,
        /// Fraction of the memory kept when the model changes. Raised, residuals of a wrong lens or
        /// fold count as noise for many passes; at 0, the first frames of a pass are judged by a
        /// usual camera.
        memory_kept_after_model_change: f64 = 0.1,

        // learned/camera_curve.rs
        /// Initial sigma of the curve's corrections, in units of light. Raised, greys that frames
        /// rarely show are bent by chance; lowered, a strong contrast is learnt later.
        initial_curve_sigma: f64 = 30.0,
        /// The same for corrections of an earlier session. Raised, they are soon forgotten.
        kept_curve_sigma: f64 = 2.0,
        /// Sigma of a correction about the mean of its neighbours, in units of light. Raised, noise
        /// bends the curve; lowered, a sharp knee is smoothed out.
        curve_roughness_sigma: f64 = 5.0,
        /// Pixels that count as one: neighbours share errors of the prediction. Raised, the curve
        /// is learnt later; lowered, the first frames bend it by chance.
        pixels_per_curve_sample: f64 = 20.0,
        /// Fraction of the memory that fades per asked frame. Raised, the curve is noisier;
        /// lowered, a change of the camera's settings is learnt later.
        curve_forgetting_rate: f64 = 0.02,
        /// Maximum pixels of a frame that is asked. Raised, such frames cost more; lowered, the
        /// curve is learnt later.
        max_curve_pixels: usize = 2000,
        /// Accepted frames that are all asked, at first. Raised, the curve is known a little
        /// sooner, and the start costs more.
        first_curve_frames: u32 = 10,
        /// Accepted frames from one that is asked to the next. Raised, the curve is learnt later;
        /// lowered, frames cost more.
        curve_interval_frames: u32 = 4,

        // learned/online_calibration.rs
        /// Fraction of the difference to a sharp frame's point spread that is applied per frame.
        /// Raised, it follows noise; lowered, a change of focus is learnt later.
        psf_variance_learning_rate: f64 = 0.2,
        /// Factor per frame of the decaying maximum of the start error. Raised, the search stays
        /// wide longer after a jump, and costs one more level.
        start_error_decay: f64 = 0.8,
        /// Initial start error, pixels of the frame. Raised, more frames start at the coarsest
        /// level; lowered, a pose from features may start outside the first level's basin and is
        /// solved twice.
        initial_start_error_px: f64 = 40.0,
        /// Relative sigma of a configured exposure. Raised, the speed of a newly found body is less
        /// certain.
        configured_exposure_sigma: f64 = 0.03,
        /// Accepted frames between trials of the enlarged pictures. Raised, a wrong choice stays
        /// longer; lowered, frames cost more.
        enlargement_trial_interval_frames: u32 = 32,
        /// The same before the first trial.
        first_enlargement_trial_frames: u32 = 3,
    }
}
