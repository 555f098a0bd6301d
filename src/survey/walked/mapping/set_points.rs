//! The points of a set as cameras see them.

use nalgebra::Vector3;

use super::bundle::{Cloud, CloudPoint};
use crate::geometry::robust_kernel::median;

/// Returns the largest distance between two cameras, and the median distance from them to the
/// points, metres.
pub fn extent(cloud: &Cloud) -> (f64, f64) {
    let places: Vec<Vector3<f64>> = cloud.poses.iter().map(|pose| pose.translation).collect();
    let widest = places.iter().enumerate().flat_map(|(k, a)| places[..k].iter().map(move |b| (a - b).norm())).fold(0.0, f64::max);
    let mut distances: Vec<f64> = cloud.points.iter().map(|point| seen_from(cloud, point).1).collect();
    (widest, median(&mut distances).unwrap_or(0.0))
}

/// Returns the mean direction from a point to the cameras that see it, and their mean distance,
/// metres.
pub fn seen_from(cloud: &Cloud, point: &CloudPoint) -> (Vector3<f64>, f64) {
    let to_cameras = point.sightings.iter().map(|seen| cloud.poses[seen.view].translation - point.place);
    let n = point.sightings.len().max(1) as f64;
    let (direction, distance) = to_cameras.fold((Vector3::zeros(), 0.0), |(sum, m), to| (sum + to.normalize(), m + to.norm()));
    (direction / n, distance / n)
}
