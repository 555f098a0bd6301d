//! Reads sound: WAV files, and raw samples from a pipe.
//!
//! It reads forwards only, so that a pipe works like a file, and returns one channel.

use std::io::{self, Read};

use thiserror::Error;

/// Minimum and maximum samples per second. At 11025, timecode of 30 frames per second at 1.5 times
/// its speed is not decoded; above the maximum is no sound card.
const RATES: std::ops::RangeInclusive<u32> = 16_000..=384_000;
/// Maximum number of channels: of the largest sound interfaces.
pub const MAX_CHANNELS: u16 = 128;
/// Maximum size of the chunk `fmt `, bytes; the longest known one has 40. Raised, a damaged file
/// takes more memory.
const MAX_FORMAT: u32 = 1024;
/// Bytes that are read at once: 43 ms of two channels at 48 kHz. Raised, a pipe's samples come
/// later; lowered, there are more calls.
const PIECE: usize = 8192;

/// WAV's tag of the longer format, which has the samples' own tag inside. Tag 1 are integers, tag 3
/// floating-point numbers.
const EXTENSIBLE: u16 = 0xFFFE;

/// How raw samples are stored: 16-bit, signed, little-endian, interleaved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RawFormat {
    /// Samples per second.
    pub sample_rate: u32,
    /// Number of channels.
    pub channels: u16,
}

/// Why sound cannot be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SoundError {
    /// The system's error.
    #[error("it cannot be read ({0})")]
    Read(#[from] io::Error),
    /// It is not WAV.
    #[error("it is no WAV file: it does not begin with RIFF; convert it with: ffmpeg -i IN -c:a pcm_s16le OUT.wav")]
    NotWav,
    /// It ends within its header.
    #[error("it ends within its header; copy the file again")]
    Cut,
    /// The header has no format before the samples.
    #[error("its header does not say how the samples are stored; convert it with: ffmpeg -i IN -c:a pcm_s16le OUT.wav")]
    NoFormat,
    /// Samples that are not supported.
    #[error("its samples are stored in form {tag:#06x} with {bits} bits; convert it with: ffmpeg -i IN -c:a pcm_s16le OUT.wav")]
    Form {
        /// WAV's format tag.
        tag: u16,
        /// Bits per sample.
        bits: u16,
    },
    /// An impossible rate.
    #[error("it has {0} samples per second; timecode needs 16000 to 384000")]
    Rate(u32),
    /// An impossible number of channels.
    #[error("it has {0} channels; 1 to {MAX_CHANNELS} are possible")]
    Channels(u16),
    /// The channel is not there.
    #[error("channel {wanted} is not there: it has {channels}")]
    Channel {
        /// The channel, from 1.
        wanted: u16,
        /// Number of channels.
        channels: u16,
    },
}

/// How a sample is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    Unsigned8,
    Signed16,
    Signed24,
    Signed32,
    Float32,
}

impl Form {
    fn bytes(self) -> usize {
        match self {
            Self::Unsigned8 => 1,
            Self::Signed16 => 2,
            Self::Signed24 => 3,
            Self::Signed32 | Self::Float32 => 4,
        }
    }

    /// Converts a sample of [`Form::bytes`] bytes; full scale is 1.
    fn value(self, bytes: &[u8]) -> f32 {
        match (self, bytes) {
            (Self::Unsigned8, [a]) => (f32::from(*a) - 128.0) / 128.0,
            (Self::Signed16, [a, b]) => f32::from(i16::from_le_bytes([*a, *b])) / 32_768.0,
            (Self::Signed24, [a, b, c]) => i32::from_le_bytes([0, *a, *b, *c]) as f32 / 2_147_483_648.0,
            (Self::Signed32, [a, b, c, d]) => i32::from_le_bytes([*a, *b, *c, *d]) as f32 / 2_147_483_648.0,
            (Self::Float32, [a, b, c, d]) => f32::from_le_bytes([*a, *b, *c, *d]),
            _ => 0.0,
        }
    }
}

/// The layout of interleaved samples.
#[derive(Debug, Clone, Copy)]
struct Layout {
    form: Form,
    channels: u16,
    sample_rate: u32,
}

/// One channel of a sound that is being read.
#[derive(Debug)]
pub struct Sound<R> {
    input: R,
    layout: Layout,
    /// From 0.
    channel: usize,
    /// Bytes of the samples that are left; `None` reads to the end.
    left: Option<u64>,
    /// Bytes that were read, and are not converted.
    pending: Vec<u8>,
}

impl<R: Read> Sound<R> {
    /// Begins to read: WAV if it begins so, otherwise raw samples if their format is stated.
    /// `channel` counts from 1.
    ///
    /// # Errors
    /// What is no WAV file, or one that is not supported.
    pub fn open(mut input: R, raw: Option<RawFormat>, channel: u16) -> Result<Self, SoundError> {
        let begin = up_to(&mut input, 12)?;
        let is_wav = begin.len() == 12 && matches!(&begin[..4], b"RIFF" | b"RF64") && &begin[8..] == b"WAVE";
        let (layout, left, pending) = match raw {
            _ if is_wav => {
                let (layout, left) = header(&mut input)?;
                (layout, left, Vec::new())
            }
            Some(RawFormat { sample_rate, channels }) => (Layout { form: Form::Signed16, channels, sample_rate }, None, begin),
            None => return Err(SoundError::NotWav),
        };
        Self::of(input, layout, left, pending, channel)
    }

