//! An anchor where a verified pose has it and the frame shows it.

use nalgebra::Vector2;

use crate::geometry::resection::Observation;

/// An anchor that fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedAnchor {
    /// Surface index in its body.
    pub surface: u32,
    /// On the artwork, pixels.
    pub artwork: Vector2<f64>,
    /// In the frame.
    pub observation: Observation,
    /// Its raw pixel if all rows were exposed with the middle one.
    pub corrected_px: Vector2<f64>,
}
