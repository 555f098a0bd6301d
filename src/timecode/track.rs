//! Timecode over time: which timecode an instant has.
//!
//! Decoded frames are marks on the clock of the camera's stamps. Between two marks that follow each
//! other the timecode is theirs. After the last one, and in a gap, it counts on at the timecode's
//! rate, by the camera's clock (jam-sync): free-wheeling, for a configured time at most. A tape
//! that does not run at its speed cannot be continued, so there a gap is lost at once.

use std::collections::VecDeque;

use super::code::Timecode;
use super::rate::TimecodeRate;
use super::sound::{Sound, SoundError};
use crate::frame::Timestamp;
use crate::timecode::LtcDecoder;

/// How long after a mark the next one may come, seconds, while the timecode still counts as locked:
/// two frames at half speed, and a buffer of a recording program (arecord: 125 ms). Raised, a gap
/// is noticed later.
const MAX_LOCKED_S: f64 = 0.3;
/// Maximum interval between two marks of one run, seconds: a frame at 24 frames per second and half
/// speed. Raised, a gap of one frame goes unnoticed.
const MAX_FRAME_S: f64 = 0.1;
/// Number of frames over which the speed is measured: ten seconds. Raised, a change of speed is
/// noticed later; lowered, jitter of a pipe shows.
const SPEED_FRAMES: usize = 250;
/// Minimum number of frames to tell 23.976 from 24 and 29.97 from 30: they differ by 2 ms in two
/// seconds. Lowered, jitter of a pipe decides.
const MIN_RATE_FRAMES: usize = 48;
/// Largest relative difference from its rate at which a timecode runs at its speed. Rates differ by
/// 0.1 %. Raised, a gap of a tape at another speed is filled with wrong timecode.
const MAX_OFF_SPEED: f64 = 0.005;
/// Number of marks that are kept of a live source: a minute, longer than any output's delay.
const KEPT: usize = 1800;

/// Settings of a track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackSettings {
    /// The rate, if it is known; otherwise it is found from the counting and the speed.
    pub rate: Option<TimecodeRate>,
    /// Maximum time without timecode for which it counts on, seconds.
    pub free_wheel_s: f64,
}

/// A frame of timecode on the camera's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimecodeMark {
    /// When the frame begins.
    pub at: Timestamp,
    /// Its timecode.
    pub code: Timecode,
    /// Whether the tape runs backwards.
    pub is_reverse: bool,
}

/// Frames that follow each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimecodeRun {
    /// The first one that came.
    pub first: TimecodeMark,
    /// The last one that came.
    pub last: TimecodeMark,
    /// How many came.
    pub frames: usize,
}

impl TimecodeRun {
    /// Returns frames per second as played, negative backwards; `None` for a single frame.
    pub fn fps(&self) -> Option<f64> {
        let fps = (self.frames - 1) as f64 / self.last.at.seconds_since(self.first.at);
        (self.frames > 1).then_some(if self.last.is_reverse { -fps } else { fps })
    }
}

/// What is known of the timecode at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TimecodeState {
    /// None has come yet.
    NeverFound,
    /// It comes.
    Locked,
    /// It does not come, and counts on.
    FreeWheeling {
        /// Time since the last one, seconds.
        for_s: f64,
    },
    /// It has not come for too long.
    Lost,
}

impl TimecodeState {
    /// Returns its name.
    pub fn word(self) -> &'static str {
        match self {
            Self::NeverFound => "never found",
            Self::Locked => "locked",
            Self::FreeWheeling { .. } => "free-wheeling",
            Self::Lost => "lost",
        }
    }
}

/// The timecode of an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StampedTimecode {
    /// The frame that the instant lies in.
    pub code: Timecode,
    /// How far into the frame it lies, from 0 to below 1.
    pub fraction: f64,
    /// The rate.
    pub rate: TimecodeRate,
    /// Locked or free-wheeling.
    pub state: TimecodeState,
}

