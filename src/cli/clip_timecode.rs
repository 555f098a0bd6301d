//! Reads timecode from files: of a clip, what its recording wrote, or the sound that the config
//! names.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use super::failure::Failure;
use super::output_file::STDOUT;
use crate::config::{TimecodeInput, TimecodeSettings};
use crate::frame::Timestamp;
use crate::safe_file;
use crate::timecode::side_file::{self, TimecodeRows};
use crate::timecode::{RawFormat, Sound, SoundError, TimecodeSource, TimecodeTrack, TrackSettings};

/// Maximum size of a recording's timecode, bytes: a day at 60 rows per second has 300 MB. Raised, a
/// wrong file takes more memory.
const MAX_ROWS: u64 = 512 << 20;

/// Returns the timecode of a clip; `folder` is the recording's, or where its poses lie.
///
/// # Errors
/// A file that is there but cannot be read.
pub(super) fn timecode_of_clip(settings: Option<&TimecodeSettings>, folder: Option<&Path>) -> Result<Option<TimecodeSource>, Failure> {
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
    let (track, ..) = read_timecode(file, settings.raw, settings.channel, settings.track)?;
    if track.marks().next().is_none() {
        return Err(no_timecode(file, settings.channel));
    }
    Ok(Some(TimecodeSource::sound(track, settings.begins_s)))
}

fn none(settings: &TimecodeSettings) -> Option<TimecodeSource> {
    tracing::warn!("{}: is no sound file, so this clip has no timecode", settings.input);
    None
}

/// Says what the config's timecode is, as far as can be seen now.
pub(super) fn timecode_in_words(settings: &TimecodeSettings) -> String {
    let TimecodeInput::File(file) = &settings.input else {
        return format!("{}, read while the camera runs", settings.input);
    };
    let name = file.display();
    if !file.exists() {
        return format!("{name} is not there yet; `run` waits for it");
    }
    if !file.is_file() {
        return format!("{name}, read while the camera runs");
    }
    match read_timecode(file, settings.raw, settings.channel, settings.track) {
        Err(failure) => failure.to_string(),
        Ok((track, ..)) => match (track.marks().next(), track.marks().last(), track.rate()) {
            (Some(first), Some(last), Some(rate)) => {
                let wrong = settings.track.rate.filter(|configured| track.heard_rate().is_some_and(|heard| heard != *configured));
                let wrong = wrong.map_or(String::new(), |configured| format!(", but `rate` is {configured}: correct it"));
                format!("{name}: {} to {} at {rate}{wrong}", first.code, last.code)
            }
            _ => no_timecode(file, settings.channel).to_string(),
        },
    }
}

/// Reads the timecode of a sound, whose first sample is at 0; `-` is standard input. Also returns
/// its length in seconds, and how many frames nothing confirmed.
///
/// # Errors
/// It cannot be read as sound.
pub(super) fn read_timecode(
    file: &Path,
    raw: Option<RawFormat>,
    channel: u16,
    settings: TrackSettings,
) -> Result<(TimecodeTrack, f64, u64), Failure> {
    let refuse = |error: SoundError| Failure::Timecode { file: file.to_owned(), reason: error.to_string() };
    let input: Box<dyn Read> =
        if file == Path::new(STDOUT) { Box::new(io::stdin()) } else { Box::new(File::open(file).map_err(|e| refuse(e.into()))?) };
    let sound = Sound::open(input, raw, channel).map_err(refuse)?;
    TimecodeTrack::of_sound(sound, Timestamp::default(), settings).map_err(refuse)
}

/// Returns the failure of a sound without timecode.
pub(super) fn no_timecode(file: &Path, channel: u16) -> Failure {
    let reason = format!(
        "there is no timecode in channel {channel}; give the channel with --channel N, and record at half of full scale, without compression"
    );
    Failure::Timecode { file: file.to_owned(), reason }
}
