//! `timecode`: reads linear timecode from a sound and says what is in it.

mod report;

use std::path::PathBuf;

use super::calibrate::write_whole;
use super::clip_timecode::{no_timecode, read_timecode};
use super::failure::Failure;
use super::output_file::print;
use super::spared::Spared;
use crate::printable::printable_lines;
use crate::timecode::{RawFormat, TimecodeRate, TrackSettings};

use report::{Decoded, frames_csv};

/// Read linear timecode (LTC) from a sound, and say what is in it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose timecode ltc.wav\n\n\
    SOUND is a WAV file or a pipe; - reads standard input. For a sound card: arecord -f S16_LE -r 48000 -c 2 | stagepose timecode --channel 2 -\n\
    Prints the runs of frames that follow each other, their rate and speed, and the gaps between them. For timecode in the outputs, \
    recordings and exports, name the sound in the config's [timecode].")]
pub(super) struct TimecodeArguments {
    /// The sound
    sound: PathBuf,
    /// The channel with the timecode, from 1
    #[arg(long, value_name = "N", default_value_t = 1)]
    channel: u16,
    /// The rate that it should have: 23.976, 24, 25, 29.97, 29.97df or 30 [default: as heard]
    #[arg(long, value_name = "RATE", value_parser = rate)]
    rate: Option<TimecodeRate>,
    /// Samples without a WAV header are 16-bit, little-endian: their rate, and their channels if
    /// more than one, such as 48000x2
    #[arg(long, value_name = "HZ[xN]", value_parser = raw)]
    raw: Option<RawFormat>,
    /// Write a line per frame: when it begins in the sound, seconds, and its timecode
    #[arg(long, value_name = "OUT.csv")]
    frames: Option<PathBuf>,
    /// Write the result as JSON
    #[arg(long, value_name = "OUT.json")]
    json: Option<PathBuf>,
}

fn rate(word: &str) -> Result<TimecodeRate, String> {
    word.parse().map_err(|()| "give 23.976, 24, 25, 29.97, 29.97df (drop frame) or 30".to_owned())
}

fn raw(text: &str) -> Result<RawFormat, String> {
    let (sample_rate, channels) = text.split_once('x').unwrap_or((text, "1"));
    let number = |text: &str| text.parse().ok().filter(|n: &u32| *n > 0);
    let read = number(sample_rate).zip(number(channels).and_then(|channels| u16::try_from(channels).ok()));
    let (sample_rate, channels) = read.ok_or("give samples per second, and channels if more than one, such as 48000 or 48000x2")?;
    Ok(RawFormat { sample_rate, channels })
}

pub(super) fn run(arguments: &TimecodeArguments) -> Result<(), Failure> {
    let TimecodeArguments { sound: file, channel, rate, raw, frames, json } = arguments;
    let mut spared = Spared::default().with_files([file], "the sound");
    for (option, file) in [("--frames", frames), ("--json", json)] {
        file.iter().try_for_each(|file| spared.claim(option, file))?;
    }
    // The rate in the report is the one heard.
    let settings = TrackSettings { rate: None, free_wheel_s: 0.0 };
    let (track, length_s, unconfirmed) = read_timecode(file, *raw, *channel, settings)?;
    let decoded = Decoded { file, track: &track, length_s, unconfirmed, wanted: *rate };
    if let Some(frames) = frames {
        write_whole(frames, frames_csv(&track))?;
    }
    if let Some(json) = json {
        write_whole(json, decoded.json())?;
    }
    if track.marks().next().is_none() {
        return Err(no_timecode(file, *channel));
    }
    print(printable_lines(&decoded.text()).as_bytes())
}
