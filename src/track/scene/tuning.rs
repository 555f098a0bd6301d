//! The tuning constants of the scene, in the order of the files that use them.
//!
//! Up to three lines each: what it is, its unit, and the effect of raising or lowering it.
//! docs/tuning.md says where each was measured.

tuning! {
    /// Tuning of the scene.
    pub struct SceneTuning {
        // averaged_picture.rs
        /// Change of log2 of the texels per pixel after which a copy is made anew. Raised, fine
        /// grain counts as unexplained; lowered, a camera that approaches the stage costs more.
        copy_reuse_log2: f64 = 0.1,
        /// Maximum side of the square, texels. Raised, the five weights in a row no longer hold it.
        max_square_texels: f64 = 4.5,

        // bilinear.rs
        /// Minimum number of places in a cache line (64 texels) if places are up to eight texels
        /// apart. Raised, lines are waited for; lowered, they are requested more than once.
        min_places_per_cache_line: usize = 8,

        // rectangle.rs
        /// Points across and down a rectangle at which its size in the frame is measured. Raised,
        /// it costs more; lowered, a surface of which only a corner is visible shows no point.
        size_grid_points: u32 = 5,

        // reference.rs
        /// Maximum number of anchors per octave. Raised, the start takes longer; lowered, close
        /// views have few.
        max_octave_anchors: usize = 500,
        /// Side of an octave below which there are no more, pixels. Raised, surfaces seen small
        /// have no octave of their size; lowered, nothing is gained.
        min_octave_side_px: u32 = 24,
        /// Maximum number of octaves. Raised, nothing is gained.
        max_octaves: usize = 13,
        /// Border of an octave without anchors, pixels: a patch around one would lie half outside.
        /// Raised, small pictures lose anchors.
        anchor_border_px: u32 = 5,

        // repetition.rs
        /// Maximum number of pixels of the autocorrelated copy. Raised, the start takes longer
        /// (squared); lowered, narrow stripes are missed.
        max_autocorrelated_px: u32 = 12_000,
        /// The local mean is taken over a half width of the picture's side divided by this.
        /// Lowered, bright and dark halves of any picture count as detail; raised, wide periods
        /// vanish.
        local_mean_divisor: usize = 8,
        /// Minimum autocorrelation of a period. Raised, periods with much in front of them are
        /// missed; lowered, poses on ordinary pictures take longer.
        min_period_correlation: f32 = 0.75,
        /// Minimum fall of the autocorrelation on the way to a period; along a stripe there is
        /// none. Raised, short periods of soft pictures are missed; lowered, ramps have periods.
        min_dip: f32 = 0.2,
        /// Minimum period, pixels of the copy. Lowered, neighbours correlate in any picture.
        min_period_px: i64 = 3,
        /// Minimum sine of the angle between independent periods. Lowered, a period and its double
        /// count as two.
        min_independent_sine: f64 = 0.17,
        /// Maximum number of periods of a picture: one each way. Raised, a comparison takes longer.
        max_periods: usize = 2,

        // shape.rs
        /// Newton steps for the meeting point of a ray. Raised, nothing is gained; at 1, steep
        /// views of deep folds are off by a fraction of a millimetre.
        intersection_steps: usize = 3,

        // surface.rs
        /// Minimum side of a picture, pixels. Raised, small props are refused; lowered, pictures
        /// are accepted that are never found.
        min_picture_side_px: u32 = 64,
        /// Minimum number of recognisable corners over all octaves. Raised, plain artwork is
        /// refused that may do; lowered, it is accepted and not found.
        min_corners: usize = 40,
        /// Minimum strength of such a corner (smaller eigenvalue of the structure tensor),
        /// (grey/px)². Raised, faint artwork counts as plain; lowered, the grain of a photograph
        /// counts as corners.
        min_corner_strength: f32 = 12.0,
        /// Maximum side of a rectified photograph, pixels. Raised, large photographs take more
        /// memory and a longer start; lowered, they lose detail.
        max_rectified_side_px: f64 = 4096.0,
        /// Sigma of a corner read off a photograph, pixels along each axis. Raised, poses from
        /// photographs are less certain; lowered, corners as people read them pass for another
        /// lens.
        corner_sigma_px: f64 = 1.0,
    }
}
