//! Where a stamp's timecode comes from.

use std::sync::{Mutex, OnceLock, PoisonError};

use super::side_file::TimecodeRows;
use super::track::{StampedTimecode, TimecodeTrack};
use crate::frame::Timestamp;

/// The timecode of a live camera's or a clip's stamps.
#[derive(Debug)]
pub enum TimecodeSource {
    /// It comes while the camera runs, on the clock of its stamps.
    Live(Mutex<TimecodeTrack>),
    /// A sound that belongs to a clip.
    Sound(SoundOfClip),
    /// What a recording has beside its rows.
    Rows(TimecodeRows),
}

/// A sound that belongs to a clip.
#[derive(Debug)]
pub struct SoundOfClip {
    /// Its timecode; its first sample is at 0.
    track: TimecodeTrack,
    /// When the sound begins, seconds after the clip's first row.
    begins_s: f64,
    /// The stamp of that row.
    first: OnceLock<Timestamp>,
}

impl TimecodeSource {
    /// Returns a source that waits for marks.
    pub fn live(track: TimecodeTrack) -> Self {
        Self::Live(Mutex::new(track))
    }

    /// Returns the source of a clip whose sound begins `begins_s` seconds after its first row;
    /// `track` counts from the sound's first sample.
    pub fn sound(track: TimecodeTrack, begins_s: f64) -> Self {
        Self::Sound(SoundOfClip { track, begins_s, first: OnceLock::new() })
    }

    /// States the stamp of a clip's first row. Only the first call counts.
    pub fn begin(&self, first: Timestamp) {
        if let Self::Sound(sound) = self {
            sound.first.get_or_init(|| first);
        }
    }

    /// Returns the timecode of a stamp, if it is known.
    pub fn at(&self, stamp: Timestamp) -> Option<StampedTimecode> {
        match self {
            Self::Live(track) => track.lock().unwrap_or_else(PoisonError::into_inner).at(stamp),
            Self::Sound(SoundOfClip { track, begins_s, first }) => {
                let since_first = Timestamp::from_ns(stamp.ns_since(*first.get()?));
                track.at(since_first.after_s(-begins_s))
            }
            Self::Rows(rows) => rows.at(stamp),
        }
    }

    /// Runs `use_track` on the track of a live source.
    pub fn with_live<T>(&self, use_track: impl FnOnce(&mut TimecodeTrack) -> T) -> Option<T> {
        match self {
            Self::Live(track) => Some(use_track(&mut track.lock().unwrap_or_else(PoisonError::into_inner))),
            Self::Sound(_) | Self::Rows(_) => None,
        }
    }
}
