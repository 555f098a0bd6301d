//! The frame and the scale of a map, from all that the config has of it: surfaces, points, lengths.

use super::super::keyframes::Keyframe;
use super::super::progress::SurveyError;
use super::super::stage::Survey;
use super::anchoring::{Anchoring, Fit, FrameWay};
use super::error::MapError;
use super::job::Job;
use super::locator::Locator;
use super::measuring::{MAX_CLICK_OFF_PX, PlacedPoint, SeenFrom, UNKNOWN, joined, placed};
use super::stage_of_facets::grid;
use crate::geometry::{Body, Camera, Pose};
use crate::survey::named_points::{NamedPoint, NamedPoints};
use crate::tracker::TrackerSetup;

/// Where a map belongs.
pub struct Placing {
    /// The motion and the scale that put it there.
    pub anchoring: Anchoring,
    /// How they may be off; none where nothing is metric, since they are a choice then.
    pub ways: Vec<FrameWay>,
    /// What gave the scale: surfaces, points, distances.
    pub scale_from: Vec<&'static str>,
}

/// Returns the factor by which points and lengths scale keyframes that no surface gave their scale;
/// 1 if nothing is metric.
///
/// # Errors
/// Points that keyframes do not determine.
pub fn first_scale(job: &Job<'_>, keyframes: &[Keyframe], poses: &[Pose<Body, Camera>]) -> Result<f64, MapError> {
    let points = placed_points(job, keyframes, poses)?;
    let (fit, _) = joined(None, job.named, &points, &poses[0]).ok_or(SurveyError::Undetermined)?;
    Ok(if scale_from(job.setup, job.named).is_empty() { 1.0 } else { fit.anchoring().length(1.0) })
}

/// Finds where an adjusted map belongs. `is_found` tells in which keyframes a configured surface
/// was found.
///
/// # Errors
/// A measurement contradicts the others, or what the config has determines nothing.
pub fn placing(job: &Job<'_>, keyframes: &[Keyframe], is_found: &[bool], survey: &Survey, distance_m: f64) -> Result<Placing, MapError> {
    let of_surfaces = anchored(keyframes, is_found, survey, job.setup, distance_m)?;
    let poses: Vec<Pose<Body, Camera>> = keyframes.iter().map(|keyframe| keyframe.motion.pose).collect();
    let points = placed_points(job, keyframes, &poses)?;
    let (fit, contradiction) = joined(of_surfaces.as_ref(), job.named, &points, &poses[0]).ok_or(SurveyError::Undetermined)?;
    if let Some(contradiction) = contradiction {
        return Err(MapError::Contradicted(contradiction));
    }
    let scale_from = scale_from(job.setup, job.named);
    let (anchoring, ways) = match scale_from.is_empty() {
        true => (fit.anchoring().with_length(distance_m, 1.0), Vec::new()),
        false => (fit.anchoring(), fit.ways(UNKNOWN)),
    };
    tracing::debug!(?anchoring, ?ways, "anchored");
    Ok(Placing { anchoring, ways, scale_from })
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

/// Returns where the named points are in the map.
fn placed_points(job: &Job<'_>, keyframes: &[Keyframe], poses: &[Pose<Body, Camera>]) -> Result<Vec<PlacedPoint>, MapError> {
    let Job { named, clicked, setup, .. } = job;
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
