//! Relative pose of two views, up to scale.

use nalgebra::{Matrix3, UnitQuaternion, Vector2, Vector3};

use super::pose::skew;

/// Corresponding normalised points in two views, `x2^T E x1 = 0`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayPair {
    /// In the first (reference) view, on the plane at depth 1.
    pub first: Vector2<f64>,
    /// In the second view (the frame), on the plane at depth 1.
    pub second: Vector2<f64>,
}

/// Motion between two views up to scale: `x2 ∝ R x1 + t`, |t| = 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwoViewMotion {
    /// R.
    pub rotation: UnitQuaternion<f64>,
    /// Unit t in the second camera's axes.
    pub direction: Vector3<f64>,
}

impl TwoViewMotion {
    /// Returns E = \[t\]x R.
    pub fn essential(&self) -> Matrix3<f64> {
        skew(&self.direction) * self.rotation.to_rotation_matrix().into_inner()
    }
}
