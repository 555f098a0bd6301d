//! Finds the facets of a set: the flat parts on which its points lie, as far as they reach, beside
//! the configured surfaces.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::bundle::{Cloud, CloudPoint};
use super::flat_parts::flat_parts;
use super::outlines::{Outline, outlines};
use super::set_points::seen_from;
use super::stage_of_facets::{ON_SURFACE, on_picture};
use super::views::Views;
use crate::track::BodySpec;

/// Maximum number of facets, the largest first. Raised, frames take longer to track.
const MAX_FACETS: usize = 60;
/// Spacing of the points that planes are found with, metres. Raised, small faces have too few;
/// lowered, neighbours are too near each other to tell how a plane lies.
const SPACING_M: f64 = 0.03;
/// Maximum sigma of such a point's depth, as a share of the distance from the cameras. Raised,
/// planes take in points beside them; lowered, parts that few keyframes show have no points.
const MAX_DEPTH_SIGMA: f64 = 0.002;
/// Maximum distance from one point of a flat part to the next, as a share of the distance from the
/// cameras. Raised, separate boards in one plane join; lowered, sparse parts fall to pieces.
const MAX_STEP: f64 = 0.06;
/// Distance from a configured surface within which a facet lies on it, metres.
const ON_SURFACE_M: f64 = 0.02;
/// Width of the border around a configured surface that is not mapped either: the paper's edge.
const SURFACE_BORDER_M: f64 = 0.04;

/// Finds the facets, the largest first. `None` if `goes_on` returned false.
pub fn found_facets(views: &Views<'_>, cloud: &Cloud, stage: &BodySpec, goes_on: &(dyn Fn() -> bool + Sync)) -> Option<Vec<Outline>> {
    let is_beside = |point: &&CloudPoint| {
        let within_m = ON_SURFACE * seen_from(cloud, point).1;
        !is_on_surface(stage, &point.place, within_m)
    };
    let points: Vec<(&CloudPoint, f64)> = thinned(views, cloud, cloud.points.iter().filter(is_beside));
    let places: Vec<Vector3<f64>> = points.iter().map(|(point, _)| point.place).collect();
    let (facing, distances): (Vec<_>, Vec<_>) = points.iter().map(|(point, _)| seen_from(cloud, point)).unzip();
    let sigmas: Vec<f64> = points.iter().map(|(_, sigma_m)| *sigma_m).collect();
    let parts = flat_parts(&places, &sigmas, MAX_STEP * distances.iter().sum::<f64>() / distances.len().max(1) as f64, &facing);
    tracing::debug!(parts = ?parts.iter().map(|part| part.members.len()).collect::<Vec<_>>(), points = places.len(), "flat parts");
    let mut facets = outlines(views, &parts, &places, goes_on)?;
    facets.retain(|facet| !is_on_surface(stage, &facet.pose.translation, ON_SURFACE_M));
    let area = |facet: &Outline| facet.sides[0] * facet.sides[1];
    facets.sort_by_key(|facet| std::cmp::Reverse(area(facet)));
    facets.truncate(MAX_FACETS);
    Some(facets)
}

/// Whether a point lies on a configured surface or its border.
fn is_on_surface(stage: &BodySpec, place: &Vector3<f64>, within_m: f64) -> bool {
    stage.surfaces.iter().any(|surface| on_picture(surface, place, within_m, SURFACE_BORDER_M).is_some())
}

/// Returns the best known points, with one sigma of their depths, metres: at most one in a cube of
/// [`SPACING_M`], none worse than [`MAX_DEPTH_SIGMA`].
fn thinned<'a>(views: &Views<'_>, cloud: &Cloud, points: impl Iterator<Item = &'a CloudPoint>) -> Vec<(&'a CloudPoint, f64)> {
    let mut best: BTreeMap<[i64; 3], (&CloudPoint, f64)> = BTreeMap::new();
    for point in points {
        let distance_m = seen_from(cloud, point).1;
        let Some(sigma_m) = cloud.depth_sigma_m(views, point).filter(|sigma| *sigma < MAX_DEPTH_SIGMA * distance_m) else { continue };
        let cube = [0, 1, 2].map(|axis| (point.place[axis] / SPACING_M).floor() as i64);
        let kept = best.entry(cube).or_insert((point, sigma_m));
        if sigma_m < kept.1 {
            *kept = (point, sigma_m);
        }
    }
    best.into_values().collect()
}
