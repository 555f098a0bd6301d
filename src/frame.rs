//! A frame: one grey picture from a camera, with its stamp and its number.

use image::GrayImage;

/// One picture to be tracked.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Grey levels 0..=255, row-major, raw (distorted) pixels; pixel centres at integers.
    pub image: GrayImage,
    /// When the middle row was at mid-exposure: monotonic nanoseconds.
    pub timestamp_ns: i64,
    /// Row number in the clip, or frame number of the device, from 0.
    pub sequence: u64,
}
