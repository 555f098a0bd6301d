//! What one output is to say at one instant, before any protocol: this is what encoders turn into packets.

use std::sync::Arc;
use std::time::Duration;

use crate::frame::Timestamp;
use crate::geometry::{Body, Pose, Stage};
use crate::record::{PoseSample, State};

/// A body that an output speaks of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BodyChoice {
    /// The camera.
    Camera,
    /// The object of this number in the config, from 0.
    Object(usize),
    /// The filming camera, which `[mount]` describes.
    Mount,
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
    /// The protocol's numbers do not reach so far.
    OutOfRange,
}

impl Withheld {
    /// In words, for events and records.
    pub fn words(self) -> &'static str {
        match self {
            Self::NotFinite => "not finite",
            Self::OutsideBox => "outside the permitted box",
            Self::TooFast => "faster than permitted",
            Self::TurnsTooFast => "turning faster than permitted",
            Self::OutOfRange => "farther than the protocol's numbers reach",
        }
    }
}

/// One body at the report's instant.
#[derive(Debug, Clone)]
pub struct BodyReport {
    /// "camera", or the object's name.
    pub name: Arc<str>,
    /// Which body that is.
    pub choice: BodyChoice,
    /// What is known of the body: tracking too where a pose is carried on from a measured one by at most one frame interval, coasting too
    /// on the way back after a gap, lost where the pose is withheld, and stale where no frame came for too long or what came is too old.
    pub state: State,
    /// A pose is known, but the safety limits withhold it.
    pub withheld: Option<Withheld>,
    /// `T_stage_body` after safety and the output's own offset, inversion and scale.
    pub pose: Option<Pose<Stage, Body>>,
    /// The pose is the last one sent again, because nothing newer is known: so long before the report's instant it was true.
    pub held: Option<Duration>,
    /// The pose is on its way back to the tracker's after a gap.
    pub is_blended: bool,
    /// The pose is carried on from the newest frame.
    pub is_predicted: bool,
    /// The pose is the tracker's own of this instant, but for the output's origin, axes and units.
    pub is_passed: bool,
}

impl BodyReport {
    /// The pose is the last one again.
    pub fn is_held(&self) -> bool {
        self.held.is_some()
    }

    /// 1 measured, 0.5 predicted or on its way back, 0 nothing to rely on, also where an old pose is repeated.
    pub fn confidence(&self) -> f32 {
        match self.state {
            _ if self.is_held() => 0.0,
            State::Tracking => 1.0,
            State::Coasting => 0.5,
            State::Searching | State::Lost | State::Stale => 0.0,
        }
    }

    /// The mark as one word, for formats that carry one: what is to be known first.
    pub fn word(&self) -> &'static str {
        match self.state {
            _ if self.withheld.is_some() => "withheld",
            State::Coasting if self.is_blended => "blended",
            State::Searching | State::Lost if self.is_held() => "held",
            state => state.word(),
        }
    }
}

/// Everything that one output says at one instant.
#[derive(Debug, Clone)]
pub struct Report {
    /// The sample's number; on a fixed rate the tick's.
    pub sequence: u64,
    /// The instant that the poses are of, in Unix time.
    pub unix: Timestamp,
    /// The same instant on the monotonic clock.
    pub monotonic: Timestamp,
    /// When it is sent, on the monotonic clock.
    pub sent_monotonic: Timestamp,
    /// The same instant as the clip has it, where a clip is replayed.
    pub recorded: Option<Timestamp>,
    /// Samples per second, as far as known.
    pub rate_hz: f64,
    /// The bodies that the output speaks of, in its order; the first is the main one.
    pub bodies: Vec<BodyReport>,
    /// The tracker's sample; none on a fixed rate and in a stale marker.
    pub sample: Option<Arc<PoseSample>>,
    /// Milliseconds from the instant to the moment of sending.
    pub age_ms: f64,
    /// The poses are invented, to set up the receiver.
    pub is_test: bool,
}
