//! Rounds of painting and adjusting: the facets are painted from the keyframes, and the painted
//! stage is surveyed, which moves facets and cameras to where grey values want them.

use super::super::keyframes::Keyframe;
use super::super::stage::{Survey, SurveyOptions, survey};
use super::super::walk::Walk;
use super::bundle::Cloud;
use super::error::{MapError, MapStep};
use super::facets::found_facets;
use super::job::Job;
use super::outlines::Outline;
use super::stage_of_facets::{painted_stage, textures, with_features, without_features};
use crate::frame::Frame;
use crate::motion::Motion;
use crate::survey::walked::progress::SurveyError;
use crate::track::FacetTexture;
use crate::tracker::TrackerSetup;

/// Rounds of painting and adjusting. The second paints with cameras and planes that the first
/// adjusted; a third changes little.
const ROUNDS: usize = 2;

/// The adjusted facets.
pub struct Adjusted {
    /// The survey of the painted stage: the configured surfaces, then all facets that were tried.
    pub survey: Survey,
    /// Indices of the supported facets among its surfaces.
    pub kept: Vec<usize>,
    /// The pictures of all facets that were tried.
    pub textures: Vec<FacetTexture>,
    /// The supported facets.
    pub facets: Vec<Outline>,
}

/// Finds the facets, and paints and adjusts them in some rounds. The keyframes take over their
/// adjusted motions. `distance_m` is their distance from the set.
///
/// # Errors
/// No facet is found or supported, a survey fails, or the work was stopped.
pub fn adjusted(
    job: &Job<'_>,
    keyframes: &mut [Keyframe],
    cloud: &Cloud,
    distance_m: f64,
    progress: &mut dyn FnMut(MapStep),
) -> Result<Adjusted, MapError> {
    progress(MapStep::Facets);
    let mut facets = found_facets(&job.views(keyframes), cloud, &job.setup.stage, job.goes_on).ok_or(SurveyError::Interrupted)?;
    tracing::debug!(points = cloud.points.len(), facets = facets.len(), "facets");
    let mut last = None;
    for round in 0..ROUNDS {
        progress(MapStep::Textures(round));
        let textures = textures(&job.views(keyframes), &mut facets);
        if facets.is_empty() {
            return Err(MapError::NoFacets { points: cloud.points.len() });
        }
        // Points only lead to the basin of the alignment, where the second round already is.
        let with_points = (round == 0).then_some(cloud);
        let survey = surveyed(job, keyframes, with_points, &facets, &textures, progress)?;
        let own = job.setup.stage.surfaces.len();
        let kept = survey.supported_from(own, distance_m);
        tracing::debug!(round, kept = kept.len(), rms_px = survey.rms_px, scale = survey.scale, "mapped");
        take_motions(keyframes, &survey);
        facets.iter_mut().zip(&survey.surfaces[own..]).for_each(|(facet, surface)| facet.pose = surface.pose);
        facets = kept.iter().map(|k| facets[k - own].clone()).collect();
        last = Some((survey, kept, textures));
    }
    match last.filter(|(_, kept, _)| !kept.is_empty()) {
        Some((survey, kept, textures)) => Ok(Adjusted { survey, kept, textures, facets }),
        None => Err(MapError::NoFacets { points: cloud.points.len() }),
    }
}

/// Surveys the painted stage; the keyframes of `with_points` lead to the basin of the alignment.
fn surveyed(
    job: &Job<'_>,
    keyframes: &[Keyframe],
    with_points: Option<&Cloud>,
    facets: &[Outline],
    textures: &[FacetTexture],
    progress: &mut dyn FnMut(MapStep),
) -> Result<Survey, MapError> {
    let stage = painted_stage(&job.setup.stage, facets, textures)?;
    let keyframes = match with_points {
        Some(cloud) => with_features(keyframes, cloud, &stage, job.setup.stage.surfaces.len()),
        None => without_features(keyframes),
    };
    let walk = Walk::of_keyframes(keyframes, job.frames, job.found.max(1), job.bend);
    let setup = TrackerSetup { stage, ..job.setup.clone() };
    let options = SurveyOptions { keeps_flat: true, ..SurveyOptions::default() };
    let show = |step| progress(MapStep::Survey(step));
    Ok(survey(walk, Vec::<Vec<Frame>>::new, &setup, options, show, job.goes_on)?)
}

/// Takes over the adjusted motions of the keyframes that support the result.
fn take_motions(keyframes: &mut [Keyframe], made: &Survey) {
    let adjusted = keyframes.iter_mut().zip(&made.motions);
    adjusted.for_each(|(keyframe, motion): (&mut Keyframe, &Option<Motion>)| keyframe.motion = motion.unwrap_or(keyframe.motion));
}
