//! Estimates the shutter from a shaken clip: the readout time of the sensor's rows, and the
//! exposure time.
//!
//! The clip is tracked several times. In each pass the shutter is assumed known, and every aligned
//! frame yields the change of readout with which its rows would fit better, all else being free,
//! and the change of exposure with which its blur would fit better. These changes are averaged
//! robustly and applied, until nothing moves. The disagreement between frames gives the result's
//! sigma.

use crate::camera::Shutter;
use crate::frame::{Frame, Timestamp};
use crate::track::agreement::{Agreement, AgreementBuffers, FrameValue};
use crate::track::{BodyTracker, Clue, TUNING};
use crate::tracker::Tracker;

/// Maximum number of frames used, from the clip's start: eight seconds at 30 per second. Raised,
/// every pass takes longer for a sigma that only falls with the root.
pub const MAX_FRAMES: usize = 240;
/// Maximum number of passes: the readout moves by up to a fifth of the frame interval in each, so
/// five reach its bound. Raised, clips that do not converge take longer; lowered, fewer converge.
const MAX_PASSES: usize = 12;
/// Start: a global shutter and a typical exposure, seconds. From there the readout is found in
/// either direction; a farther start takes more passes.
const FIRST: Shutter = Shutter { readout_s: 0.0, exposure_s: 0.004 };
/// Minimum exposure, seconds: a picture that moves by 1000 pixels per second smears by 0.3. Raised,
/// short exposures are overestimated; lowered, an exposure without visible blur keeps shrinking
/// pass after pass.
const MIN_EXPOSURE_S: f64 = 3e-4;
/// Maximum change per pass: of the readout as a fraction of the frame interval, of the exposure as
/// a fraction of itself. The frames' answers are only valid for small changes. Raised, the estimate
/// may oscillate; lowered, it takes more passes.
const MAX_READOUT_STEP: f64 = 0.2;
const MAX_EXPOSURE_STEP: f64 = 0.4;
/// Changes below which the estimate has converged: seconds of readout (or a tenth of its sigma),
/// and fraction of the exposure. Raised, it ends farther from its limit; lowered, it may not end
/// before the last pass.
const SMALL_READOUT_STEP_S: f64 = 2e-5;
const SMALL_EXPOSURE_STEP: f64 = 0.01;
/// Minimum visible fraction of a readout change: velocities learnt from frames with a wrong readout
/// hide part of the error. Lowered, one noisy pass may ask for a huge step; raised, each pass
/// compensates less for what is hidden.
const MIN_SLOPE: f64 = 0.25;
/// Sigma of a frame's own answer on the exposure, as a fraction of it, above which the frame is
/// ignored. Raised, still frames count, which only show the model's errors; lowered, slow clips
/// give no result.
const VAGUE_EXPOSURE: f64 = 1.0;
/// A time and its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ShutterTime {
    /// Seconds. A readout is negative if the rows are read from the bottom up.
    pub seconds: f64,
    /// One standard deviation, seconds.
    pub sigma_s: f64,
    /// Number of informative frames.
    pub frames: usize,
}

/// The estimated shutter.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ShutterEstimate {
    /// First row to last; `None` if too few frames move, or if it would last longer than a frame.
    pub readout: Option<ShutterTime>,
    /// `None` if too few frames are blurred.
    pub exposure: Option<ShutterTime>,
    /// Number of frames used.
    pub frames: usize,
    /// Number of frames in which the stage was aligned, in the last pass.
    pub aligned: usize,
    /// Whether the estimate converged.
    pub has_settled: bool,
}

/// The frames' answers in one pass, in order.
#[derive(Default)]
struct Pass {
    readout: Vec<Clue>,
    /// Speeds in the same frames, pixels per second.
    speeds: Vec<f64>,
    exposure: Vec<Clue>,
    frames: usize,
    aligned: usize,
    first: Option<Timestamp>,
    last: Timestamp,
}

impl Pass {
    /// Tracks the clip's first frames with an assumed shutter.
    fn over(clip: impl IntoIterator<Item = Frame>, matcher: &mut BodyTracker, shutter: Shutter) -> Self {
        matcher.study().ask_shutter(shutter);
        let mut pass = Self::default();
        for frame in clip.into_iter().take(MAX_FRAMES) {
            pass.frames += 1;
            pass.first.get_or_insert(frame.timestamp);
            pass.last = frame.timestamp;
            matcher.track_frame(&frame);
            let Some(clue) = matcher.study().shutter_clue() else { continue };
            pass.aligned += 1;
            pass.readout.push(clue.readout.clue);
            pass.speeds.push(clue.speed_px_s);
            pass.exposure.extend(clue.exposure);
        }
        pass
    }

