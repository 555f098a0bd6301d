//! What one output is to say at one instant, before any protocol: this is what encoders turn into packets.

use std::sync::Arc;

use crate::geometry::{Body, Pose, Stage};
use crate::record::{PoseSample, State};

/// How far a pose can be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// Measured and verified.
    Tracking,
    /// Predicted over a short gap, or on its way back after a loss.
    Coasting,
    /// Never found yet.
    Searching,
    /// Not known now.
    Lost,
    /// Known, but withheld by the safety limits.
    Withheld(Withheld),
    /// No frame came for too long.
    Stale,
}

/// Why a known pose is not sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Withheld {
    /// A number is not finite.
    NotFinite,
    /// Outside the permitted box.
    OutsideBox,
    /// Faster than the permitted speed.
    TooFast,
    /// Turning faster than permitted.
    TurnsTooFast,
}

impl Withheld {
    /// In words, for events and records.
    pub fn words(self) -> &'static str {
        match self {
            Self::NotFinite => "not finite",
            Self::OutsideBox => "outside the permitted box",
            Self::TooFast => "faster than permitted",
            Self::TurnsTooFast => "turning faster than permitted",
        }
    }
}

impl Standing {
    /// One word for formats that carry one.
    pub fn word(self) -> &'static str {
        match self {
            Self::Tracking => "tracking",
            Self::Coasting => "coasting",
            Self::Searching => "searching",
            Self::Lost => "lost",
            Self::Withheld(_) => "withheld",
            Self::Stale => "stale",
        }
    }

    /// 1 measured, 0.5 predicted, 0 nothing to rely on.
    pub fn confidence(self) -> f32 {
        match self {
            Self::Tracking => 1.0,
            Self::Coasting => 0.5,
            Self::Searching | Self::Lost | Self::Withheld(_) | Self::Stale => 0.0,
        }
    }
}

impl From<State> for Standing {
    fn from(state: State) -> Self {
        match state {
            State::Searching => Self::Searching,
            State::Tracking => Self::Tracking,
            State::Coasting => Self::Coasting,
            State::Lost => Self::Lost,
            State::Stale => Self::Stale,
        }
    }
}

/// One body at the report's instant.
#[derive(Debug, Clone)]
pub struct BodyReport {
    /// "camera", or the object's name.
    pub name: Arc<str>,
    /// How far the pose can be trusted; says why there is none.
    pub standing: Standing,
    /// `T_stage_body` after safety and the output's own offset, inversion and scale.
    pub pose: Option<Pose<Stage, Body>>,
    /// The pose is the last one again, because nothing newer is known.
    pub is_held: bool,
    /// The pose is on its way back to the tracker's after a gap.
    pub is_blended: bool,
    /// Nothing was done to the tracker's pose.
    pub is_untouched: bool,
}

/// Everything that one output says at one instant.
#[derive(Debug, Clone)]
pub struct Report {
    /// The sample's number; on a fixed rate the tick's.
    pub sequence: u64,
    /// The instant that the poses are of, in Unix time, nanoseconds.
    pub unix_ns: i64,
    /// The same instant on the monotonic clock, nanoseconds.
    pub monotonic_ns: i64,
    /// The same instant as the clip has it, where a clip is replayed.
    pub recorded_ns: Option<i64>,
    /// Samples per second, as far as known.
    pub rate_hz: f64,
    /// The bodies that the output speaks of, in its order; the first is the main one.
    pub bodies: Vec<BodyReport>,
    /// The tracker's sample; none on a fixed rate and in a stale marker.
    pub sample: Option<Arc<PoseSample>>,
    /// Milliseconds from the instant to now.
    pub age_ms: f64,
    /// The poses are invented, to set up the receiver.
    pub is_test: bool,
}
