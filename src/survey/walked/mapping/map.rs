//! Makes a map from a walk: start, sparse adjustment, facets, and the survey's adjustment of the
//! painted stage.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use thiserror::Error;

use super::super::keyframes::{Keyframe, MatchedFeature};
use super::super::progress::{SurveyError, SurveyStep};
use super::super::stage::{Survey, SurveyOptions, survey};
use super::super::walk::Walk;
use super::anchoring::Anchoring;
use super::bundle::{self, Cloud, CloudPoint};
use super::flat_parts::flat_parts;
use super::outlines::{Outline, outlines};
use super::texture::painted;
use super::tracks::tracks;
use super::views::{View, Views};
use crate::frame::Frame;
use crate::geometry::robust_kernel::median;
use crate::geometry::{Body, Camera, Pose};
use crate::light::CameraCurve;
use crate::motion::Motion;
use crate::track::{BentShape, BodySpec, BodyTracker, Facet, FacetTexture, StageMap, SurfaceError, SurfaceShape, SurfaceSpec};
use crate::tracker::TrackerSetup;

/// Minimum number of keyframes. Raised, short walks are refused; lowered, facets rest on a few
/// views.
const MIN_KEYFRAMES: usize = 8;
/// Minimum extent of the walk, as a share of the distance to the set: from one side alone, depths
/// are guesses. Half a metre at 3.5 m gave planes that were 4 mm off while its keyframes agreed
/// perfectly.
const MIN_EXTENT: f64 = 0.25;
/// Minimum number of points. Raised, plain sets are refused; lowered, few points decide.
const MIN_POINTS: usize = 200;
/// Maximum number of facets, the largest first. Raised, frames take longer to track.
const MAX_FACETS: usize = 60;
/// Rounds of painting and adjusting. The second paints with cameras and planes that the first
/// adjusted; a third changes little.
const ROUNDS: usize = 2;
/// Distance from a surface within which a point lies on it, as a share of the distance from the
/// cameras.
const ON_SURFACE: f64 = 0.004;
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
/// One sigma of an adjusted pose: of the rotation, radians, and of the position, as a share of the
/// distance. Raised, aligning the surfaces alone takes longer; lowered, a wrong adjustment stays.
const START_SIGMA: f64 = 0.003;
/// Points along each side of a configured surface by which the map is anchored.
const GRID: usize = 8;
/// Factor on the sigma of the map: keyframes share errors of curve, blur and texture, which the
/// adjustment takes to be independent. With 2 the squared errors on a set of planks, brick and
/// crates are a fifth of the covariance. Raised, poses seem less certain than they are; lowered,
/// more.
const SHARED_ERRORS: f64 = 2.0;
/// One sigma of a point's place on its facet, pixels: features only lead to the basin of the
/// alignment.
const POINT_SIGMA_PX: f64 = 1.0;

/// What a mapping is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapStep {
    /// Recognising points in the keyframes, and adjusting them.
    Points,
    /// Finding the facets.
    Facets,
    /// Painting the facets, by round from 0.
    Textures(usize),
    /// A step of the survey of the painted stage.
    Survey(SurveyStep),
}

/// Why a walk yields no map.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum MapError {
    /// As for a survey.
    #[error(transparent)]
    Survey(#[from] SurveyError),
    /// The camera stayed in one place.
    #[error(
        "the walk spans {extent_m:.1} m at {distance_m:.1} m from the set, too little to measure depths: walk from one side of the set \
         to the other, a step to the side for each metre of distance"
    )]
    TooLittleParallax {
        /// Largest distance between two keyframes, metres.
        extent_m: f64,
        /// Median distance from the set, metres.
        distance_m: f64,
    },
    /// Too little was recognised from several places.
    #[error(
        "only {found} points of the set were recognised from several places, at least {} are needed: film it sharper, brighter, or where \
         it has more detail",
        MIN_POINTS
    )]
    TooFewPoints {
        /// Number of points.
        found: usize,
    },
    /// The points lie on no flat parts.
    #[error("none of the {points} points lie on flat parts that several keyframes show alike: the set may move, or have no flat parts")]
    NoFacets {
        /// Number of points.
        points: usize,
    },
    /// A facet cannot be a surface.
    #[error("a facet cannot be tracked: {0}")]
    Facet(#[from] SurfaceError),
}

