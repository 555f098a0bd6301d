//! The painted set as a stage with pictures: its surfaces, and the keyframes that a survey of it
//! takes.

use nalgebra::{Point3, Vector3};

use super::super::keyframes::{Keyframe, MatchedFeature};
use super::bundle::Cloud;
use super::outlines::Outline;
use super::set_points::seen_from;
use super::texture::painted;
use super::views::{View, Views};
use crate::light::CameraCurve;
use crate::motion::Motion;
use crate::track::{BodySpec, FacetTexture, SurfaceError, SurfaceSpec};
use crate::tracker::TrackerSetup;

/// Points along each side of a configured surface by which the map is anchored.
const GRID: usize = 8;
/// One sigma of a point's place on its facet, pixels: features only lead to the basin of the
/// alignment.
const POINT_SIGMA_PX: f64 = 1.0;
/// Distance from a surface within which a point lies on it, as a share of the distance from the
/// cameras.
pub const ON_SURFACE: f64 = 0.004;
/// Minimum cosine between a surface's normal and the direction to a camera that shows it.
const MIN_COSINE: f64 = 0.25;

/// Returns the keyframes as the mapping looks at them.
pub fn views<'a>(keyframes: &'a [Keyframe], setup: &'a TrackerSetup, curve: &CameraCurve) -> Views<'a> {
    let view = |keyframe: &'a Keyframe| {
        let Motion { pose, velocity, angular_velocity, .. } = keyframe.motion;
        View { picture: &keyframe.frame.image, pose, rates: [velocity, angular_velocity], is_anchored: true }
    };
    let (views, shutter) = (keyframes.iter().map(view).collect(), setup.shutter.or_zero());
    Views { views, camera: setup.camera, shutter, curve: curve.clone(), mask: setup.mask.as_ref() }
}

/// Returns points on a grid over every surface.
pub fn grid(stage: &BodySpec) -> Vec<Vector3<f64>> {
    let along = |k: usize| (k as f64 + 0.5) / GRID as f64 - 0.5;
    let of_surface = |surface: &SurfaceSpec| {
        let ([w, h], pose) = (surface.size_m, surface.pose);
        (0..GRID * GRID).map(move |k| pose.transform(&Point3::new(w * along(k % GRID), h * along(k / GRID), 0.0)).coords)
    };
    stage.surfaces.iter().flat_map(of_surface).collect()
}

/// Returns where on a surface's picture a point of the stage lies, metres from the centre, if it
/// lies on the surface or its border.
pub fn on_picture(surface: &SurfaceSpec, place: &Vector3<f64>, within_m: f64, border_m: f64) -> Option<[f64; 2]> {
    let own = surface.pose.inverse().transform(&(*place).into());
    let [w, h] = surface.size_m;
    let is_on = own.z.abs() < within_m && own.x.abs() < 0.5 * w + border_m && own.y.abs() < 0.5 * h + border_m;
    is_on.then_some([own.x, own.y])
}

/// Paints the facets; those that no keyframe faces are dropped.
pub fn textures(views: &Views<'_>, facets: &mut Vec<Outline>) -> Vec<FacetTexture> {
    let painted: Vec<(Outline, FacetTexture)> =
        facets.drain(..).filter_map(|facet| Some((facet.clone(), painted(views, &facet)?))).collect();
    let (kept, textures) = painted.into_iter().unzip();
    *facets = kept;
    textures
}

/// Returns the stage with its configured surfaces and the painted facets.
pub fn painted_stage(stage: &BodySpec, facets: &[Outline], textures: &[FacetTexture]) -> Result<BodySpec, SurfaceError> {
    let mut painted = stage.clone();
    for (number, (facet, texture)) in facets.iter().zip(textures).enumerate() {
        let name = format!("facet {}", number + 1);
        painted.surfaces.push(SurfaceSpec::from_any_artwork(name, texture.picture(), facet.size_m(), facet.pose)?);
    }
    Ok(painted)
}

/// Returns the keyframes with the points on facets as features, beside those of the configured
/// surfaces.
pub fn with_features(keyframes: &[Keyframe], cloud: &Cloud, stage: &BodySpec, own: usize) -> Vec<Keyframe> {
    let mut keyframes = keyframes.to_vec();
    for point in &cloud.points {
        let within_m = ON_SURFACE * seen_from(cloud, point).1;
        let on = (own..stage.surfaces.len()).find_map(|k| Some((k, on_picture(&stage.surfaces[k], &point.place, within_m, 0.0)?)));
        let Some((surface, on_picture_m)) = on else { continue };
        for seen in &point.sightings {
            keyframes[seen.view].features.push(MatchedFeature { surface, on_picture_m, pixel: seen.pixel, sigma_px: POINT_SIGMA_PX });
        }
    }
    keyframes
}

/// Returns the keyframes without features.
pub fn without_features(keyframes: &[Keyframe]) -> Vec<Keyframe> {
    keyframes.iter().map(|keyframe| Keyframe { features: Vec::new(), ..keyframe.clone() }).collect()
}

/// Whether a keyframe shows a surface's face, its middle at least.
pub fn shows(views: &Views<'_>, view: usize, surface: &SurfaceSpec) -> bool {
    let (place, normal) = (surface.pose.translation, surface.pose.rotation * Vector3::z());
    views.views[view].faced_by(&place, &normal).0 > MIN_COSINE && views.pixel(view, &place).is_some()
}
