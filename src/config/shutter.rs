//! What a config says about the shutter: its times, or that it is global.

use toml::Spanned;

use super::values::Section;
use super::{ConfigError, Problem, as_typed};
use crate::camera::{KnownShutter, Shutter};

/// Words for the key `shutter`.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Global,
    Rolling,
}

/// Returns what is known of the shutter. A time that is absent or 0 is unknown, except the readout
/// of a global shutter, which is 0.
pub(super) fn shutter(section: &Section<'_>, camera: &as_typed::Camera) -> Result<KnownShutter, ConfigError> {
    let seconds = "seconds from 0 (unknown) to 1; 15 milliseconds are 0.015";
    let within = |v: f64| (0.0..=Shutter::MAX_S).contains(&v);
    let exposure_s = section.number("exposure_s", camera.exposure_s.as_ref(), 0.0, within, seconds)?;
    let readout_s = section.number("readout_s", camera.readout_s.as_ref(), 0.0, within, seconds)?;
    let kinds = [("global", Some(Kind::Global)), ("rolling", Some(Kind::Rolling))];
    let kind = section.word("shutter", camera.shutter.as_ref(), None, &kinds, "global or rolling")?;
    let known = |time_s: f64| Some(time_s).filter(|s| *s > 0.0);
    let readout_s = match (kind, camera.shutter.as_ref().map(Spanned::span)) {
        (Some(Kind::Global), Some(span)) if readout_s > 0.0 => {
            return Err(section.refuse("shutter", &span, Problem::GlobalShutterReads(readout_s)));
        }
        (Some(Kind::Global), _) => Some(0.0),
        _ => known(readout_s),
    };
    Ok(KnownShutter { exposure_s: known(exposure_s), readout_s })
}
