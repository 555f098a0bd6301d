//! `[timecode]`: where linear timecode comes from.

use std::fmt;
use std::ops::Range;
use std::path::PathBuf;

use toml::Spanned;

use super::origin::Origin;
use super::values::Section;
use super::{ConfigError, as_typed};
use crate::timecode::{MAX_CHANNELS, RawFormat, TimecodeRate, TrackSettings};

/// Where the sound comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TimecodeInput {
    /// A WAV file or a pipe, with its relative name resolved.
    File(PathBuf),
    /// Standard input.
    Stdin,
    /// A sound card, by its ALSA name.
    SoundCard(String),
}

impl fmt::Display for TimecodeInput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(file) => write!(f, "{}", file.display()),
            Self::Stdin => f.write_str("standard input"),
            Self::SoundCard(name) => write!(f, "sound card {name}"),
        }
    }
}

/// The `[timecode]` section.
#[derive(Debug, Clone, PartialEq)]
pub struct TimecodeSettings {
    /// Where the sound comes from.
    pub input: TimecodeInput,
    /// The channel with the timecode, from 1.
    pub channel: u16,
    /// How samples without a WAV header are stored, if it is stated.
    pub raw: Option<RawFormat>,
    /// The rate, and how long it counts on.
    pub track: TrackSettings,
    /// How much later the sound arrives than it was made, seconds.
    pub latency_s: f64,
    /// When a clip's sound begins, seconds after its first frame.
    pub begins_s: f64,
}

impl TimecodeSettings {
    /// Returns how samples without a WAV header are stored: as stated, or as usual.
    pub fn raw_format(&self) -> RawFormat {
        self.raw.unwrap_or(RawFormat { sample_rate: USUAL_SAMPLE_RATE as u32, channels: 1 })
    }
}

/// Standard input's name.
const STDIN: &str = "-";
/// Default of `sample_rate_hz`: what sound cards and video use.
const USUAL_SAMPLE_RATE: u64 = 48_000;
/// Default of `free_wheel_s`. Two clocks differ by up to 100 ppm, which is a tenth of a frame after
/// 30 s at 30 frames per second. Raised, a pulled cable goes unnoticed for longer.
const FREE_WHEEL_S: f64 = 30.0;

/// Checks the section.
pub(super) fn timecode(origin: &Origin<'_>, typed: &Spanned<as_typed::Timecode>) -> Result<TimecodeSettings, ConfigError> {
    let (section, span) = (Section { origin, name: "[timecode]" }, typed.span());
    let typed = typed.get_ref();
    let input = input(&section, &span, typed)?;
    let rates = TimecodeRate::ALL.map(|rate| (rate.word(), Some(rate)));
    let words = "\"23.976\", \"24\", \"25\", \"29.97\", \"29.97df\" (drop frame) or \"30\"";
    let count = |key, typed, default, most, wanted| section.count(key, typed, default, 1..=most, wanted);
    let channels = count("channels", typed.channels.as_ref(), 1, u64::from(MAX_CHANNELS), "1 to 128 channels")?;
    let sample_rate = section.count(
        "sample_rate_hz",
        typed.sample_rate_hz.as_ref(),
        USUAL_SAMPLE_RATE,
        16_000..=384_000,
        "16000 to 384000 samples per second",
    )?;
    let is_raw = typed.channels.is_some() || typed.sample_rate_hz.is_some();
    let number = |key, typed, default, range: std::ops::RangeInclusive<f64>, wanted| {
        section.number(key, typed, default, |v| range.contains(&v), wanted)
    };
    Ok(TimecodeSettings {
        input,
        channel: count("channel", typed.channel.as_ref(), 1, u64::from(MAX_CHANNELS), "a channel from 1 to 128")? as u16,
        raw: is_raw.then_some(RawFormat { sample_rate: sample_rate as u32, channels: channels as u16 }),
        track: TrackSettings {
            rate: section.word("rate", typed.rate.as_ref(), None, &rates, words)?,
            free_wheel_s: number("free_wheel_s", typed.free_wheel_s.as_ref(), FREE_WHEEL_S, 0.0..=86_400.0, "seconds from 0 to 86400")?,
        },
        latency_s: number("latency_s", typed.latency_s.as_ref(), 0.0, 0.0..=2.0, "seconds from 0 to 2")?,
        begins_s: number("begins_s", typed.begins_s.as_ref(), 0.0, -86_400.0..=86_400.0, "seconds from -86400 to 86400")?,
    })
}