/// A map, and what it was made from.
#[derive(Debug)]
pub struct Mapped {
    /// The map.
    pub map: StageMap,
    /// The survey of the painted stage: the configured surfaces, then all facets that were tried.
    pub survey: Survey,
    /// Indices of the map's facets among the survey's surfaces.
    pub kept: Vec<usize>,
    /// One sigma of the map's scale, as a fraction.
    pub scale_sigma: f64,
    /// Number of points that the facets were found with.
    pub points: usize,
    /// Robust scale of the points' residuals, in sigmas.
    pub points_scale: f64,
    /// Largest distance between two keyframes, metres.
    pub extent_m: f64,
    /// Median distance from the set, metres.
    pub distance_m: f64,
}

/// Makes a map from a walk. The setup's stage has the surfaces that give frame and scale.
///
/// # Errors
/// See [`MapError`].
pub fn map(
    walk: Walk,
    setup: &TrackerSetup,
    mut progress: impl FnMut(MapStep),
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Result<Mapped, MapError> {
    let Walk { mut keyframes, frames, found, bend, .. } = walk;
    match (found, keyframes.len()) {
        (0, _) => return Err(SurveyError::NotFound { frames }.into()),
        (_, n) if n < MIN_KEYFRAMES => return Err(SurveyError::TooFewPlaces { found: n, least: MIN_KEYFRAMES }.into()),
        _ => {}
    }
    progress(MapStep::Points);
    let curve = CameraCurve::bent(setup.settings.transfer.unwrap_or_default(), &bend);
    let cloud = cloud(&views(&keyframes, setup, &curve), goes_on)?;
    let (extent_m, distance_m) = extent(&cloud);
    if extent_m < MIN_EXTENT * distance_m {
        return Err(MapError::TooLittleParallax { extent_m, distance_m });
    }
    for (keyframe, pose) in keyframes.iter_mut().zip(&cloud.poses) {
        keyframe.motion.pose = *pose;
    }
    progress(MapStep::Facets);
    let mut facets = found_facets(&views(&keyframes, setup, &curve), &cloud, &setup.stage, goes_on)?;
    tracing::debug!(points = cloud.points.len(), facets = facets.len(), extent_m, distance_m, "facets");
    let own = setup.stage.surfaces.len();
    let mut last = None;
    for round in 0..ROUNDS {
        progress(MapStep::Textures(round));
        let textures = textures(&views(&keyframes, setup, &curve), &mut facets);
        if facets.is_empty() {
            return Err(MapError::NoFacets { points: cloud.points.len() });
        }
        let stage = painted_stage(&setup.stage, &facets, &textures)?;
        // Points only lead to the basin of the alignment, where the second round already is.
        let keyframes_now = if round == 0 { with_features(&keyframes, &cloud, &stage, own) } else { without_features(&keyframes) };
        let walk = Walk { keyframes: keyframes_now, lively: Vec::new(), frames, found, bend };
        let setup = TrackerSetup { stage, ..setup.clone() };
        let made = survey(
            walk,
            Vec::<Vec<Frame>>::new,
            &setup,
            SurveyOptions { keeps_flat: true, ..SurveyOptions::default() },
            |step| progress(MapStep::Survey(step)),
            goes_on,
        )?;
        let kept: Vec<usize> = (own..made.surfaces.len()).filter(|k| made.is_supported(*k, distance_m)).collect();
        tracing::debug!(round, kept = kept.len(), rms_px = made.rms_px, scale = made.scale, "mapped");
        take_motions(&mut keyframes, &made);
        facets.iter_mut().zip(&made.surfaces[own..]).for_each(|(facet, surface)| facet.pose = surface.pose);
        facets = kept.iter().map(|k| facets[k - own].clone()).collect();
        last = Some((made, kept, textures));
    }
    let Some((survey, kept, textures)) = last.filter(|(_, kept, _)| !kept.is_empty()) else {
        return Err(MapError::NoFacets { points: cloud.points.len() });
    };
    let alone = aligned_alone(&keyframes, setup, distance_m);
    let supporting = survey.motions.iter().zip(&alone).filter_map(|(motion, alone)| Some([motion.as_ref()?.pose, (*alone)?]));
    let anchoring = Anchoring::of(&supporting.collect::<Vec<_>>(), &grid(&setup.stage), &setup.camera).ok_or(SurveyError::Undetermined)?;
    tracing::debug!(?anchoring, "anchored");
    let facets = kept.iter().map(|k| facet(&survey.surfaces[*k], &textures[k - own], &anchoring)).collect();
    let map = StageMap { bend, keyframes: keyframes.iter().map(|keyframe| anchoring.pose(&keyframe.motion.pose)).collect(), facets };
    Ok(Mapped {
        map,
        survey,
        kept,
        scale_sigma: anchoring.scale_sigma,
        points: cloud.points.len(),
        points_scale: cloud.scale,
        extent_m,
        distance_m,
    })
}

fn views<'a>(keyframes: &'a [Keyframe], setup: &'a TrackerSetup, curve: &CameraCurve) -> Views<'a> {
    let views = keyframes.iter().map(|keyframe| View { picture: &keyframe.frame.image, pose: keyframe.motion.pose }).collect();
    Views { views, camera: setup.camera, curve: curve.clone(), mask: setup.mask.as_ref() }
}

/// Recognises points and adjusts them jointly with the cameras.
fn cloud(views: &Views<'_>, goes_on: &(dyn Fn() -> bool + Sync)) -> Result<Cloud, MapError> {
    let tracks = tracks(views, goes_on).ok_or(SurveyError::Interrupted)?;
    tracing::debug!(tracks = tracks.len(), keyframes = views.views.len(), "tracks");
    let cloud =
        bundle::adjusted(views, tracks, goes_on).ok_or(if goes_on() { SurveyError::Undetermined } else { SurveyError::Interrupted })?;
    let found = cloud.points.len();
    if found < MIN_POINTS { Err(MapError::TooFewPoints { found }) } else { Ok(cloud) }
}

/// Returns the largest distance between two cameras, and the median distance from them to the
/// points, metres.
fn extent(cloud: &Cloud) -> (f64, f64) {
    let places: Vec<Vector3<f64>> = cloud.poses.iter().map(|pose| pose.translation).collect();
    let widest = places.iter().enumerate().flat_map(|(k, a)| places[..k].iter().map(move |b| (a - b).norm())).fold(0.0, f64::max);
    let mut distances: Vec<f64> = cloud.points.iter().map(|point| seen_from(cloud, point).1).collect();
    (widest, median(&mut distances).unwrap_or(0.0))
}

/// Returns the mean direction from a point to the cameras that see it, and their mean distance,
/// metres.
fn seen_from(cloud: &Cloud, point: &CloudPoint) -> (Vector3<f64>, f64) {
    let to_cameras = point.sightings.iter().map(|seen| cloud.poses[seen.view].translation - point.place);
    let n = point.sightings.len().max(1) as f64;
    let (direction, distance) = to_cameras.fold((Vector3::zeros(), 0.0), |(sum, m), to| (sum + to.normalize(), m + to.norm()));
    (direction / n, distance / n)
}

/// Finds the facets, beside the configured surfaces, the largest first.
fn found_facets(views: &Views<'_>, cloud: &Cloud, stage: &BodySpec, goes_on: &(dyn Fn() -> bool + Sync)) -> Result<Vec<Outline>, MapError> {
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
    let mut facets = outlines(views, &parts, &places, goes_on).ok_or(SurveyError::Interrupted)?;
    facets.retain(|facet| !is_on_surface(stage, &facet.pose.translation, ON_SURFACE_M));
    let area = |facet: &Outline| facet.sides[0] * facet.sides[1];
    facets.sort_by_key(|facet| std::cmp::Reverse(area(facet)));
    facets.truncate(MAX_FACETS);
    Ok(facets)
}

/// Aligns the configured surfaces alone in every keyframe, from the adjusted pose.
fn aligned_alone(keyframes: &[Keyframe], setup: &TrackerSetup, distance_m: f64) -> Vec<Option<Pose<Body, Camera>>> {
    let TrackerSetup { camera, shutter, mask, stage, settings, clock, store, .. } = setup.clone().as_trial();
    let mut tracker = BodyTracker::new(camera, shutter.or_zero().into(), mask, &[&stage], settings, clock, store);
    let mut align = |keyframe: &Keyframe| {
        let found = tracker.study().try_start(&keyframe.frame, &keyframe.motion.pose, START_SIGMA * distance_m, START_SIGMA)?;
        found.is_credible(false).then_some(found.pose)
    };
    keyframes.iter().map(&mut align).collect()
}

/// Returns points on a grid over every surface.
fn grid(stage: &BodySpec) -> Vec<Vector3<f64>> {
    let along = |k: usize| (k as f64 + 0.5) / GRID as f64 - 0.5;
    let of_surface = |surface: &SurfaceSpec| {
        let ([w, h], pose) = (surface.size_m, surface.pose);
        (0..GRID * GRID).map(move |k| pose.transform(&Point3::new(w * along(k % GRID), h * along(k / GRID), 0.0)).coords)
    };
    stage.surfaces.iter().flat_map(of_surface).collect()
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

/// Returns where on a surface's picture a point of the stage lies, metres from the centre, if it
/// lies on the surface or its border.
fn on_picture(surface: &SurfaceSpec, place: &Vector3<f64>, within_m: f64, border_m: f64) -> Option<[f64; 2]> {
    let own = surface.pose.inverse().transform(&(*place).into());
    let [w, h] = surface.size_m;
    let is_on = own.z.abs() < within_m && own.x.abs() < 0.5 * w + border_m && own.y.abs() < 0.5 * h + border_m;
    is_on.then_some([own.x, own.y])
}

/// Paints the facets; those that no keyframe faces are dropped.
fn textures(views: &Views<'_>, facets: &mut Vec<Outline>) -> Vec<FacetTexture> {
    let painted: Vec<(Outline, FacetTexture)> =
        facets.drain(..).filter_map(|facet| Some((facet.clone(), painted(views, &facet)?))).collect();
    let (kept, textures) = painted.into_iter().unzip();
    *facets = kept;
    textures
}

/// Returns the stage with its configured surfaces and the painted facets.
fn painted_stage(stage: &BodySpec, facets: &[Outline], textures: &[FacetTexture]) -> Result<BodySpec, SurfaceError> {
    let mut painted = stage.clone();
    for (number, (facet, texture)) in facets.iter().zip(textures).enumerate() {
        let name = format!("facet {}", number + 1);
        painted.surfaces.push(SurfaceSpec::from_any_artwork(name, texture.picture(), facet.size_m(), facet.pose)?);
    }
    Ok(painted)
}

/// Returns the keyframes with the points on facets as features, beside those of the configured
/// surfaces.
fn with_features(keyframes: &[Keyframe], cloud: &Cloud, stage: &BodySpec, own: usize) -> Vec<Keyframe> {
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

fn without_features(keyframes: &[Keyframe]) -> Vec<Keyframe> {
    keyframes.iter().map(|keyframe| Keyframe { features: Vec::new(), ..keyframe.clone() }).collect()
}

/// Takes over the adjusted motions of the keyframes that support the result.
fn take_motions(keyframes: &mut [Keyframe], made: &Survey) {
    let adjusted = keyframes.iter_mut().zip(&made.motions);
    adjusted.for_each(|(keyframe, motion): (&mut Keyframe, &Option<Motion>)| keyframe.motion = motion.unwrap_or(keyframe.motion));
}

fn facet(surface: &SurfaceSpec, texture: &FacetTexture, anchoring: &Anchoring) -> Facet {
    let shape = match &surface.shape {
        SurfaceShape::Bent(shape) => SurfaceShape::Bent(Arc::new(with_shared_errors(shape))),
        shape => shape.clone(),
    };
    let size_m = surface.size_m.map(|side| anchoring.length(side));
    Facet { name: surface.name.clone(), size_m, pose: anchoring.pose(&surface.pose), shape, texture: texture.clone() }
}

/// Returns a shape with the errors that all keyframes share in its modes of uncertainty.
fn with_shared_errors(shape: &BentShape) -> BentShape {
    let mut shape = shape.clone();
    for way in &mut shape.ways {
        way.height.coefficients_mut().iter_mut().for_each(|c| *c *= SHARED_ERRORS);
        way.stretch.coefficients_mut().iter_mut().for_each(|c| *c *= SHARED_ERRORS);
    }
    shape
}