impl StampedTimecode {
    /// Returns it as a JSON object: `timecode`, `fraction`, `rate`, `state`, and `without_s` while
    /// it free-wheels.
    pub fn to_json(self) -> String {
        let Self { code, fraction, rate, state } = self;
        let without = match state {
            TimecodeState::FreeWheeling { for_s } => format!(r#","without_s":{for_s:.3}"#),
            _ => String::new(),
        };
        format!(r#"{{"timecode":"{code}","fraction":{fraction:.6},"rate":"{rate}","state":"{}"{without}}}"#, state.word())
    }
}

/// A mark, and the number of marks of its run before it.
#[derive(Debug, Clone, Copy)]
struct Placed {
    mark: TimecodeMark,
    in_run: usize,
}

/// The timecode that has come.
#[derive(Debug)]
pub struct TimecodeTrack {
    settings: TrackSettings,
    marks: VecDeque<Placed>,
    /// Maximum number of marks; `None` keeps all.
    kept: Option<usize>,
    /// How many frame numbers a second has, from where they began again.
    count: Option<u8>,
    /// The highest frame number of the current run.
    most: u8,
    /// The rate as heard.
    heard: Option<TimecodeRate>,
}

impl TimecodeTrack {
    /// Starts without timecode, for a source that never ends: old marks are forgotten.
    pub fn live(settings: TrackSettings) -> Self {
        Self { settings, marks: VecDeque::new(), kept: Some(KEPT), count: None, most: 0, heard: None }
    }

    /// Reads a whole sound whose first sample belongs to the instant `begin`. Also returns its
    /// length in seconds, and how many frames were left out because nothing confirmed them.
    ///
    /// # Errors
    /// The sound cannot be read.
    pub fn of_sound<R: std::io::Read>(
        mut sound: Sound<R>,
        begin: Timestamp,
        settings: TrackSettings,
    ) -> Result<(Self, f64, u64), SoundError> {
        let sample_s = 1.0 / f64::from(sound.sample_rate());
        let (mut track, mut decoder) = (Self { kept: None, ..Self::live(settings) }, LtcDecoder::new(sound.sample_rate()));
        let (mut samples, mut count) = (Vec::new(), 0);
        while sound.read(&mut samples)? {
            decoder.push(&samples, &mut |frame| {
                let at = begin.after_s(frame.edge * sample_s);
                track.push(TimecodeMark { at, code: frame.code, is_reverse: frame.is_reverse });
            });
            count += samples.len();
            samples.clear();
        }
        Ok((track, count as f64 * sample_s, decoder.unconfirmed()))
    }

    /// Adds a mark; one that is not later than the last is left out.
    pub fn push(&mut self, mark: TimecodeMark) {
        let last = self.marks.back().copied();
        if last.is_some_and(|last| mark.at <= last.mark.at) {
            return;
        }
        let before = last.filter(|last| follows(&last.mark, &mark));
        if let Some(before) = before {
            let (earlier, later) = if mark.is_reverse { (mark.code, before.mark.code) } else { (before.mark.code, mark.code) };
            if later.seconds != earlier.seconds {
                self.count = Some(earlier.frames + 1);
            }
        } else if last.is_some_and(|last| last.mark.code.is_drop != mark.code.is_drop) {
            (self.count, self.heard) = (None, None);
        }
        let in_run = before.map_or(0, |before| before.in_run + 1);
        self.most = mark.code.frames.max(if in_run > 0 { self.most } else { 0 });
        self.marks.push_back(Placed { mark, in_run });
        if self.kept.is_some_and(|kept| self.marks.len() > kept) {
            self.marks.pop_front();
        }
        self.hear_rate();
    }

    fn hear_rate(&mut self) {
        let Some((fps, frames)) = self.measured(self.marks.len()) else { return };
        let Some(last) = self.marks.back() else { return };
        let is_drop = last.mark.code.is_drop;
        let counts = [24_u8, 25, 30].into_iter().filter(|count| *count > self.most);
        let nearest = counts.min_by(|a, b| (f64::from(*a) - fps).abs().total_cmp(&(f64::from(*b) - fps).abs()));
        let Some(count) = self.count.or(nearest).map(|count| if is_drop { 30 } else { count }) else { return };
        if self.heard.is_none_or(|heard| heard.count() != count || heard.is_drop() != is_drop) {
            self.heard = TimecodeRate::nearest(count, is_drop, f64::from(count));
        }
        if frames >= MIN_RATE_FRAMES {
            self.heard = TimecodeRate::nearest(count, is_drop, fps);
        }
    }

    /// Returns frames per second as played, measured up to a mark's number, and over how many
    /// frames.
    fn measured(&self, end: usize) -> Option<(f64, usize)> {
        let last = self.marks.get(end.checked_sub(1)?)?;
        let frames = last.in_run.min(SPEED_FRAMES).min(end - 1);
        let first = self.marks.get(end - 1 - frames)?;
        (frames > 0).then(|| (frames as f64 / last.mark.at.seconds_since(first.mark.at), frames))
    }

    /// Returns the rate: the configured one, unless the timecode counts otherwise; then, and
    /// without a configured one, the one heard.
    pub fn rate(&self) -> Option<TimecodeRate> {
        let Some((configured, heard)) = self.settings.rate.zip(self.heard) else { return self.settings.rate.or(self.heard) };
        let is_counted_out = self.count.is_some_and(|count| count != configured.count()) || self.most >= configured.count();
        Some(if is_counted_out || heard.is_drop() != configured.is_drop() { heard } else { configured })
    }

    /// Returns the configured rate.
    pub fn configured_rate(&self) -> Option<TimecodeRate> {
        self.settings.rate
    }

    /// Returns the rate as heard, once it is certain.
    pub fn heard_rate(&self) -> Option<TimecodeRate> {
        self.heard.filter(|_| self.measured(self.marks.len()).is_some_and(|(_, frames)| frames >= MIN_RATE_FRAMES))
    }

    /// Returns how fast the timecode runs now, 1 for its rate, negative backwards; `None` before
    /// two frames.
    pub fn speed(&self) -> Option<f64> {
        let speed = self.measured(self.marks.len())?.0 / self.rate()?.fps();
        Some(if self.marks.back()?.mark.is_reverse { -speed } else { speed })
    }

    /// Returns the marks from the oldest.
    pub fn marks(&self) -> impl Iterator<Item = &TimecodeMark> {
        self.marks.iter().map(|placed| &placed.mark)
    }

    /// Returns the runs of frames that follow each other, from the oldest.
    pub fn runs(&self) -> Vec<TimecodeRun> {
        let mut runs: Vec<TimecodeRun> = Vec::new();
        for Placed { mark, in_run } in &self.marks {
            match runs.last_mut().filter(|_| *in_run > 0) {
                Some(run) => (run.last, run.frames) = (*mark, run.frames + 1),
                None => runs.push(TimecodeRun { first: *mark, last: *mark, frames: 1 }),
            }
        }
        runs
    }

    /// Returns the state at an instant.
    pub fn state(&self, at: Timestamp) -> TimecodeState {
        match self.at(at) {
            Some(stamped) => stamped.state,
            None if self.marks.front().is_some_and(|first| first.mark.at <= at) => TimecodeState::Lost,
            None => TimecodeState::NeverFound,
        }
    }

    /// Returns the timecode of an instant; `None` before the first, and if it is lost.
    pub fn at(&self, at: Timestamp) -> Option<StampedTimecode> {
        let next = self.marks.partition_point(|placed| placed.mark.at <= at);
        let rate = self.rate()?;
        let mark = self.marks.get(next.checked_sub(1)?)?.mark;
        let since_s = at.seconds_since(mark.at);
        let following = self.marks.get(next).filter(|following| following.in_run > 0);
        let frames = match following {
            Some(following) => since_s / following.mark.at.seconds_since(mark.at),
            None => {
                let fps = self.measured(next).map_or(rate.fps(), |(fps, _)| fps);
                let runs = !mark.is_reverse && (fps / rate.fps() - 1.0).abs() < MAX_OFF_SPEED;
                if since_s > if runs { self.settings.free_wheel_s.max(MAX_LOCKED_S) } else { MAX_LOCKED_S } {
                    return None;
                }
                since_s * if runs { rate.fps() } else { fps }
            }
        };
        let whole = frames.floor();
        let number = i64::from(mark.code.number(rate));
        let (number, fraction) =
            if mark.is_reverse { (number - 1 - whole as i64, 1.0 - (frames - whole)) } else { (number + whole as i64, frames - whole) };
        let state = if since_s > MAX_LOCKED_S { TimecodeState::FreeWheeling { for_s: since_s } } else { TimecodeState::Locked };
        let fraction = fraction.min(1.0 - f64::EPSILON);
        Some(StampedTimecode { code: Timecode::of_number(number, rate), fraction, rate, state })
    }
}

/// Whether a mark is the next one of a run.
fn follows(before: &TimecodeMark, mark: &TimecodeMark) -> bool {
    let (earlier, later) = if mark.is_reverse { (mark.code, before.code) } else { (before.code, mark.code) };
    before.is_reverse == mark.is_reverse && earlier.precedes(later) && mark.at.seconds_since(before.at) <= MAX_FRAME_S
}

#[cfg(test)]
#[path = "track_tests.rs"]
mod tests;
