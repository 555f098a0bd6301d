//! What a clip says about the camera's shutter, with the lines for the config.

use std::path::Path;

use crate::camera::Shutter;
use crate::capture::{ClipOptions, EntryContent, FrameSource, open_clip};
use crate::cli::failure::Failure;
use crate::cli::replay::progress::Progress;
use crate::cli::replay::tracker_setup;
use crate::config::Settings;
use crate::frame::Frame;
use crate::survey::shutter::{MAX_FRAMES, ShutterEstimate, ShutterTime, estimate_shutter};
use crate::tracker::{Tracker, TrackerSetup};

/// A time whose sigma exceeds both of these is not printed: seconds, and as a share of the time.
/// Chosen, not tuned. Raised, configs get times that are worse than none.
const MAX_SIGMA_S: f64 = 0.001;
const MAX_SHARE: f64 = 0.15;
/// Shortest readout of a rolling shutter, seconds; no sensor is faster. A shorter estimate is a
/// global shutter's with a small error. Raised, fast rolling shutters are taken for global;
/// lowered, global ones for rolling.
const FASTEST_READOUT_S: f64 = 5e-4;

/// Estimates the shutter from the clip, or says why that is impossible.
pub(super) fn estimate(settings: &Settings, clip: &Path, fps: Option<f64>) -> Result<Result<ShutterEstimate, &'static str>, Failure> {
    if clip == Path::new("-") {
        return Ok(Err("not estimated: a clip from standard input cannot be read twice; save it to a file"));
    }
    let progress = Progress::start(None);
    let calibrated = settings.lens.size(&settings.camera);
    let open = || open_clip(clip, ClipOptions { fps, calibrated, ..ClipOptions::default() }).map_err(Failure::from);
    let source = open()?;
    if source.doubt_of_stamps().is_some() {
        return Ok(Err("not estimated: the clip's stamps are implausible; see above"));
    }
    let setup = tracker_setup(settings, source.size(), None)?;
    let tracker = Tracker::new(TrackerSetup { shutter: Default::default(), objects: Vec::new(), ..setup }.as_trial())?;
    let estimate = estimate_shutter(|| open().map(|source| frames(source, progress.clone())), tracker);
    progress.finish();
    estimate.map(Ok)
}

/// Returns the report's lines.
pub(super) fn lines(settings: &Settings, clip: &Path, fps: Option<f64>) -> Result<Vec<String>, Failure> {
    Ok(estimate(settings, clip, fps)?.map_or_else(|why| vec![why.to_owned()], |estimate| describe(&estimate, settings)))
}

/// Returns a shutter to try: the estimated one, if it is a rolling one read from the top down and
/// differs from the configured one. The readout's sigma matters only when it is written into a
/// config.
pub(super) fn other_than(configured: &Shutter, estimate: &ShutterEstimate) -> Option<Shutter> {
    let ShutterTime { seconds, .. } = estimate.readout.filter(|time| time.seconds > FASTEST_READOUT_S)?;
    let exposure = estimate.exposure.filter(is_known).filter(|time| !is_same(configured.exposure_s, time.seconds, time.sigma_s));
    let exposure_s = exposure.map_or(configured.exposure_s, |time| time.seconds);
    let is_other = (configured.readout_s - seconds).abs() > 0.05 * seconds;
    is_other.then_some(Shutter { readout_s: seconds, exposure_s })
}

/// Returns a clip's frames and counts them on the terminal, pass after pass.
fn frames(mut source: Box<dyn FrameSource>, progress: Progress) -> impl Iterator<Item = Frame> {
    let rows = std::iter::from_fn(move || {
        progress.advance();
        source.next_entry()
    });
    rows.filter_map(|row| match row.content {
        EntryContent::Frame(frame) => Some(frame),
        _ => None,
    })
}

/// Describes the estimate in words.
pub(super) fn describe(estimate: &ShutterEstimate, settings: &Settings) -> Vec<String> {
    let ShutterEstimate { frames, aligned, .. } = estimate;
    let mut lines = vec![format!("from the clip's first {frames} frames (of {MAX_FRAMES} at most), the stage was followed in {aligned}")];
    if !estimate.has_settled && [estimate.readout, estimate.exposure].iter().flatten().any(is_known) {
        lines.push("the estimate did not converge: treat the times below as a hint".to_owned());
    }
    lines.push(readout(estimate.readout, settings.shutter.or_zero().readout_s));
    lines.push(exposure(estimate.exposure, settings.shutter.or_zero().exposure_s));
    lines
}

