//! The timecode's state for health and metrics.

use serde::Serialize;

use crate::frame::Timestamp;
use crate::timecode::{TimecodeSource, TimecodeState};

/// What is known of the timecode now.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TimecodeStatus {
    /// `never found`, `locked`, `free-wheeling` or `lost`.
    pub state: &'static str,
    /// The timecode of this moment; null if it is not known.
    pub timecode: Option<String>,
    /// Its rate; null before it is known.
    pub rate: Option<&'static str>,
    /// The configured rate, if the timecode runs at another one.
    pub configured_rate: Option<&'static str>,
    /// How fast it runs, 1 for its rate, negative backwards; null before two frames.
    pub speed: Option<f64>,
    /// Time since the last frame of timecode, seconds; null unless it free-wheels.
    pub without_s: Option<f64>,
}

/// The states by their names.
pub(super) const STATES: [&str; 4] = ["never found", "locked", "free-wheeling", "lost"];

impl TimecodeStatus {
    /// Returns the status of a live source; `now` is on the clock of the camera's stamps.
    pub fn of(source: &TimecodeSource, now: Timestamp) -> Option<Self> {
        source.with_live(|track| {
            let state = track.state(now);
            let wrong = track.configured_rate().filter(|configured| track.heard_rate().is_some_and(|heard| heard != *configured));
            Self {
                state: state.word(),
                timecode: track.at(now).map(|stamped| stamped.code.to_string()),
                rate: wrong.and(track.heard_rate()).or(track.rate()).map(|rate| rate.word()),
                configured_rate: wrong.map(|rate| rate.word()),
                speed: track.speed().filter(|_| state == TimecodeState::Locked).map(|speed| (speed * 1e6).round() / 1e6),
                without_s: match state {
                    TimecodeState::FreeWheeling { for_s } => Some((for_s * 1e3).round() / 1e3),
                    _ => None,
                },
            }
        })
    }
}