/// Returns where the sound comes from: exactly one of `file` and `device`.
fn input(section: &Section<'_>, span: &Range<usize>, typed: &as_typed::Timecode) -> Result<TimecodeInput, ConfigError> {
    match (&typed.file, &typed.device) {
        (Some(_), Some(device)) => Err(section.conflict("device", device, "the sound comes from `file` or from `device`; remove one")),
        (Some(file), None) => {
            let name = section.text("file", file, "a WAV file or a pipe, or \"-\" for standard input")?;
            Ok(if name == STDIN { TimecodeInput::Stdin } else { TimecodeInput::File(section.origin.beside(&name)) })
        }
        (None, Some(device)) if !cfg!(feature = "sound-card") => {
            let problem = "this build has no sound cards; build it with `--features sound-card` (it needs libasound2-dev), or give `file`, \
                           the name of a pipe to which arecord writes";
            Err(section.conflict("device", device, problem))
        }
        (None, Some(device)) => Ok(TimecodeInput::SoundCard(section.text("device", device, "an ALSA name such as \"hw:1\"")?)),
        (None, None) => {
            let hint = "`file = \"ltc.wav\"`, or the name of a pipe, or \"-\" for standard input";
            Err(section.origin.missing(section.origin.section_at(section.name, span), "file", hint))
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn read(text: &str) -> Result<TimecodeSettings, String> {
        let file = Path::new("shows/stage.toml");
        let typed = as_typed::Config::parse(text, file).map_err(|e| e.to_string())?;
        timecode(&Origin::new(file, text), typed.timecode.as_ref().unwrap()).map_err(|e| e.to_string())
    }

    #[test]
    fn keys_become_settings() {
        let plain = read("[timecode]\nfile = \"ltc.wav\"\n").unwrap();
        assert_eq!((plain.input, plain.channel, plain.raw), (TimecodeInput::File("shows/ltc.wav".into()), 1, None));
        assert_eq!(plain.track, TrackSettings { rate: None, free_wheel_s: 30.0 });
        let all = "[timecode]\nfile = \"-\"\nchannel = 2\nchannels = 2\nsample_rate_hz = 44100\nrate = \"29.97df\"\nfree_wheel_s = 0\n\
                   latency_s = 0.05\nbegins_s = -3.5\n";
        let all = read(all).unwrap();
        assert!(all.input == TimecodeInput::Stdin && all.raw == Some(RawFormat { sample_rate: 44_100, channels: 2 }) && all.channel == 2);
        assert_eq!((all.track.rate, all.latency_s, all.begins_s), (Some(TimecodeRate::Fps29_97Drop), 0.05, -3.5));
    }

    #[test]
    fn bad_values_are_refused_with_their_line_and_fix() {
        for (keys, parts) in [
            ("", ["[timecode]", "file = "]),
            ("file = \" \"", ["`file` in [timecode], line 2", "WAV"]),
            ("file = \"a\"\ndevice = \"hw:1\"", ["`device` in [timecode], line 3", "remove one"]),
            ("file = \"a\"\nrate = \"29.97 drop\"", ["`rate` in [timecode], line 3", "29.97df"]),
            ("file = \"a\"\nchannel = 0", ["`channel` in [timecode], line 3", "from 1 to 128"]),
            ("file = \"a\"\nsample_rate_hz = 100", ["`sample_rate_hz`", "16000"]),
            ("file = \"a\"\nfree_wheel_s = -1", ["`free_wheel_s`", "0 to 86400"]),
            ("file = \"a\"\nfreewheel_s = 1", ["unknown key `freewheel_s`", "free_wheel_s"]),
        ] {
            let message = read(&format!("[timecode]\n{keys}\n")).unwrap_err();
            assert!(parts.iter().all(|part| message.contains(part)), "{keys}: {message}");
        }
        let card = read("[timecode]\ndevice = \"hw:1\"\n").map(|settings| settings.input);
        match cfg!(feature = "sound-card") {
            true => assert_eq!(card, Ok(TimecodeInput::SoundCard("hw:1".to_owned()))),
            false => assert!(card.unwrap_err().contains("--features sound-card")),
        }
    }
}
