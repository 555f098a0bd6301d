//! Light and the grey levels that stand for it.
//!
//! Light is additive: over a pixel, over an exposure, and from several lamps. Grey levels are not,
//! because pictures and cameras encode light along a curve. So whatever is averaged or scaled is
//! decoded to light first.
//!
//! - `transfer`: the standard curves between light and grey levels
//! - `camera_curve`: the light that each grey level of a camera stands for
//! - `square_root`: light in one byte, encoded as its square root
//!
//! Light has the range of grey levels: 0 to 255, where 255 is what the brightest grey stands for.

pub mod camera_curve;
pub mod square_root;
pub mod transfer;

pub use camera_curve::CameraCurve;
pub use transfer::Transfer;
