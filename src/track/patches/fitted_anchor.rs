//! An anchor that was located in the frame, with the pixel where the frame shows it.

use nalgebra::Vector2;

use crate::geometry::resection::Observation;

/// An anchor located in the frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedAnchor {
    /// Index of the surface in its body.
    pub surface: u32,
    /// Position on the artwork, pixels.
    pub artwork: Vector2<f64>,
    /// Its body point and its pixel in the frame, with the pixel's information.
    pub observation: Observation,
    /// The raw pixel at which it would appear if all rows were exposed with the middle one.
    pub corrected_px: Vector2<f64>,
}
