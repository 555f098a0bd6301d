//! The survey of a stage: a walk, the joint adjustment, and what came of it.

use nalgebra::DMatrix;

use super::adjustment::{Adjusted, Adjustment};
use super::camera_rates::rates_in;
use super::constraints::{Constraint, ConstraintCheck};
use super::lively_part::{SAME_S, mended, shutter_of};
use super::observers::Observers;
use super::progress::{SurveyError, SurveyStep};
use super::scales::Support;
use super::shutter::{ShutterEstimate, ShutterTime};
use super::stage_model::{LENS_NUMBERS, Places, StageModel};
use super::walk::Walk;
use super::ways;
use crate::camera::{CameraModel, IntrinsicsUncertainty, LensDoubt, Shutter};
use crate::frame::Frame;
use crate::geometry::{Body, Camera, Pose};
use crate::track::{BodySpec, SurfaceSpec};
use crate::tracker::TrackerSetup;

/// Fewest keyframes that a survey is made from. Raised, short walks are refused; lowered, shapes rest on a few views.
const LEAST_KEYFRAMES: usize = 8;
/// One sigma of a lens that nothing is known of: of the focal lengths (share), the centre (share of the width), k1, k2, p1, p2.
const UNKNOWN_LENS: [f64; 6] = [0.05, 0.03, 0.3, 0.3, 0.01, 0.01];
/// Keyframes that know the readout no better than this, one sigma, seconds, do not tell it. Raised, a walk that hardly moved speaks for the lively part;
/// lowered, that one, which takes the lens for granted, speaks for all.
const VAGUE_READOUT_S: f64 = 1e-3;
/// The stage is adjusted anew where the readout is another one than it was adjusted with by more than this, seconds: at a metre a second and 3 m a thirtieth of a
/// pixel. Raised, the lens makes up for what is left; lowered, surveys take longer for nothing.
const SAME_READOUT_S: f64 = 1e-4;
/// How far the rates of a camera that sways are from those that its frames tell (`camera_rates`), as a share, and so a readout from what keyframes say. Raised, small
/// slips of `readout_s` stay; lowered, a readout is believed to be known better than it is.
const SWAY_SHARE: f64 = 0.02;

/// What to find.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct SurveyOptions {
    /// Whether the lens and the shutter are found as well.
    pub refines_lens: bool,
    /// What was measured on the stage.
    pub constraints: Vec<Constraint>,
}

/// How large a stage is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SizeFound {
    /// By how much it is larger than `size_m` says, as a share.
    pub growth: f64,
    /// One sigma of that.
    pub sigma: f64,
}

/// The stage as it hangs and the lens as it is.
#[derive(Debug)]
#[non_exhaustive]
pub struct Survey {
    /// The lens.
    pub camera: CameraModel,
    /// The shutter: as told, but for the times that the walk shows to be others.
    pub shutter: Shutter,
    /// What the walk says of the shutter; `None` where that was not asked, or no part of it is long enough.
    pub shutter_found: Option<ShutterEstimate>,
    /// The surfaces, with their poses and shapes.
    pub surfaces: Vec<SurfaceSpec>,
    /// Frames looked at, and those in which the stage was found.
    pub frames: usize,
    /// See `frames`.
    pub found: usize,
    /// Keyframes, and those that bear the result out.
    pub keyframes: usize,
    /// See `keyframes`.
    pub used: usize,
    /// Root mean square residual of the tiles with the stage as configured, pixels; `None` where no keyframe could be aligned with it.
    pub configured_rms_px: Option<f64>,
    /// The same as surveyed.
    pub rms_px: f64,
    /// How far the stage as configured puts the camera beside the stage as surveyed, once one rigid motion of the whole walk is taken away: the median,
    /// metres.
    pub configured_error_m: Option<f64>,
    /// Where the camera was at the keyframes that bear the result out.
    pub cameras: Vec<Pose<Body, Camera>>,
    /// How large the stage is beside what `size_m` says, where something else was measured.
    pub size: Option<SizeFound>,
    /// Each measurement beside what was found.
    pub checks: Vec<ConstraintCheck>,
    /// Robust scale of the residuals, in sigmas.
    pub scale: f64,
    /// What each surface's place rests on.
    pub(super) supports: Vec<Support>,
    /// Whether the adjustment came to rest.
    pub has_settled: bool,
    /// Rounds of the adjustment.
    pub rounds: usize,
    /// Where the unknown numbers are.
    pub(super) places: Places,
    pub(super) covariance: DMatrix<f64>,
}