/// Whether a time is known well enough to be written into a config.
fn is_known(time: &ShutterTime) -> bool {
    time.sigma_s < MAX_SIGMA_S.max(MAX_SHARE * time.seconds.abs())
}

fn readout(found: Option<ShutterTime>, configured_s: f64) -> String {
    let Some(time) = found.filter(is_known) else {
        return "readout: this clip does not determine it; shake the camera by hand for five seconds, a few times a second, and calibrate \
                it well"
            .to_owned();
    };
    let ShutterTime { seconds, sigma_s, frames } = time;
    let measured = format!("readout: {:.2} ms +- {:.2} (3 sigma, from {frames} frames)", seconds * 1e3, 3e3 * sigma_s);
    if seconds < -(3.0 * sigma_s).max(FASTEST_READOUT_S) {
        return format!("{measured}: rows are read from the bottom up; turn the camera's picture upright in its driver, not after");
    }
    if seconds < (3.0 * sigma_s).max(FASTEST_READOUT_S) {
        return format!("{measured}, which means a global shutter: readout_s = 0.0{}", kept(configured_s, 0.0, sigma_s));
    }
    format!("{measured}: readout_s = {seconds:.5}{}", kept(configured_s, seconds, sigma_s))
}

fn exposure(found: Option<ShutterTime>, configured_s: f64) -> String {
    let Some(time) = found.filter(is_known) else {
        return "exposure: the clip's frames are not blurred enough to tell; leave exposure_s = 0, or shake the camera harder".to_owned();
    };
    let ShutterTime { seconds, sigma_s, frames } = time;
    let measured = format!("exposure: {:.2} ms +- {:.2} (3 sigma of the scatter of {frames} frames)", seconds * 1e3, 3e3 * sigma_s);
    format!("{measured}: exposure_s = {seconds:.5}{}", kept(configured_s, seconds, sigma_s))
}

/// Whether the config already has the estimated time.
fn is_same(configured_s: f64, found_s: f64, sigma_s: f64) -> bool {
    (configured_s - found_s).abs() <= (3.0 * sigma_s).max(0.05 * found_s)
}

/// Describes how an estimate compares with the config.
fn kept(configured_s: f64, found_s: f64, sigma_s: f64) -> &'static str {
    if is_same(configured_s, found_s, sigma_s) { ", as the config has it" } else { " belongs below [camera] in the config" }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time(seconds: f64, sigma_s: f64) -> Option<ShutterTime> {
        Some(ShutterTime { seconds, sigma_s, frames: 50 })
    }

    #[test]
    fn a_clear_readout_prints_the_config_line() {
        let line = readout(time(0.01523, 1e-4), 0.0);
        assert!(line.contains("15.23 ms +- 0.30") && line.contains("readout_s = 0.01523 belongs"), "{line}");
        assert!(readout(time(0.01523, 1e-4), 0.0152).ends_with("as the config has it"));
    }

    #[test]
    fn only_an_unconfigured_rolling_shutter_is_tried() {
        let found = |readout, exposure| ShutterEstimate { readout, exposure, frames: 50, aligned: 50, has_settled: true };
        let unset = Shutter::default();
        let both = found(time(0.012, 1e-4), time(0.008, 1e-4));
        assert_eq!(other_than(&unset, &both), Some(Shutter { readout_s: 0.012, exposure_s: 0.008 }));
        assert_eq!(other_than(&unset, &found(time(0.012, 1e-4), None)), Some(Shutter { readout_s: 0.012, exposure_s: 0.0 }));
        assert_eq!(other_than(&Shutter { readout_s: 0.0121, exposure_s: 0.0 }, &both), None);
        assert!(other_than(&unset, &found(time(0.012, 0.01), None)).is_some(), "it is only tried");
        for global in [None, time(1e-4, 1e-5), time(-0.012, 1e-4)] {
            assert_eq!(other_than(&unset, &found(global, None)), None, "{global:?}");
        }
    }

    #[test]
    fn a_global_shutter_is_reported_as_global() {
        assert!(readout(time(1e-4, 1e-4), 0.0).contains("readout_s = 0.0, as the config has it"));
        assert!(readout(time(1e-4, 1e-5), 0.0).contains("global shutter"));
        assert!(readout(time(-1e-4, 1e-5), 0.0).contains("global shutter"));
    }

    #[test]
    fn an_undetermined_shutter_is_reported_with_a_hint() {
        assert!(readout(None, 0.0).contains("shake the camera"));
        assert!(readout(time(0.004, 0.003), 0.0).contains("shake the camera"));
        assert!(exposure(None, 0.0).contains("leave exposure_s = 0"));
        assert!(readout(time(-0.01, 1e-4), 0.0).contains("bottom up"));
    }
}
