//! The hold-out of a map: every fifth keyframe is located on a map of the others, and compared with
//! where the map of all has it.

use super::super::keyframes::Keyframe;
use super::super::progress::SurveyError;
use super::super::stage::{SurveyOptions, survey};
use super::super::walk::Walk;
use super::anchoring::Fit;
use super::locator::Locator;
use super::outlines::Outline;
use super::stage_of_facets::{grid, painted_stage, textures, views, without_features};
use crate::frame::Frame;
use crate::geometry::robust_kernel::median;
use crate::light::CameraCurve;
use crate::light::camera_curve::Bend;
use crate::track::BodySpec;
use crate::tracker::TrackerSetup;

/// One keyframe in so many is held out.
const HELD_OUT: usize = 5;

/// How well keyframes are located on a map that they did not make.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HoldOut {
    /// Number of keyframes that were held out.
    pub keyframes: usize,
    /// Number of those that were located.
    pub located: usize,
    /// Median distance from where the map of all keyframes has them, metres.
    pub median_m: f64,
    /// The largest distance, metres.
    pub most_m: f64,
}

/// Holds keyframes out of a finished map. `None` if the others make no map.
///
/// # Errors
/// [`SurveyError::Interrupted`].
pub fn hold_out(
    keyframes: &[Keyframe],
    facets: &[Outline],
    setup: &TrackerSetup,
    bend: Bend,
    distance_m: f64,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Result<Option<HoldOut>, SurveyError> {
    let part = |is_held: bool| -> Vec<Keyframe> {
        let chosen = keyframes.iter().enumerate().filter(move |(k, _)| (k % HELD_OUT == HELD_OUT - 1) == is_held);
        chosen.map(|(_, keyframe)| keyframe.clone()).collect()
    };
    let (held, others) = (part(true), part(false));
    let curve = CameraCurve::bent(setup.settings.transfer.unwrap_or_default(), &bend);
    let mut facets = facets.to_vec();
    let textures = textures(&views(&others, setup, &curve), &mut facets);
    let Ok(stage) = painted_stage(&setup.stage, &facets, &textures) else { return Ok(None) };
    let setup_of_others = TrackerSetup { stage, ..setup.clone() };
    let walk = Walk::of_keyframes(without_features(&others), others.len(), others.len(), bend);
    let options = SurveyOptions { keeps_flat: true, ..SurveyOptions::default() };
    let made = match survey(walk, Vec::<Vec<Frame>>::new, &setup_of_others, options, |_| (), goes_on) {
        Ok(made) => made,
        Err(SurveyError::Interrupted) => return Err(SurveyError::Interrupted),
        Err(_) => return Ok(None),
    };
    let kept = made.supported_from(setup.stage.surfaces.len(), distance_m);
    let stage = BodySpec { surfaces: kept.into_iter().map(|k| made.surfaces[k].clone()).collect(), ..setup.stage.clone() };
    if stage.surfaces.is_empty() {
        return Ok(None);
    }
    let both = made.motions.iter().zip(&others).filter_map(|(motion, keyframe)| Some([motion.as_ref()?.pose, keyframe.motion.pose]));
    let Some(fit) = Fit::of(&both.collect::<Vec<_>>(), &grid(&stage), &setup.camera) else { return Ok(None) };
    let into_whole = fit.anchoring();
    let mut locator = Locator::new(setup, &stage, distance_m);
    let mut off_m = |keyframe: &Keyframe| {
        let found = locator.pose(keyframe)?;
        Some((into_whole.pose(&found).translation - keyframe.motion.pose.translation).norm())
    };
    let mut off: Vec<f64> = held.iter().filter_map(&mut off_m).collect();
    let most_m = off.iter().copied().fold(0.0, f64::max);
    Ok(median(&mut off).map(|median_m| HoldOut { keyframes: held.len(), located: off.len(), median_m, most_m }))
}