    /// Returns the error of the readout caused by model errors, one sigma, seconds.
    fn readout_by_model_s(&self) -> f64 {
        let telling =
            self.readout.iter().zip(&self.speeds).filter(|(clue, _)| clue.information > TUNING.body.max_vague_readout_sigma_s.powi(-2));
        let speed_px_s = weighted_median(telling.map(|(_, speed)| (*speed, 1.0)));
        TUNING.body.row_model_error_px / speed_px_s.max(f64::MIN_POSITIVE)
    }

    /// Returns the mean time between frames, seconds.
    fn interval_s(&self) -> f64 {
        self.first.map_or(0.0, |first| self.last.seconds_since(first)) / self.frames.saturating_sub(1).max(1) as f64
    }
}

/// Estimates readout and exposure. `open` returns the clip from its start each time it is called.
/// The tracker should have only the stage and no shutter, since trial shutters are set on it.
///
/// # Errors
/// Those of `open`.
pub fn estimate_shutter<I, E>(mut open: impl FnMut() -> Result<I, E>, tracker: Tracker) -> Result<ShutterEstimate, E>
where
    I: IntoIterator<Item = Frame>,
{
    let mut matcher = tracker.matcher;
    let mut shutter = FIRST;
    let mut before: Option<(f64, f64)> = None;
    let mut slope = 1.0;
    let mut estimate = ShutterEstimate { readout: None, exposure: None, frames: 0, aligned: 0, has_settled: false };
    for pass in 0..MAX_PASSES {
        let found = Pass::over(open()?, &mut matcher, shutter);
        let interval_s = found.interval_s();
        let readout = agreed(&found.readout, TUNING.body.max_vague_readout_sigma_s);
        let exposure = agreed(&found.exposure, VAGUE_EXPOSURE);
        // The visible fraction of a change, from the answers at two shutters.
        if let (Some(r), Some((then_s, previous))) = (readout, before.filter(|(then_s, _)| (shutter.readout_s - then_s).abs() > 2e-4)) {
            slope = ((previous - r.value) / (shutter.readout_s - then_s)).clamp(MIN_SLOPE, 1.5);
        }
        before = readout.map(|r| (shutter.readout_s, r.value));
        let most = MAX_READOUT_STEP * interval_s;
        let step_s = readout.map_or(0.0, |r| (r.value / slope).clamp(-most, most));
        let step = exposure.map_or(0.0, |e| e.value.clamp(-MAX_EXPOSURE_STEP, MAX_EXPOSURE_STEP));
        tracing::debug!(pass, shutter.readout_s, shutter.exposure_s, ?readout, ?exposure, slope, aligned = found.aligned);
        shutter.readout_s = (shutter.readout_s + step_s).clamp(-interval_s, interval_s);
        shutter.exposure_s = (shutter.exposure_s * (1.0 + step)).clamp(MIN_EXPOSURE_S, interval_s.max(MIN_EXPOSURE_S));
        estimate = ShutterEstimate {
            // At its bound it fits nothing: the rows disagree for another reason (a poor
            // calibration, a picture that bends).
            readout: readout.filter(|_| shutter.readout_s.abs() < interval_s).map(|r| ShutterTime {
                seconds: shutter.readout_s,
                sigma_s: (r.sigma / slope).hypot(found.readout_by_model_s()),
                frames: r.frames,
            }),
            exposure: exposure.map(|e| ShutterTime {
                seconds: shutter.exposure_s,
                sigma_s: e.sigma * shutter.exposure_s,
                frames: e.frames,
            }),
            frames: found.frames,
            aligned: found.aligned,
            has_settled: step_s.abs() < SMALL_READOUT_STEP_S.max(0.1 * readout.map_or(0.0, |r| r.sigma))
                && step.abs() < SMALL_EXPOSURE_STEP,
        };
        // Frames that determine neither will not do so in another pass.
        let is_estimated = readout.is_some() || exposure.is_some();
        if estimate.has_settled && (pass > 0 || !is_estimated) {
            break;
        }
    }
    Ok(estimate)
}

/// Returns the change on which the frames agree; `None` if too few know it to `vague` (one sigma).
fn agreed(clues: &[Clue], vague: f64) -> Option<Agreement> {
    let tells = |c: &&Clue| c.information > vague.powi(-2) && c.score.is_finite();
    let said: Vec<FrameValue> = clues.iter().filter(tells).map(|c| FrameValue::new(c.score / c.information, 1.0 / c.information)).collect();
    agreement(&said)
}

