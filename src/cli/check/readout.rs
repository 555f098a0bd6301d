//! Tries whether a readout time explains a clip, before a lens, shape or layout is blamed.

use std::path::Path;

use super::pass::{Pass, WARNING_SHARE};
use super::shutter;
use crate::camera::{KnownShutter, Shutter};
use crate::cli::failure::Failure;
use crate::config::Settings;
use crate::diagnose::{Finding, known_to, written};
use crate::track::LearntCamera;

/// A shutter that tracks the clip better than the configured one.
pub(super) struct Readout {
    /// The clip tracked with it.
    pub pass: Pass,
    /// What the clip says about the shutter.
    pub lines: Vec<String>,
    /// One sigma of the readout, seconds.
    sigma_s: f64,
    shutter: Shutter,
    configured: KnownShutter,
}

impl Readout {
    /// Estimates the shutter if something does not fit, and tracks the clip with it. Returns `None`
    /// if that is no better.
    pub(super) fn that_helps(settings: &Settings, before: &Pass, clip: &Path, fps: Option<f64>) -> Result<Option<Self>, Failure> {
        // A shutter configured as global is trusted.
        if settings.shutter.readout_s == Some(0.0) || !before.may_lack_readout() {
            return Ok(None);
        }
        let Ok(estimate) = shutter::estimate(settings, clip, fps)? else { return Ok(None) };
        let Some(found) = shutter::other_than(&settings.shutter.or_zero(), &estimate) else { return Ok(None) };
        let pass = Pass::over(settings, found.into(), clip, fps, LearntCamera::default())?;
        let lines = shutter::describe(&estimate, settings);
        let sigma_s = estimate.readout.map_or(0.0, |readout| readout.sigma_s);
        Ok(is_better(before, &pass).then_some(Self { pass, lines, sigma_s, shutter: found, configured: settings.shutter }))
    }

    /// Returns the line for the config and what it gains.
    pub(super) fn finding(&self, before: &Pass) -> Finding {
        let Self { pass, shutter, configured, sigma_s, .. } = self;
        // One digit more than is known.
        let mut lines = vec![format!("readout_s = {}", written(known_to(shutter.readout_s, 0.1 * sigma_s)))];
        if shutter.exposure_s != configured.or_zero().exposure_s {
            lines.push(format!("exposure_s = {}", written(shutter.exposure_s)));
        }
        let why = match configured.or_zero().readout_s {
            0.0 => "the camera has a rolling shutter, which the config does not state".to_owned(),
            had_s => format!("the camera's readout time differs from readout_s = {}", written(had_s)),
        };
        let message = format!(
            "{why}: write {} below [camera] (tried: a pose is then given in {} of {} frames, without it in {})",
            lines.join(" and "),
            pass.outcome.tracked,
            pass.outcome.frames,
            before.outcome.tracked
        );
        if pass.reported_share() > before.reported_share() + WARNING_SHARE { Finding::fault(message) } else { Finding::doubt(message) }
    }
}

/// Whether more poses are reported, or as many with no unexplained residuals.
fn is_better(before: &Pass, after: &Pass) -> bool {
    let explains = after.is_as_modelled() && !before.is_as_modelled();
    after.reported_share() > before.reported_share() + WARNING_SHARE || (explains && after.reported_share() >= before.reported_share())
}