    /// Begins to read raw samples that cannot be anything else.
    ///
    /// # Errors
    /// A format or a channel that cannot be.
    pub fn raw(input: R, RawFormat { sample_rate, channels }: RawFormat, channel: u16) -> Result<Self, SoundError> {
        Self::of(input, Layout { form: Form::Signed16, channels, sample_rate }, None, Vec::new(), channel)
    }

    fn of(input: R, layout: Layout, left: Option<u64>, pending: Vec<u8>, channel: u16) -> Result<Self, SoundError> {
        if !RATES.contains(&layout.sample_rate) {
            return Err(SoundError::Rate(layout.sample_rate));
        }
        if !(1..=MAX_CHANNELS).contains(&layout.channels) {
            return Err(SoundError::Channels(layout.channels));
        }
        if !(1..=layout.channels).contains(&channel) {
            return Err(SoundError::Channel { wanted: channel, channels: layout.channels });
        }
        Ok(Self { input, layout, channel: usize::from(channel - 1), left, pending })
    }

    /// Returns samples per second.
    pub fn sample_rate(&self) -> u32 {
        self.layout.sample_rate
    }

    /// Reads what is there, waiting for at least one byte, and appends its samples, from -1 to 1.
    /// Returns false at the end.
    ///
    /// # Errors
    /// The system's error.
    pub fn read(&mut self, samples: &mut Vec<f32>) -> Result<bool, SoundError> {
        let mut piece = [0; PIECE];
        let most = self.left.map_or(PIECE, |left| usize::try_from(left).map_or(PIECE, |left| left.min(PIECE)));
        let count = loop {
            match self.input.read(&mut piece[..most]) {
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                other => break other?,
            }
        };
        self.left = self.left.map(|left| left - count as u64);
        self.pending.extend_from_slice(&piece[..count]);
        let (size, all) = (self.layout.form.bytes(), self.layout.form.bytes() * usize::from(self.layout.channels));
        let whole = self.pending.len() / all * all;
        let own = |frame: &[u8]| self.layout.form.value(&frame[self.channel * size..][..size]);
        samples.extend(self.pending[..whole].chunks_exact(all).map(own));
        self.pending.drain(..whole);
        Ok(count > 0)
    }
}

/// Reads this many bytes, or fewer at the end.
fn up_to(input: &mut impl Read, count: u64) -> Result<Vec<u8>, SoundError> {
    let mut bytes = Vec::new();
    input.by_ref().take(count).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Reads the chunks up to the samples; returns the layout, and the length of the samples in bytes
/// if it is known.
fn header(input: &mut impl Read) -> Result<(Layout, Option<u64>), SoundError> {
    let mut layout = None;
    loop {
        let head = up_to(input, 8)?;
        let [name @ .., a, b, c, d] = head.as_slice() else { return Err(SoundError::Cut) };
        let size = u32::from_le_bytes([*a, *b, *c, *d]);
        match name {
            b"data" => {
                // A program that writes to a pipe does not know the length.
                let left = (size != 0 && size != u32::MAX).then_some(u64::from(size));
                return layout.map(|layout| (layout, left)).ok_or(SoundError::NoFormat);
            }
            b"fmt " if size <= MAX_FORMAT => layout = Some(format(&up_to(input, u64::from(size) + u64::from(size % 2))?)?),
            name if name.len() == 4 => {
                let size = u64::from(size) + u64::from(size % 2);
                if io::copy(&mut input.by_ref().take(size), &mut io::sink())? < size {
                    return Err(SoundError::Cut);
                }
            }
            _ => return Err(SoundError::Cut),
        }
    }
}

/// Reads the chunk `fmt `.
fn format(bytes: &[u8]) -> Result<Layout, SoundError> {
    let word = |at: usize| bytes.get(at..at + 2).map_or(0, |b| u16::from_le_bytes([b[0], b[1]]));
    if bytes.len() < 16 {
        return Err(SoundError::Cut);
    }
    let (tag, bits) = (word(0), word(14));
    let inner = if tag == EXTENSIBLE { word(24) } else { tag };
    let form = match (inner, bits) {
        (1, 8) => Form::Unsigned8,
        (1, 16) => Form::Signed16,
        (1, 24) => Form::Signed24,
        (1, 32) => Form::Signed32,
        (3, 32) => Form::Float32,
        _ => return Err(SoundError::Form { tag: inner, bits }),
    };
    let sample_rate = u32::from(word(4)) | u32::from(word(6)) << 16;
    Ok(Layout { form, channels: word(2), sample_rate })
}

#[cfg(test)]
#[path = "sound_tests.rs"]
mod tests;
