//! Makes a map from a walk: start, sparse adjustment, facets, and the survey's adjustment of the
//! painted stage.

use std::sync::Arc;

use super::super::keyframes::Keyframe;
use super::super::progress::SurveyError;
use super::super::stage::{Survey, SurveyOptions, survey};
use super::super::walk::Walk;
use super::anchoring::{Anchoring, Fit};
use super::error::{MapError, MapStep};
use super::facets::found_facets;
use super::growth::Lens;
use super::hold_out::{HoldOut, hold_out};
use super::locator::Locator;
use super::measuring::{MAX_CLICK_OFF_PX, PlacedPoint, SeenFrom, joined, placed};
use super::missing::missing;
use super::posed_walk::{PosedWalk, posed_walk};
use super::set_points::extent;
use super::stage_of_facets::{grid, painted_stage, textures, views, with_features, without_features};
use crate::frame::Frame;
use crate::geometry::{Body, Camera, Pose};
use crate::light::CameraCurve;
use crate::motion::Motion;
use crate::survey::named_points::{NamedPoint, NamedPoints};
use crate::track::{BentShape, Facet, FacetTexture, StageMap, SurfaceShape, SurfaceSpec};
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
/// Rounds of painting and adjusting. The second paints with cameras and planes that the first
/// adjusted; a third changes little.
const ROUNDS: usize = 2;
/// Factor on the sigma of the map: keyframes share errors of curve, blur and texture, which the
/// adjustment takes to be independent. With 2 the squared errors on a set of planks, brick and
/// crates are a fifth of the covariance. Raised, poses seem less certain than they are; lowered,
/// more.
const SHARED_ERRORS: f64 = 2.0;

/// A map, and what it was made from.
#[derive(Debug)]
pub struct Mapped {
    /// The map.
    pub map: StageMap,
    /// The survey of the painted stage: the configured surfaces, then all facets that were tried.
    pub survey: Survey,
    /// Indices of the map's facets among the survey's surfaces.
    pub kept: Vec<usize>,
    /// One sigma of the map's scale, as a fraction; `None` if nothing measured it.
    pub scale_sigma: Option<f64>,
    /// What gave the scale: surfaces, points, distances.
    pub scale_from: Vec<&'static str>,
    /// Number of frames in which a configured surface was found.
    pub found: usize,
    /// Number of keyframes in which no surface was seen.
    pub unseen: usize,
    /// How well keyframes are located on a map of the others; `None` if those make no map.
    pub hold_out: Option<HoldOut>,
    /// What to film for a better map.
    pub missing: Vec<String>,
    /// Number of points that the facets were found with.
    pub points: usize,
    /// Robust scale of the points' residuals, in sigmas.
    pub points_scale: f64,
    /// Largest distance between two keyframes, metres.
    pub extent_m: f64,
    /// Median distance from the set, metres.
    pub distance_m: f64,
}

/// Makes a map from a walk. The setup's stage has the surfaces that give frame and scale, if there
/// are any; `named` has the points that do.
///
/// # Errors
/// See [`MapError`].
pub fn map(
    walk: Walk,
    setup: &TrackerSetup,
    named: &NamedPoints,
    mut progress: impl FnMut(MapStep),
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Result<Mapped, MapError> {
    let (frames, found, bend) = (walk.frames, walk.found, walk.bend);
    let clicked = walk.named.clone();
    if found == 0 && !setup.stage.surfaces.is_empty() {
        return Err(SurveyError::NotFound { frames }.into());
    }
    let candidates = walk.pictures().count();
    if candidates < MIN_KEYFRAMES {
        return Err(SurveyError::TooFewPlaces { found: candidates, least: MIN_KEYFRAMES }.into());
    }
    progress(MapStep::Points);
    let curve = CameraCurve::bent(setup.settings.transfer.unwrap_or_default(), &bend);
    let lens = Lens { camera: setup.camera, shutter: setup.shutter.or_zero(), curve: curve.clone(), mask: setup.mask.as_ref() };
    let PosedWalk { mut keyframes, mut cloud, is_found } = posed_walk(walk, &lens, !setup.stage.surfaces.is_empty(), goes_on)?;
    match (cloud.points.len(), keyframes.len()) {
        (_, n) if n < MIN_KEYFRAMES => return Err(SurveyError::TooFewPlaces { found: n, least: MIN_KEYFRAMES }.into()),
        (found, _) if found < MIN_POINTS => return Err(MapError::TooFewPoints { found, least: MIN_POINTS }),
        _ => {}
    }
    if setup.stage.surfaces.is_empty() {
        let points = placed_points(named, &clicked, &keyframes, &cloud.poses, setup)?;
        let scale = joined(None, named, &points, &cloud.poses[0]).ok_or(SurveyError::Undetermined)?.0.anchoring().length(1.0);
        if !scale_from(setup, named).is_empty() {
            cloud = cloud.scaled(scale);
            keyframes.iter_mut().for_each(|keyframe| keyframe.motion.velocity *= scale);
        }
    }
    let (extent_m, distance_m) = extent(&cloud);
    if extent_m < MIN_EXTENT * distance_m {
        return Err(MapError::TooLittleParallax { extent_m, distance_m });
    }
    for (keyframe, pose) in keyframes.iter_mut().zip(&cloud.poses) {
        keyframe.motion.pose = *pose;
    }
    progress(MapStep::Facets);
    let mut facets = found_facets(&views(&keyframes, setup, &curve), &cloud, &setup.stage, goes_on).ok_or(SurveyError::Interrupted)?;
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
        let walk = Walk::of_keyframes(keyframes_now, frames, found.max(1), bend);
        let setup = TrackerSetup { stage, ..setup.clone() };
        let made = survey(
            walk,
            Vec::<Vec<Frame>>::new,
            &setup,
            SurveyOptions { keeps_flat: true, ..SurveyOptions::default() },
            |step| progress(MapStep::Survey(step)),
            goes_on,
        )?;
        let kept = made.supported_from(own, distance_m);
        tracing::debug!(round, kept = kept.len(), rms_px = made.rms_px, scale = made.scale, "mapped");
        take_motions(&mut keyframes, &made);
        facets.iter_mut().zip(&made.surfaces[own..]).for_each(|(facet, surface)| facet.pose = surface.pose);
        facets = kept.iter().map(|k| facets[k - own].clone()).collect();
        last = Some((made, kept, textures));
    }
    let Some((survey, kept, textures)) = last.filter(|(_, kept, _)| !kept.is_empty()) else {
        return Err(MapError::NoFacets { points: cloud.points.len() });
    };
    let of_surfaces = anchored(&keyframes, &is_found, &survey, setup, distance_m)?;
    let poses: Vec<Pose<Body, Camera>> = keyframes.iter().map(|keyframe| keyframe.motion.pose).collect();
    let points = placed_points(named, &clicked, &keyframes, &poses, setup)?;
    let (fit, contradiction) = joined(of_surfaces.as_ref(), named, &points, &poses[0]).ok_or(SurveyError::Undetermined)?;
    if let Some(contradiction) = contradiction {
        return Err(MapError::Contradicted(contradiction));
    }
    let scale_from = scale_from(setup, named);
    let anchoring = match scale_from.is_empty() {
        true => fit.anchoring().with_length(distance_m, 1.0),
        false => fit.anchoring(),
    };
    tracing::debug!(?anchoring, "anchored");
    progress(MapStep::HoldOut);
    let hold_out = hold_out(&keyframes, &facets, setup, bend, distance_m, goes_on)?;
    tracing::debug!(?hold_out, "held out");
    let missing = missing(&views(&keyframes, setup, &curve), &kept.iter().map(|k| &survey.surfaces[*k]).collect::<Vec<_>>());
    let facets = kept.iter().map(|k| facet(&survey.surfaces[*k], &textures[k - own], &anchoring)).collect();
    let map = StageMap { bend, keyframes: poses.iter().map(|pose| anchoring.pose(pose)).collect(), facets };
    Ok(Mapped {
        map,
        survey,
        kept,
        scale_sigma: (!scale_from.is_empty()).then_some(anchoring.scale_sigma),
        scale_from,
        found,
        unseen: is_found.iter().filter(|is_found| !**is_found).count(),
        hold_out,
        missing,
        points: cloud.points.len(),
        points_scale: cloud.scale,
        extent_m,
        distance_m,
    })
}

