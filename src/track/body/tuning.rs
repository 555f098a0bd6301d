//! The tuning constants of the memory of a body, in the order of the files that use them.
//!
//! Up to three lines each: what it is, its unit, and the effect of raising or lowering it.
//! docs/tuning.md says where each was measured.

tuning! {
    /// Tuning of the memory of a body.
    pub struct BodyTuning {
        // agreement.rs
        /// Frames per block: neighbouring frames share their errors, so sigma is computed from
        /// blocks of this many. Raised, sigma itself scatters; lowered, sigma comes out too small.
        agreement_block_frames: usize = 6,
        /// Minimum frames for an agreement: two blocks. Raised, clips with a short shake give no
        /// answer; lowered, sigma is a guess.
        min_agreement_frames: usize = 12,

        // clock_steps.rs
        /// Pause that stands for a step back, nanoseconds; restarts tracking. Raised, nothing
        /// changes; lowered below a second, motion is carried over a pause of unknown length.
        clock_restart_pause_ns: i64 = 10_000_000_000,

        // frame_interval.rs
        /// Maximum interval, seconds; longer gaps are interruptions. Raised, a clip of single
        /// pictures would count as a film; lowered, a camera of 2 frames a second has no interval.
        max_interval_s: f64 = 0.5,
        /// Maximum time to the next frame, in intervals, unless a frame is missing. Raised, slow
        /// cameras coast longer; lowered, late frames end a track.
        max_jitter_intervals: f64 = 1.25,

        // learnt_readout.rs
        /// Maximum sigma of a single frame's readout estimate, seconds. Raised, still frames count,
        /// which show only the model's errors; lowered, slow clips give no answer.
        max_vague_readout_sigma_s: f64 = 0.01,
        /// Sigma of row displacement common to all frames that is not due to the readout, pixels.
        /// Raised, slow clips teach nothing; lowered, a readout is learnt that the camera does not
        /// have.
        row_model_error_px: f64 = 0.05,
        /// Maximum frames remembered. Raised, the first frames, which were solved with another
        /// readout time, count for longer; lowered, sigma is larger.
        max_readout_frames: usize = 240,
        /// Linearisation error of a readout step, fraction of the step, one sigma. Raised, the
        /// readout is known later; lowered, first answers look too certain.
        readout_linearisation_error: f64 = 0.25,
        /// Minimum fraction of a readout change that a frame must show to count. Raised, cameras
        /// shaken evenly teach less; lowered, one frame's noise passes for a large change.
        min_shown_readout_ratio: f64 = 0.3,
        /// Change at which the used readout time follows the found one, in sigmas. Raised, it lags;
        /// lowered, poses are corrected in every frame.
        readout_update_sigmas: f64 = 0.2,
        /// Fraction of a readout change that still affects the motion one frame later, as it was
        /// learnt with the former value. Raised, poses stay less certain for longer after a change.
        readout_change_decay: f64 = 0.7,
        /// Remaining effect below which a change counts as settled, seconds. Raised, poses are
        /// certain again slightly sooner.
        min_readout_change_effect_s: f64 = 1e-5,
        /// Minimum readout time, seconds; less counts as global. Raised, fast rolling shutters pass
        /// for global ones; lowered, noise passes for a readout time.
        min_rolling_readout_s: f64 = 5e-4,
        /// Maximum sigma of a known readout time, as a fraction of it. Raised, it is announced
        /// before it is certain.
        max_known_readout_sigma_ratio: f64 = 0.05,
        /// The same in seconds; the larger of both limits counts.
        max_known_readout_sigma_s: f64 = 5e-4,
        /// Minimum displacement of rows by the readout's sigma for a frame to be asked, pixels.
        /// Raised, the readout stays less certain; lowered, slow frames cost more for nothing.
        min_readout_row_shift_px: f64 = 0.1,
        /// Row displacement by the readout's sigma, pixels, above which velocity jumps are not
        /// tried. Raised, the readout is found less well; lowered, starts and stops are followed
        /// less well.
        max_jump_row_shift_px: f64 = 0.1,
        /// Minimum difference of found and configured readout that contradicts, sigmas; all three
        /// limits must be exceeded. Raised, wrong configs pass; lowered, right ones are blamed.
        min_readout_contradiction_sigmas: f64 = 3.0,
        /// The same in seconds.
        min_readout_contradiction_s: f64 = 1e-3,
        /// The same as a fraction of the readout.
        min_readout_contradiction_ratio: f64 = 0.1,
        /// Interval of frames that are asked if the readout is configured. Raised, wrong configs
        /// are noticed later; lowered, frames cost more.
        readout_check_interval_frames: u32 = 8,
        /// Minimum speed of such a frame, pixels per second. Raised, wrong configs are noticed
        /// later; lowered, slow frames are asked, which show nothing.
        min_readout_check_speed_px_s: f64 = 100.0,

        // track_state.rs
        /// Maximum motion between frames that confirm each other, distances per second. Raised, two
        /// wrong poses may confirm each other; lowered, fast cameras are reported later.
        max_confirming_shift_per_s: f64 = 3.0,
        /// The same for the rotation, radians per second.
        max_confirming_rotation_per_s: f64 = 12.0,
        /// Tolerance for measurement noise and timestamp jitter, fraction of the distance. Raised,
        /// two wrong poses may confirm each other; lowered, noisy poses are not confirmed.
        confirming_shift_tolerance: f64 = 0.02,
        /// The same for the rotation, radians.
        confirming_rotation_tolerance: f64 = 0.02,
        /// Maximum interval between frames that confirm each other, seconds. Raised, two wrong
        /// poses have longer to agree; lowered, cameras of 2 frames a second are never tracked.
        max_confirming_gap_s: f64 = 0.5,
        /// Maximum speed since the last reported pose, m/s, if that exceeds
        /// `max_confirming_shift_per_s`: a thrown prop. Raised, copies farther away pass for
        /// motion; lowered, thrown props count as jumps.
        max_body_speed_m_per_s: f64 = 10.0,
        /// Minimum number of a map's facets that remain when moved ones are left out. Raised, small
        /// maps keep moved pieces; lowered, few decide on the pose.
        min_pieces: usize = 3,
        /// How long poses must agree where the body cannot have moved there, seconds: after a cut
        /// or a wrong pose. Raised, a cut costs more; lowered, a pan to a copy is believed sooner.
        jump_confirmation_s: f64 = 3.0,

        // tracked_body/expected.rs
        /// Maximum interval between verified poses that imply a motion, seconds; consecutive frames
        /// always do. Raised, outdated motion is used; lowered, a dropped frame leaves the motion
        /// unknown.
        max_motion_gap_s: f64 = 0.07,
        /// How long after a body was last seen its place is searched first, seconds. Raised, bodies
        /// that went away delay others; lowered, a new body may miss its confirmation.
        last_seen_search_s: f64 = 0.5,

        // tracked_body/mod.rs
        /// Maximum gap over which a body is followed, seconds; the next frame always is. Raised,
        /// alignment starts outside its basin; lowered, a dropped frame costs a search by features.
        max_followed_gap_s: f64 = 0.1,
        /// Maximum residual sigma of an alignment that fits (noise alone: 1). Raised, the right one
        /// of two planar poses may not be tried; lowered, the wrong one costs as much as several
        /// followed bodies.
        max_fitting_sigma: f64 = 1.5,
        /// Fraction of fitting anchors above which no rival start is tried. Raised, frames cost
        /// more; lowered, the first candidate may hide a better one.
        conclusive_anchor_ratio: f64 = 0.6,
        /// Frames between two checks of a followed pose against the opposite tilt, about 1 ms each.
        /// Raised, a pose on the wrong branch stays longer; lowered, frames cost more.
        tilt_audit_interval_frames: u32 = 16,
        /// Distance of a followed pose from its start, in periods, above which it is checked for
        /// being a period off. Raised, it may be a period off; lowered, frames of repetitive
        /// pictures cost more.
        period_check_distance: f64 = 0.25,
        /// Factor by which a pose one period aside must be stronger for this one to be refused, see
        /// `Alignment::strength`. Raised, poses pass that are a period off; lowered to 1, chance
        /// decides.
        min_period_strength_ratio: f64 = 1.2,
        /// Minimum tile weight at which an object's model error is separated from noise, as for the
        /// stage. Raised, objects have wider covariances and are reported a frame later; lowered,
        /// chance decides.
        min_model_error_tiles: f64 = 40.0,
        /// Row displacement by the readout's sigma, pixels, above which misfit may be due to the
        /// shutter. Raised, lenses are blamed for it; lowered, zooms are noticed later if the
        /// shutter is unknown.
        min_shutter_doubt_px: f64 = 0.1,
        /// Minimum distance of a copy's anchor from its projection, fraction of the frame's width.
        /// Raised, a copy in front of the picture is believed; lowered, a picture in deep folds is
        /// refused.
        min_copy_distance: f64 = 0.005,
        /// Minimum anchors of a surface for the pose to explain it. Raised, copies beside a small
        /// or occluded picture pass; lowered, chance decides.
        min_surface_anchors: usize = 8,
        /// Maximum difference of equal starts, radians and fraction of the distance. Raised, a
        /// start that would succeed is skipped; lowered, alignment fails twice from the same place.
        same_start_tolerance: f64 = 0.005,
    }
}