/// Surveys a stage from a walk around it. `again` opens the walk's clips once more; it is only asked where rows are found to be read one after the other. `progress`
/// hears what is done; `goes_on` is asked many times a second, by several threads, and ends the work with false.
///
/// # Errors
/// See [`SurveyError`].
pub fn survey<C, F>(
    walk: Walk,
    again: impl FnOnce() -> C,
    setup: &TrackerSetup,
    options: SurveyOptions,
    mut progress: impl FnMut(SurveyStep),
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Result<Survey, SurveyError>
where
    C: IntoIterator<Item = F>,
    F: IntoIterator<Item = Frame>,
{
    let TrackerSetup { camera, mask, stage, .. } = setup.clone();
    let configured = setup.shutter.or_zero();
    let mut shutter = configured;
    let Walk { keyframes, lively, frames, found } = walk;
    match (found, keyframes.len()) {
        (0, _) => return Err(SurveyError::NotFound { frames }),
        (_, n) if n < LEAST_KEYFRAMES => return Err(SurveyError::TooFewPlaces { found: n, least: LEAST_KEYFRAMES }),
        _ => {}
    }
    let model =
        StageModel::new(camera, &stage.surfaces, options.refines_lens, !options.constraints.is_empty()).with_readout(shutter.readout_s);
    let observers = Observers::new(keyframes, &model, shutter, &stage, mask.as_ref(), goes_on);
    let mut adjustment = Adjustment::new(observers, lens_sigmas(&camera), options.constraints);
    let mut round = 0;
    let mut hear = |step| {
        // The adjustment counts the rounds of each of its runs.
        let is_round = matches!(step, SurveyStep::Round(_));
        progress(if is_round { SurveyStep::Round(round) } else { step });
        round += usize::from(is_round);
    };
    let mut adjusted = adjustment.run(model, |n| hear(SurveyStep::Round(n)));
    if let Some(before) = adjusted.as_ref().filter(|before| options.refines_lens && rolls(before)) {
        let rates = rates_in(again(), surveyed_setup(&before.model, setup), |n| hear(SurveyStep::Again(n)), goes_on);
        adjusted = adjustment.run_with_rates(before.model.clone(), &rates, shutter.exposure_s, |n| hear(SurveyStep::Round(n)));
    }
    let mut shutter_found = None;
    if let Some(before) = adjusted.as_ref().filter(|_| options.refines_lens) {
        let lively = shutter_of(&lively, surveyed_setup(&before.model, setup), goes_on);
        let found = shutter_of_walk(before, lively.filter(|found| found.has_settled));
        shutter = mended(shutter, &found);
        shutter_found = Some(found);
        let is_another =
            shutter.exposure_s != configured.exposure_s || (shutter.readout_s - before.model.readout_s()).abs() > SAME_READOUT_S;
        if is_another {
            adjusted = adjustment.run_with_shutter(before.model.clone(), shutter, |n| hear(SurveyStep::Round(n)));
        }
    }
    let Some(Adjusted {
        model,
        frames: observed,
        scale,
        supports,
        start_rms_px,
        rms_px,
        start_error_m,
        checks,
        covariance,
        equations,
        rounds,
        has_settled,
        ..
    }) = adjusted
    else {
        return Err(if !goes_on() { SurveyError::Interrupted } else { SurveyError::Undetermined });
    };
    let covariance = match model.places().readout {
        Some(at) if shutter.readout_s != configured.readout_s => with_sway(covariance, at, SWAY_SHARE * model.readout_s()),
        _ => covariance,
    };
    let (keyframes, used) = (observed.len(), observed.iter().flatten().count());
    let cameras = observed.iter().flatten().map(|f| f.motion.pose).collect();
    let places = model.places().clone();
    let size = places.size.map(|at| SizeFound { growth: model.growth(), sigma: covariance[(at, at)].max(0.0).sqrt() });
    let camera = model.camera.with_doubt(lens_doubt(&places, &covariance).or(camera.doubt()));
    let surfaces = ways::with_ways(&model, &covariance, &equations);
    Ok(Survey {
        camera,
        shutter,
        shutter_found,
        surfaces,
        size,
        checks,
        frames,
        found,
        keyframes,
        used,
        configured_rms_px: start_rms_px,
        configured_error_m: start_error_m,
        cameras,
        rms_px,
        scale,
        supports,
        has_settled,
        rounds,
        places,
        covariance,
    })
}

/// Whether the keyframes show rows that are read one after the other.
fn rolls(adjusted: &Adjusted) -> bool {
    adjusted.tells_readout && adjusted.model.readout_s().abs() > SAME_S
}

/// A tracker's setup with the stage, the lens and the readout of a model.
fn surveyed_setup(model: &StageModel, setup: &TrackerSetup) -> TrackerSetup {
    let stage = BodySpec { surfaces: model.surfaces.clone(), ..setup.stage.clone() };
    let shutter = Shutter { readout_s: model.readout_s(), ..setup.shutter.or_zero() }.into();
    TrackerSetup { camera: model.camera, stage, shutter, ..setup.clone() }
}

/// What a walk says of the shutter: the readout by the keyframes, which are adjusted together with the lens that it bends, or, where these do not tell it, by the
/// lively part, which tells the exposure.
fn shutter_of_walk(adjusted: &Adjusted, lively: Option<ShutterEstimate>) -> ShutterEstimate {
    let (frames, aligned) = (adjusted.frames.len(), adjusted.frames.iter().flatten().count());
    let by_keyframes = adjusted.model.places().readout.filter(|_| adjusted.tells_readout).and_then(|at| {
        let (seconds, sigma_s) = (adjusted.model.readout_s(), adjusted.covariance[(at, at)].max(0.0).sqrt());
        let sigma_s = (sigma_s < VAGUE_READOUT_S).then(|| sigma_s.hypot(SWAY_SHARE * seconds))?;
        Some(ShutterTime { seconds, sigma_s, frames: aligned })
    });
    let nothing = ShutterEstimate { readout: None, exposure: None, frames, aligned, has_settled: true };
    let lively = lively.unwrap_or(nothing);
    ShutterEstimate { readout: by_keyframes.or(lively.readout), ..lively }
}

/// Adds to a covariance that unknown `at` is off by one more sigma, and with it all that it goes with.
fn with_sway(covariance: DMatrix<f64>, at: usize, sigma: f64) -> DMatrix<f64> {
    let variance = covariance[(at, at)];
    if variance <= 0.0 {
        return covariance;
    }
    let by_unknown = covariance.column(at) / variance;
    &covariance + &by_unknown * by_unknown.transpose() * sigma.powi(2)
}

/// 3 sigma of the lens that was found; none where it was kept.
fn lens_doubt(places: &Places, covariance: &DMatrix<f64>) -> Option<LensDoubt> {
    let at = places.lens?;
    let [fx, fy, cx, cy, k1, k2, p1, p2] = std::array::from_fn(|k| 3.0 * covariance[(at + k, at + k)].max(0.0).sqrt());
    let uncertainty = IntrinsicsUncertainty { focal_px: [fx, fy], centre_px: [cx, cy], skew: 0.0, distortion: [k1, k2, p1, p2, 0.0] };
    LensDoubt::of_calibration(Some(uncertainty))
}

/// How far a lens may be from what is known of it, one sigma, in the order of the model's numbers.
fn lens_sigmas(camera: &CameraModel) -> [f64; LENS_NUMBERS] {
    let i = camera.intrinsics();
    let [focal, centre, k1, k2, p1, p2] = UNKNOWN_LENS;
    let width = f64::from(i.width);
    [focal * i.fx, focal * i.fy, centre * width, centre * width, k1, k2, p1, p2]
}
