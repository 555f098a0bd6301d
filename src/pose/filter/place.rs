//! What a filter follows: positions and rotations, with the same code.

use std::fmt::Debug;

use nalgebra::{UnitQuaternion, Vector3};

/// A place that can be displaced by a vector: metres for a position, radians in stage axes for a
/// rotation.
pub(super) trait Place: Copy + Debug {
    /// Returns the vector from another place to this one.
    fn way_from(&self, other: &Self) -> Vector3<f64>;
    /// Returns the place displaced by a vector.
    fn moved(&self, by: Vector3<f64>) -> Self;
}

impl Place for Vector3<f64> {
    fn way_from(&self, other: &Self) -> Vector3<f64> {
        self - other
    }

    fn moved(&self, by: Vector3<f64>) -> Self {
        self + by
    }
}

impl Place for UnitQuaternion<f64> {
    fn way_from(&self, other: &Self) -> Vector3<f64> {
        (self * other.inverse()).scaled_axis()
    }

    fn moved(&self, by: Vector3<f64>) -> Self {
        let mut moved = Self::from_scaled_axis(by) * self;
        moved.renormalize();
        moved
    }
}
