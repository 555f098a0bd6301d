//! The sizes at which a frame is looked at, numbered: level l has 1/2^l of its width and height.

/// Number of sizes from full to a sixteenth; level 0 is the frame itself and is not stored. Raised,
/// the sums no longer fit 16 bits; lowered, fast motion is lost.
pub const LEVELS: usize = 5;
/// The level at which alignment ends: four pixels of the frame make one, with half the noise.
/// Raised, detail is lost.
pub const FINEST: usize = 1;
