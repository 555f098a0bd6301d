//! Distance of a correspondence from an epipolar relation, in the units of its coordinates (e.g.
//! pixels).
//!
//! The relation is `x2^T F x1 = 0` (F: fundamental for pixels, essential for normalised points).
//! The distance is squared, as costs need it. Source: Hartley and Zisserman, "Multiple View
//! Geometry", chapter 11. A correspondence is a point in four dimensions, and the Sampson distance
//! is its first-order distance from the relation's surface there.

use nalgebra::Matrix3;

use super::correspondence::Correspondence;

/// Computes the squared Sampson distance to F: how far both points together must move to satisfy
/// it.
pub fn squared_sampson<C: Correspondence>(f: &Matrix3<f64>, pair: &C) -> f64 {
    let (a, b) = (pair.first().push(1.0), pair.second().push(1.0));
    let (fa, ftb) = (f * a, f.transpose() * b);
    let c = b.dot(&fa);
    c * c / (fa.xy().norm_squared() + ftb.xy().norm_squared()).max(1e-300)
}
