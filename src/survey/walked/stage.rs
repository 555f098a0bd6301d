//! The survey of a stage: takes a walk, runs the joint adjustment, and collects the results.

use nalgebra::DMatrix;

use super::adjustment::{Adjusted, Adjustment};
use super::camera_rates::rates_in;
use super::constraints::{Constraint, ConstraintCheck};
use super::lively_part::{SAME_S, corrected_shutter, shutter_of};
use super::observers::Observers;
use super::progress::{SurveyError, SurveyStep};
use super::scales::Support;
use super::stage_model::{LENS_NUMBERS, Places, StageModel};
use super::walk::Walk;
use super::ways;
use crate::camera::{CameraModel, IntrinsicsUncertainty, LensDoubt, Shutter};
use crate::frame::Frame;
use crate::geometry::{Body, Camera, Pose};
use crate::light::CameraCurve;
use crate::motion::Motion;
use crate::survey::shutter::{ShutterEstimate, ShutterTime};
use crate::track::{BodySpec, SurfaceSpec};
use crate::tracker::TrackerSetup;

/// Minimum number of keyframes. Raised, short walks are refused; lowered, shapes rest on a few
/// views.
const MIN_KEYFRAMES: usize = 8;
/// Prior of an unknown lens, one sigma: focal lengths (fraction), centre (fraction of the width),
/// k1, k2, p1, p2.
const UNKNOWN_LENS: [f64; 6] = [0.05, 0.03, 0.3, 0.3, 0.01, 0.01];
/// Maximum sigma of the readout from keyframes, seconds, for it to be used. Raised, a walk that
/// hardly moved overrides the lively part; lowered, the lively part, which assumes the lens, always
/// decides.
const VAGUE_READOUT_S: f64 = 1e-3;
/// Change of the readout, seconds, above which the stage is readjusted: a thirtieth of a pixel at a
/// metre per second and 3 m. Raised, the lens compensates for the remaining error; lowered, surveys
/// take longer for nothing.
const SAME_READOUT_S: f64 = 1e-4;
/// Relative error of a swaying camera's rates as derived from its frames (`camera_rates`), and so
/// of a readout derived from keyframes. Raised, small errors of `readout_s` stay; lowered, a
/// readout seems more certain than it is.
const SWAY_SHARE: f64 = 0.02;

/// Options of a survey.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct SurveyOptions {
    /// Whether to refine the lens and the shutter, too.
    pub refines_lens: bool,
    /// Measurements on the stage.
    pub constraints: Vec<Constraint>,
    /// Whether the surfaces are known to be flat: only their poses are estimated, with the
    /// lens as it is and without measurements.
    pub keeps_flat: bool,
}

/// The size of the stage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SizeFound {
    /// How much larger it is than `size_m` states, as a fraction.
    pub growth: f64,
    /// One sigma of the growth.
    pub sigma: f64,
}

/// The surveyed stage and lens.
#[derive(Debug)]
#[non_exhaustive]
pub struct Survey {
    /// The lens.
    pub camera: CameraModel,
    /// The shutter: as configured, except for times that the walk shows to be different.
    pub shutter: Shutter,
    /// The shutter as estimated from the walk; `None` if that was not requested.
    pub shutter_found: Option<ShutterEstimate>,
    /// The surfaces, with their poses and shapes.
    pub surfaces: Vec<SurfaceSpec>,
    /// Number of frames examined.
    pub frames: usize,
    /// Number of frames in which the stage was found.
    pub found: usize,
    /// Number of keyframes.
    pub keyframes: usize,
    /// Number of keyframes that support the result.
    pub used: usize,
    /// Root mean square residual of the tiles with the stage as configured, pixels; `None` if no
    /// keyframe could be aligned with it.
    pub configured_rms_px: Option<f64>,
    /// The same as surveyed.
    pub rms_px: f64,
    /// Median error of the camera positions with the stage as configured, relative to the surveyed
    /// stage, after removing one rigid motion of the whole walk, metres.
    pub configured_error_m: Option<f64>,
    /// The camera's poses at the keyframes that support the result.
    pub cameras: Vec<Pose<Body, Camera>>,
    /// The camera's motion at each keyframe; `None` where it does not support the result.
    pub(super) motions: Vec<Option<Motion>>,
    /// The size of the stage relative to `size_m`, if something else was measured.
    pub size: Option<SizeFound>,
    /// Each measurement compared with the result.
    pub checks: Vec<ConstraintCheck>,
    /// Robust scale of the residuals, in sigmas.
    pub scale: f64,
    /// Root mean square height of each surface that its spline does not show, metres.
    pub unmodelled_m: Vec<f64>,
    /// Robust scale of each surface's residuals, in sigmas; infinite if its tiles determine
    /// nothing.
    pub(super) scales: Vec<f64>,
    /// The support of each surface's pose.
    pub(super) supports: Vec<Support>,
    /// Whether the adjustment converged.
    pub has_settled: bool,
    /// Number of rounds of the adjustment.
    pub rounds: usize,
    /// The indices of the unknowns.
    pub(super) places: Places,
    pub(super) covariance: DMatrix<f64>,
}