/// Returns the robust mean of what frames say, in order; `None` for fewer than
/// `min_agreement_frames`.
fn agreement(said: &[FrameValue]) -> Option<Agreement> {
    (said.len() >= TUNING.body.min_agreement_frames).then(|| AgreementBuffers::default().agreement(said))
}

/// Returns the weighted median of (value, weight) pairs; 0 if there are none.
fn weighted_median(values: impl Iterator<Item = (f64, f64)>) -> f64 {
    AgreementBuffers::default().weighted_median(values)
}

#[cfg(all(test, feature = "simulate"))]
mod tests {
    use std::convert::Infallible;

    use nalgebra::Vector3;

    use super::*;
    use crate::simulate::{Dolly, Renderer, Shake, Spline, VirtualStage, dolly};
    use crate::tracker::TrackerSetup;

    /// The estimate from two seconds of a rendered scene.
    fn estimate_of(scene: &VirtualStage) -> ShutterEstimate {
        let renderer = Renderer::new(scene.clone());
        let frame = |k: u64| {
            let timestamp = Timestamp::from_seconds(k as f64 / 30.0);
            Frame { image: renderer.render(timestamp.seconds(), k), timestamp, sequence: k }
        };
        let frames: Vec<Frame> = (0..60).map(frame).collect();
        let tracker = Tracker::new(TrackerSetup::new(scene.camera, scene.stage.clone())).unwrap();
        estimate_shutter(|| Ok::<_, Infallible>(frames.clone()), tracker).unwrap()
    }

    fn scene(shake: Option<Shake>, exposure_s: f64) -> VirtualStage {
        let mut scene = dolly(Dolly { width: 480, height: 360, seed: 3, duration_s: 2.5, artwork_width: 1200 }).unwrap();
        scene.camera_path.shake = shake;
        (scene.shutter.readout_s, scene.shutter.exposure_s) = (0.012, exposure_s);
        scene
    }

    #[test]
    fn a_shaken_clip_determines_the_readout() {
        let found = estimate_of(&scene(Some(Shake::new(0.02, 0.02, 6.0, 3)), 0.008));
        let readout = found.readout.unwrap();
        assert!((readout.seconds - 0.012).abs() < 3e-4, "{found:?}");
        // The picture is small, and moves by some 200 pixels per second: model errors alone
        // contribute a quarter of a millisecond.
        assert!(readout.frames > 30 && readout.sigma_s < 3.5e-4, "{found:?}");
    }

    #[test]
    fn a_still_clip_determines_no_shutter_time() {
        let mut still = scene(None, 0.008);
        still.camera_path.position = Spline::fixed(Vector3::new(0.3, -3.5, 0.1));
        still.camera_path.target = Spline::fixed(Vector3::zeros());
        let found = estimate_of(&still);
        assert!(found.aligned > 50 && found.readout.is_none() && found.exposure.is_none(), "{found:?}");
    }

    fn clue(change: f64, sigma: f64) -> Clue {
        Clue { score: change / (sigma * sigma), information: sigma.powi(-2) }
    }

    #[test]
    fn precise_frames_outweigh_strays_in_the_estimate() {
        let mut clues: Vec<Clue> = (0..40).map(|k| clue(0.003 + 1e-4 * f64::from(k % 5 - 2), 2e-4)).collect();
        clues.extend((0..10).map(|_| clue(0.03, 2e-4)));
        clues.extend((0..100).map(|_| clue(-0.2, 0.05)));
        let found = agreed(&clues, TUNING.body.max_vague_readout_sigma_s).unwrap();
        assert!((found.value - 0.003).abs() < 2e-4, "{found:?}");
        assert!(found.sigma < 3e-4, "{found:?}");
        assert_eq!(found.frames, 50);
    }

    #[test]
    fn too_few_precise_frames_yield_no_estimate() {
        let mut clues = vec![clue(0.003, 1e-4); TUNING.body.min_agreement_frames - 1];
        clues.extend(vec![clue(0.003, 0.1); 100]);
        assert_eq!(agreed(&clues, TUNING.body.max_vague_readout_sigma_s), None);
    }

    #[test]
    fn the_weighted_median_splits_the_weight_in_half() {
        assert_eq!(weighted_median([(3.0, 1.0), (1.0, 1.0), (2.0, 5.0)].into_iter()), 2.0);
        assert_eq!(weighted_median(std::iter::empty()), 0.0);
    }
}
