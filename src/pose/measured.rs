//! A measured pose with what its covariance is made of.

use nalgebra::Matrix6;

use crate::geometry::{Pose, Stage};

/// A measured pose.
#[derive(Debug, Clone, Copy)]
pub struct Measured<From> {
    /// The pose.
    pub pose: Pose<Stage, From>,
    /// Covariance of [δp, δθ] in stage axes due to the frame's noise; the filter weights by it.
    pub noise: Matrix6<f64>,
    /// The same due to uncertainty of lens and shapes and to model errors, which persist over
    /// frames.
    pub by_model: Option<Matrix6<f64>>,
}

impl<From> Measured<From> {
    /// Returns the total covariance.
    pub fn covariance(&self) -> Matrix6<f64> {
        self.by_model.map_or(self.noise, |by_model| self.noise + by_model)
    }

    /// Returns the part of the covariance that persists over frames; zero if there is none.
    pub fn common(&self) -> Matrix6<f64> {
        self.by_model.unwrap_or_else(Matrix6::zeros)
    }
}
