//! Measured lengths between points of surfaces, and measured positions of such points in the stage
//! frame, as a config states them.

use nalgebra::Vector3;

/// A point on a surface's picture.
#[derive(Debug, Clone, PartialEq)]
pub struct PicturePoint {
    /// Index of the surface in the stage.
    pub surface: usize,
    /// Metres on the picture from its centre, right and up.
    pub on_picture_m: [f64; 2],
}

/// A measured quantity.
#[derive(Debug, Clone, PartialEq)]
pub enum Measured {
    /// The distance between two points, metres.
    Distance {
        /// The two points.
        between: [PicturePoint; 2],
        /// The length.
        length_m: f64,
    },
    /// The position of a point in the stage, metres.
    Place {
        /// The point.
        of: PicturePoint,
        /// Its position.
        position_m: Vector3<f64>,
    },
}

/// A measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct Constraint {
    /// Its place in the config, for messages.
    pub name: String,
    /// The measured quantity.
    pub measured: Measured,
    /// One sigma, metres; for a position along each axis.
    pub sigma_m: f64,
}