/// Fits the map into the frame of the configured surfaces; `None` without surfaces.
fn anchored(
    keyframes: &[Keyframe],
    is_found: &[bool],
    survey: &Survey,
    setup: &TrackerSetup,
    distance_m: f64,
) -> Result<Option<Fit>, MapError> {
    if setup.stage.surfaces.is_empty() {
        return Ok(None);
    }
    let alone = aligned_alone(keyframes, is_found, setup, distance_m);
    let supporting = survey.motions.iter().zip(&alone).filter_map(|(motion, alone)| Some([motion.as_ref()?.pose, (*alone)?]));
    let fit = Fit::of(&supporting.collect::<Vec<_>>(), &grid(&setup.stage), &setup.camera).ok_or(SurveyError::Undetermined)?;
    Ok(Some(fit))
}

/// Returns where the named points are in the map. `clicked` are the numbers of their frames.
fn placed_points(
    named: &NamedPoints,
    clicked: &[Option<usize>],
    keyframes: &[Keyframe],
    poses: &[Pose<Body, Camera>],
    setup: &TrackerSetup,
) -> Result<Vec<PlacedPoint>, MapError> {
    let mut clicks = vec![Vec::new(); named.points.len()];
    for ((point, click), number) in named.clicks().zip(clicked) {
        let view = number.and_then(|number| keyframes.binary_search_by_key(&number, |keyframe| keyframe.number).ok());
        clicks[point].extend(view.map(|view| (poses[view], click.pixel)));
    }
    let place = |(point, clicks): (&NamedPoint, &Vec<SeenFrom>)| {
        let entry = || point.entry.clone();
        let unseen = || MapError::PointUnseen { entry: entry(), found: clicks.len() };
        let found = if clicks.len() < 2 { None } else { placed(clicks, &setup.camera) }.ok_or_else(unseen)?;
        if found.off_px > MAX_CLICK_OFF_PX {
            return Err(MapError::PointScattered { entry: entry(), off_px: found.off_px });
        }
        Ok(found)
    };
    named.points.iter().zip(&clicks).map(place).collect()
}

/// Returns what gives the scale.
fn scale_from(setup: &TrackerSetup, named: &NamedPoints) -> Vec<&'static str> {
    let sources = [
        (!setup.stage.surfaces.is_empty(), "surfaces"),
        (named.points.iter().filter(|point| point.position_m.is_some()).count() > 1, "points"),
        (!named.distances.is_empty(), "distances"),
    ];
    sources.into_iter().filter_map(|(is_there, name)| is_there.then_some(name)).collect()
}

/// Aligns the configured surfaces alone in every keyframe in which they were found.
fn aligned_alone(keyframes: &[Keyframe], is_found: &[bool], setup: &TrackerSetup, distance_m: f64) -> Vec<Option<Pose<Body, Camera>>> {
    let mut locator = Locator::new(setup, &setup.stage, distance_m);
    keyframes.iter().zip(is_found).map(|(keyframe, is_found)| if *is_found { locator.pose(keyframe) } else { None }).collect()
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
