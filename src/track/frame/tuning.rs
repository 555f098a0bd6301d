//! The tuning constants of frames, in the order of the files that use them.
//!
//! Up to three lines each: what it is, its unit, and the effect of raising or lowering it.
//! docs/tuning.md says where each was measured.

tuning! {
    /// Tuning of frames.
    pub struct FrameTuning {
        // light_levels.rs
        /// Sum of the four greys of a pixel from which it is not clipped to black. Lowered, clipped
        /// pixels bias the pose.
        min_grey_sum: u32 = 3,
        /// Sum of the four greys of a pixel from which it is saturated. Raised, clipped pixels bias
        /// the pose; lowered, white parts of a bright stage are not used.
        saturated_grey_sum: u32 = 1008,

        // frame_look.rs
        /// Sampling stride across and down, pixels of the half-size frame. Raised, a look costs
        /// less and misses thin detail.
        look_stride_px: usize = 4,
        /// Distance of the wider step, pixels of the half-size frame. Raised, more blur is needed
        /// for a frame to count as blurred; `min_sharpness` depends on it.
        wide_step_px: usize = 4,
        /// Bright end of a dark frame, grey levels. Raised, more frames count as dark.
        max_dark_grey: u8 = 45,
        /// Middle of a white frame, grey levels. Lowered, more frames count as white.
        min_white_grey: u8 = 240,
        /// Range of a plain frame, grey levels. Raised, more frames count as plain.
        max_plain_range: u8 = 20,
        /// Sharpness below which a frame is blurred, see `FrameLook::sharpness`. Raised, soft
        /// lenses count as blurred.
        min_sharpness: f32 = 0.095,

        // rays.rs
        /// Side of the squares of pixels that share the derivatives of their rays. Raised,
        /// footprints near the edge of a wide lens are off; lowered, the table grows (squared) and
        /// leaves the cache.
        ray_square_px: usize = 8,

        // tile_grid.rs
        /// Maximum tiles across and down the part of the frame that the body covers. Raised, tiles
        /// have too few pixels and the system grows; lowered, an occluder costs larger tiles.
        max_tiles: [usize; 2] = [16, 10],
        /// Minimum side of a tile, pixels of the level. Raised, small pictures have too few tiles
        /// to be trusted; lowered, tiles have too few pixels for a correlation.
        min_tile_px: usize = 6,
    }
}
