//! Makes a map from a walk: start, sparse adjustment, facets, the survey's adjustment of the
//! painted stage, and the frame.

use super::super::progress::SurveyError;
use super::super::stage::Survey;
use super::super::walk::Walk;
use super::bundle::Cloud;
use super::error::{MapError, MapStep};
use super::frame_and_scale::{Placing, first_scale, placing};
use super::growth::Lens;
use super::hold_out::{HoldOut, hold_out};
use super::job::Job;
use super::mapped_facet::mapped_facet;
use super::missing::missing;
use super::picture_fault::{explained, picture_fault};
use super::posed_walk::{PosedWalk, posed_walk};
use super::rounds::{Adjusted, adjusted};
use super::set_points::extent;
use crate::survey::named_points::NamedPoints;
use crate::survey::shutter::ShutterTime;
use crate::track::StageMap;
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
    /// The readout that the points told, if nothing configured it and it is not 0.
    pub readout: Option<ShutterTime>,
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
    let fault = picture_fault(walk.pictures().map(|(_, frame)| &frame.image));
    mapped(walk, setup, named, &mut progress, goes_on).map_err(|error| explained(error, fault))
}

/// Makes a map from a walk, whatever is wrong with its pictures.
fn mapped(
    walk: Walk,
    setup: &TrackerSetup,
    named: &NamedPoints,
    progress: &mut dyn FnMut(MapStep),
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Result<Mapped, MapError> {
    let job = Job::of(&walk, setup, named, goes_on);
    refuse_short(&job, &walk)?;
    progress(MapStep::Points);
    let PosedWalk { mut keyframes, mut cloud, is_found, readout } = posed(&job, walk)?;
    let setup = &with_readout(setup, readout);
    let job = Job { setup, ..job };
    if !job.has_surfaces() {
        let scale = first_scale(&job, &keyframes, &cloud.poses)?;
        cloud = cloud.scaled(scale);
        keyframes.iter_mut().for_each(|keyframe| keyframe.scale(scale));
    }
    let (extent_m, distance_m) = checked_extent(&cloud)?;
    keyframes.iter_mut().zip(&cloud.poses).for_each(|(keyframe, pose)| keyframe.motion.pose = *pose);
    let Adjusted { survey, kept, textures, facets } = adjusted(&job, &mut keyframes, &cloud, distance_m, progress)
        .map_err(|error| if setup.shutter.or_zero().is_global() { error } else { error.of_rolling(setup.shutter.or_zero().readout_s) })?;
    let Placing { anchoring, ways, scale_from } = placing(&job, &keyframes, &is_found, &survey, distance_m)?;
    progress(MapStep::HoldOut);
    let hold_out = hold_out(&keyframes, &facets, setup, job.bend, distance_m, goes_on)?;
    tracing::debug!(?hold_out, "held out");
    let missing = missing(&job.views(&keyframes), &kept.iter().map(|k| &survey.surfaces[*k]).collect::<Vec<_>>());
    let own = setup.stage.surfaces.len();
    let facets = kept.iter().map(|k| mapped_facet(&survey.surfaces[*k], &textures[k - own], &anchoring, &ways)).collect();
    let poses = keyframes.iter().map(|keyframe| anchoring.pose(&keyframe.motion.pose)).collect();
    Ok(Mapped {
        map: StageMap { bend: job.bend, keyframes: poses, facets },
        survey,
        kept,
        scale_sigma: (!scale_from.is_empty()).then_some(anchoring.scale_sigma),
        scale_from,
        readout,
        found: job.found,
        unseen: is_found.iter().filter(|is_found| !**is_found).count(),
        hold_out,
        missing,
        points: cloud.points.len(),
        points_scale: cloud.scale,
        extent_m,
        distance_m,
    })
}

/// Refuses a walk without the configured surfaces, or with too few frames.
fn refuse_short(job: &Job<'_>, walk: &Walk) -> Result<(), SurveyError> {
    if job.found == 0 && job.has_surfaces() {
        return Err(SurveyError::NotFound { frames: job.frames });
    }
    enough_places(walk.pictures().count())
}

fn enough_places(found: usize) -> Result<(), SurveyError> {
    if found < MIN_KEYFRAMES { Err(SurveyError::TooFewPlaces { found, least: MIN_KEYFRAMES }) } else { Ok(()) }
}

/// Poses the keyframes.
fn posed(job: &Job<'_>, walk: Walk) -> Result<PosedWalk, MapError> {
    let (setup, curve) = (job.setup, job.curve.clone());
    let lens = Lens { camera: setup.camera, shutter: setup.shutter.or_zero(), curve, mask: setup.mask.as_ref() };
    let posed = posed_walk(walk, &lens, setup.shutter.readout_s.is_some(), job.has_surfaces(), job.goes_on)?;
    enough_places(posed.keyframes.len())?;
    let found = posed.cloud.points.len();
    if found < MIN_POINTS { Err(MapError::TooFewPoints { found, least: MIN_POINTS }) } else { Ok(posed) }
}

/// Returns the largest distance between two cameras and their distance from the set, metres.
fn checked_extent(cloud: &Cloud) -> Result<(f64, f64), MapError> {
    let (extent_m, distance_m) = extent(cloud);
    tracing::debug!(points = cloud.points.len(), extent_m, distance_m, "walk");
    if extent_m < MIN_EXTENT * distance_m { Err(MapError::TooLittleParallax { extent_m, distance_m }) } else { Ok((extent_m, distance_m)) }
}

/// Returns the setup with the readout that the walk told.
fn with_readout(setup: &TrackerSetup, readout: Option<ShutterTime>) -> TrackerSetup {
    let mut setup = setup.clone();
    setup.shutter.readout_s = readout.map(|found| found.seconds).or(setup.shutter.readout_s);
    setup
}
