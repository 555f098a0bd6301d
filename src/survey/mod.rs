//! What a clip of a known stage says of the camera: [`shutter`] finds readout and exposure from a shaken clip.
//!
//! A survey takes an iterator of frames, wherever they come from, and reads them as often as it needs.

pub mod shutter;
