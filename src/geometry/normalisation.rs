//! Hartley's normalisation ("In defense of the eight-point algorithm", PAMI 1997), which makes
//! linear solutions in pixels well conditioned.

use nalgebra::{Matrix3, Vector2};

/// Returns the map that moves the points' centroid to the origin and scales their mean distance
/// from it to √2; `None` if all points coincide.
pub fn normalising(points: impl Iterator<Item = Vector2<f64>> + Clone) -> Option<Matrix3<f64>> {
    let n = points.clone().count() as f64;
    let mean = points.clone().sum::<Vector2<f64>>() / n;
    let spread = points.map(|p| (p - mean).norm()).sum::<f64>() / n;
    let s = std::f64::consts::SQRT_2 / spread;
    s.is_finite().then(|| Matrix3::new(s, 0.0, -s * mean.x, 0.0, s, -s * mean.y, 0.0, 0.0, 1.0))
}