/// Surveys a stage from a walk around it. `again` opens the walk's clips once more; it is only
/// called if a rolling shutter is found. `progress` receives each step. `goes_on` is called many
/// times a second from several threads, and stops the work by returning false.
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
    let Walk { keyframes, lively, frames, found, bend, .. } = walk;
    match (found, keyframes.len()) {
        (0, _) => return Err(SurveyError::NotFound { frames }),
        (_, n) if n < MIN_KEYFRAMES => return Err(SurveyError::TooFewPlaces { found: n, least: MIN_KEYFRAMES }),
        _ => {}
    }
    let model = match options.keeps_flat {
        true => StageModel::flat(camera, &stage.surfaces),
        false => StageModel::new(camera, &stage.surfaces, options.refines_lens, !options.constraints.is_empty()),
    };
    let model = model.with_readout(shutter.readout_s);
    let curve = CameraCurve::bent(setup.settings.transfer.unwrap_or_default(), &bend);
    let observers = Observers::new(keyframes, &model, shutter, &stage, (curve, mask.as_ref()), goes_on);
    let mut adjustment = Adjustment::new(observers, lens_sigmas(&camera), options.constraints).keeping_flat(options.keeps_flat);
    let mut round = 0;
    let mut report = |step| {
        // The adjustment counts the rounds of each of its runs separately.
        let is_round = matches!(step, SurveyStep::Round(_));
        progress(if is_round { SurveyStep::Round(round) } else { step });
        round += usize::from(is_round);
    };
    let mut adjusted = adjustment.run(model, |n| report(SurveyStep::Round(n)));
    if let Some(before) = adjusted.as_ref().filter(|before| options.refines_lens && rolls(before)) {
        let rates = rates_in(again(), surveyed_setup(&before.model, setup), |n| report(SurveyStep::Again(n)), goes_on);
        adjusted = adjustment.run_with_rates(before.model.clone(), &rates, shutter.exposure_s, |n| report(SurveyStep::Round(n)));
    }
    let mut shutter_found = None;
    if let Some(before) = adjusted.as_ref().filter(|_| options.refines_lens) {
        let lively = shutter_of(&lively, surveyed_setup(&before.model, setup), goes_on);
        let found = shutter_of_walk(before, lively.filter(|found| found.has_settled));
        shutter = corrected_shutter(shutter, &found);
        shutter_found = Some(found);
        let is_another =
            shutter.exposure_s != configured.exposure_s || (shutter.readout_s - before.model.readout_s()).abs() > SAME_READOUT_S;
        if is_another {
            adjusted = adjustment.run_with_shutter(before.model.clone(), shutter, |n| report(SurveyStep::Round(n)));
        }
    }
    let Some(Adjusted {
        model,
        frames: observed,
        scale,
        scales,
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
    let unmodelled_m = adjustment.unmodelled_m(&model).ok_or(SurveyError::Interrupted)?;
    tracing::debug!(?unmodelled_m, "heights that the splines do not show");
    let covariance = match model.places().readout {
        Some(at) if shutter.readout_s != configured.readout_s => with_sway(covariance, at, SWAY_SHARE * model.readout_s()),
        _ => covariance,
    };
    let (keyframes, used) = (observed.len(), observed.iter().flatten().count());
    let cameras = observed.iter().flatten().map(|f| f.motion.pose).collect();
    let motions = observed.iter().map(|frame| frame.as_ref().map(|frame| frame.motion)).collect();
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
        motions,
        rms_px,
        scale,
        unmodelled_m,
        scales,
        supports,
        has_settled,
        rounds,
        places,
        covariance,
    })
}

/// Whether the keyframes show a rolling shutter.
fn rolls(adjusted: &Adjusted) -> bool {
    adjusted.tells_readout && adjusted.model.readout_s().abs() > SAME_S
}

/// Returns a tracker's setup with the stage, the lens and the readout of a model.
fn surveyed_setup(model: &StageModel, setup: &TrackerSetup) -> TrackerSetup {
    let stage = BodySpec { surfaces: model.surfaces.clone(), ..setup.stage.clone() };
    let shutter = Shutter { readout_s: model.readout_s(), ..setup.shutter.or_zero() }.into();
    TrackerSetup { camera: model.camera, stage, shutter, ..setup.clone() }
}

/// Combines the estimates of the shutter: the readout from the keyframes, which are adjusted
/// jointly with the lens, or, if they do not determine it, from the lively part, which also gives
/// the exposure.
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

/// Adds one more sigma of error in unknown `at` to a covariance, including everything correlated
/// with it.
fn with_sway(covariance: DMatrix<f64>, at: usize, sigma: f64) -> DMatrix<f64> {
    let variance = covariance[(at, at)];
    if variance <= 0.0 {
        return covariance;
    }
    let by_unknown = covariance.column(at) / variance;
    &covariance + &by_unknown * by_unknown.transpose() * sigma.powi(2)
}

/// Returns 3 sigma of the refined lens; `None` if it was not refined.
fn lens_doubt(places: &Places, covariance: &DMatrix<f64>) -> Option<LensDoubt> {
    let at = places.lens?;
    let [fx, fy, cx, cy, k1, k2, p1, p2] = std::array::from_fn(|k| 3.0 * covariance[(at + k, at + k)].max(0.0).sqrt());
    let uncertainty = IntrinsicsUncertainty { focal_px: [fx, fy], centre_px: [cx, cy], skew: 0.0, distortion: [k1, k2, p1, p2, 0.0] };
    LensDoubt::of_calibration(Some(uncertainty))
}

/// Returns the prior of the lens, one sigma, in the order of the model's parameters.
fn lens_sigmas(camera: &CameraModel) -> [f64; LENS_NUMBERS] {
    let i = camera.intrinsics();
    let [focal, centre, k1, k2, p1, p2] = UNKNOWN_LENS;
    let width = f64::from(i.width);
    [focal * i.fx, focal * i.fy, centre * width, centre * width, k1, k2, p1, p2]
}
