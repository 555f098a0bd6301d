//! The size of pictures that are accepted.

/// Maximum side of a picture, pixels: the limit of JPEG's 16 bits and far beyond any sensor.
/// Raised, wrong numbers pass.
pub const MAX_SIDE: u32 = 65_535;
