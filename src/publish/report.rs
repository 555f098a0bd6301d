//! What one output reports at one instant, independent of the protocol; encoders turn it into
//! packets.

use std::sync::Arc;
use std::time::Duration;

use nalgebra::Vector3;

use super::rings::Rings;
use super::system_clock::ClockQuality;
use crate::frame::Timestamp;
use crate::geometry::{Body, Pose, Stage};
use crate::record::{PoseSample, State};
use crate::timecode::StampedTimecode;

/// A body that an output reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BodyChoice {
    /// The camera.
    Camera,
    /// The object with this index in the config, from 0.
    Object(usize),
    /// The filming camera, described by `[mount]`.
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
    RotatesTooFast,
    /// Outside the range of the protocol's numbers.
    OutOfRange,
}

impl Withheld {
    /// Returns the reason in words, for events and records.
    pub fn words(self) -> &'static str {
        match self {
            Self::NotFinite => "not finite",
            Self::OutsideBox => "outside the permitted box",
            Self::TooFast => "faster than permitted",
            Self::RotatesTooFast => "turning faster than permitted",
            Self::OutOfRange => "farther than the protocol's numbers reach",
        }
    }
}

/// One body at the report's instant.
#[derive(Debug, Clone)]
pub struct BodyReport {
    /// "camera", or the object's name.
    pub name: Arc<str>,
    /// Which body it is.
    pub choice: BodyChoice,
    /// The state of the reported pose. It is tracking also if the pose is extrapolated from a
    /// measured one by at most one frame interval, coasting also during the return after a gap,
    /// lost if the pose is withheld, and stale if no frame came for too long or what came is too
    /// old.
    pub state: State,
    /// Why the safety limits withhold a known pose.
    pub withheld: Option<Withheld>,
    /// `T_stage_body` after safety and the output's own offset, inversion and scale.
    pub pose: Option<Pose<Stage, Body>>,
    /// Its velocity, m/s in the stage's axes, and its angular velocity, rad/s about its own, both
    /// after the output's offset, inversion and scale: the step from the pose of the report before.
    /// `None` if there was none just before, or one of the two is not the tracker's own.
    pub velocity: Option<[Vector3<f64>; 2]>,
    /// If the last pose is repeated because nothing newer is known: its age at the report's
    /// instant.
    pub held: Option<Duration>,
    /// Whether the pose is on its way back to the tracker's after a gap.
    pub is_blended: bool,
    /// Whether the pose is extrapolated from the newest frame.
    pub is_predicted: bool,
    /// Whether the pose is the tracker's own of this instant, except for the output's origin, axes
    /// and units.
    pub is_passed: bool,
}

impl BodyReport {
    /// Whether the last pose is repeated.
    pub fn is_held(&self) -> bool {
        self.held.is_some()
    }

    /// Returns 1 for measured, 0.5 for predicted or on its way back, 0 for unreliable, including a
    /// repeated pose.
    pub fn confidence(&self) -> f32 {
        match self.state {
            _ if self.is_held() => 0.0,
            State::Tracking => 1.0,
            State::Coasting => 0.5,
            State::Searching | State::Lost | State::Stale => 0.0,
        }
    }

    /// Returns the most important mark as one word, for formats that carry only one.
    pub fn word(&self) -> &'static str {
        match self.state {
            _ if self.withheld.is_some() => "withheld",
            State::Coasting if self.is_blended => "blended",
            State::Searching | State::Lost if self.is_held() => "held",
            state => state.word(),
        }
    }
}

/// What is known of an instant's timecode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ReportedTimecode {
    /// No timecode is configured; formats that need one send the time of day.
    TimeOfDay,
    /// It is configured, but not known at this instant.
    Unknown,
    /// The timecode of the instant.
    Known(StampedTimecode),
}

/// Everything that one output reports at one instant.
#[derive(Debug, Clone)]
pub struct Report {
    /// The sample's number; on a fixed rate, the tick's.
    pub sequence: u64,
    /// The instant of the poses, in Unix time.
    pub unix: Timestamp,
    /// The same instant on the monotonic clock.
    pub monotonic: Timestamp,
    /// Time of sending, on the monotonic clock.
    pub sent_monotonic: Timestamp,
    /// The same instant on the clip's clock, if a clip is replayed.
    pub recorded: Option<Timestamp>,
    /// Timecode of the instant.
    pub timecode: ReportedTimecode,
    /// Zoom and focus of another device, if they are passed on.
    pub rings: Rings,
    /// What the system's clock is worth, if the kernel tells.
    pub clock: Option<ClockQuality>,
    /// Whether the instant is a tick on the clock's frames.
    pub is_on_clock: bool,
    /// Samples per second, as far as known.
    pub rate_hz: f64,
    /// The output's bodies in its order; the first is the main one.
    pub bodies: Vec<BodyReport>,
    /// The tracker's sample; `None` on a fixed rate and in a stale marker.
    pub sample: Option<Arc<PoseSample>>,
    /// Milliseconds from the instant to sending.
    pub age_ms: f64,
    /// Whether the poses are invented, for setting up the receiver.
    pub is_test: bool,
}
