//! The timecode of a clip: what its recording wrote, or the sound that the config names.

use std::path::Path;

use super::read;
use crate::cli::failure::Failure;
use crate::config::{TimecodeInput, TimecodeSettings};
use crate::safe_file;
use crate::timecode::TimecodeSource;
use crate::timecode::side_file::{self, TimecodeRows};

/// Maximum size of a recording's timecode, bytes: a day at 60 rows per second has 300 MB. Raised, a
/// wrong file takes more memory.
const MAX_ROWS: u64 = 512 << 20;

/// Returns the timecode of a clip; `folder` is the recording's, or where its poses lie.
///
/// # Errors
/// A file that is there but cannot be read.
pub(in crate::cli) fn timecode_of_clip(
    settings: Option<&TimecodeSettings>,
    folder: Option<&Path>,
) -> Result<Option<TimecodeSource>, Failure> {
    if let Some(file) = folder.map(|folder| folder.join(side_file::NAME)).filter(|file| file.is_file()) {
        let refuse = |reason: String| Failure::Timecode { file: file.clone(), reason };
        let bytes = safe_file::read(&file, MAX_ROWS).map_err(|e| refuse(format!("cannot be read ({e})")))?;
        let rows = TimecodeRows::parse(&bytes).map_err(|e| refuse(e.to_string()))?;
        return Ok(Some(TimecodeSource::Rows(rows)));
    }
    let Some(settings) = settings else { return Ok(None) };
    // A pipe or a sound card has the sound of now, not of the clip.
    let TimecodeInput::File(file) = &settings.input else { return Ok(none(settings)) };
    if !file.is_file() {
        return Ok(none(settings));
    }
    let (track, ..) = read(file, settings.raw, settings.channel, settings.track)?;
    if track.marks().next().is_none() {
        return Err(super::nothing(file, settings.channel));
    }
    Ok(Some(TimecodeSource::sound(track, settings.begins_s)))
}

fn none(settings: &TimecodeSettings) -> Option<TimecodeSource> {
    tracing::warn!("{}: is no sound file, so this clip has no timecode", settings.input);
    None
}
