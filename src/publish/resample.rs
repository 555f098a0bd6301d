//! Resampling: the pose of a body at any instant, interpolated between two samples or briefly
//! extrapolated after the last.
//!
//! A fixed-rate output asks for its own ticks. A tick is `tracking` only if a measurement supports
//! it: between two consecutive measured frames, or at most one frame interval after the newest one.
//! Inside a gap, and further out, it is `coasting`; across a loss nothing is interpolated. Samples,
//! including losses, are kept as long as a delayed tick may need them.

use std::collections::VecDeque;
use std::time::Duration;

use crate::frame::Timestamp;
use crate::geometry::{Body, Pose, Stage};
use crate::motion::Motion;
use crate::record::State;

/// Minimum number of samples kept, for estimating the motion, and the maximum: a delay of half a
/// second at far more frames per second than cameras have. Chosen, not tuned. Raising the first
/// only takes memory; lowering the second leaves fast sources too few for the delay.
const MIN_KEPT: usize = 8;
const MAX_KEPT: usize = 2048;
/// Maximum distance of samples for interpolation: this, or 2.5 frame intervals if longer (chosen:
/// in a quarter of a second a camera may stop and turn back). Raised, poses are made up across
/// longer gaps.
const MAX_GAP: Duration = Duration::from_millis(250);
/// Maximum extrapolation: this, or 1.5 frame intervals if longer. Chosen, not tuned: the error
/// grows with the square of the time. Raised, the last motion continues longer after a loss.
const MAX_REACH: Duration = Duration::from_millis(100);
/// Tolerance on the frame interval for scatter of the stamps (chosen: more than drivers' stamps
/// scatter, little compared with an interval). Lowered, ticks flicker between tracking and
/// coasting.
const JITTER: Duration = Duration::from_millis(1);

/// What a sample or a tick states about a body.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known {
    pub state: State,
    pub pose: Option<Pose<Stage, Body>>,
    /// Whether it is extrapolated from the newest frame.
    pub is_predicted: bool,
}

impl Known {
    /// Creates an entry without a pose, for this reason.
    pub fn nothing(state: State) -> Self {
        Self { state, pose: None, is_predicted: false }
    }
}

/// What one sample stated about the body.
#[derive(Debug, Clone, Copy)]
struct Moment {
    at: Timestamp,
    state: State,
    pose: Option<Pose<Stage, Body>>,
}

/// The last samples of one body.
#[derive(Debug, Clone)]
pub(super) struct Resampler {
    moments: VecDeque<Moment>,
    kept: Duration,
}

impl Resampler {
    /// Creates a resampler for ticks that ask for poses at most `delay` old.
    pub fn new(delay: Duration) -> Self {
        Self { moments: VecDeque::new(), kept: delay.saturating_add(MAX_GAP) }
    }

    /// Adds what a sample stated; ignores stamps that do not increase.
    pub fn push(&mut self, at: Timestamp, known: Known) {
        if self.moments.back().is_some_and(|last| last.at >= at) {
            return;
        }
        self.moments.push_back(Moment { at, state: known.state, pose: known.pose });
        let is_over = |first: &Moment, kept: usize| kept > MAX_KEPT || kept > MIN_KEPT && at.duration_since(first.at) > self.kept;
        while self.moments.front().is_some_and(|first| is_over(first, self.moments.len())) {
            self.moments.pop_front();
        }
    }

    /// Returns what is known at an instant, with frames `interval` apart.
    pub fn at(&self, at: Timestamp, interval: Duration) -> Known {
        let after = self.moments.partition_point(|m| m.at <= at);
        let Some((index, before)) = after.checked_sub(1).and_then(|index| Some((index, self.moments.get(index)?))) else {
            return Known::nothing(State::Searching);
        };
        let Some(pose) = before.pose else { return Known::nothing(before.state) };
        if before.at == at {
            return Known { state: before.state, pose: Some(pose), is_predicted: false };
        }
        let later = self.moments.get(after);
        if let Some(Moment { at: next_at, state, pose: Some(next) }) = later {
            let step = next_at.duration_since(before.at);
            if step <= longest(MAX_GAP, interval, 5) {
                // A longer step contains lost frames.
                let is_whole = step <= longest(Duration::ZERO, interval, 3);
                let is_measured = before.state == State::Tracking && *state == State::Tracking;
                let state = if is_whole && is_measured { State::Tracking } else { State::Coasting };
                return Known { state, pose: Some(between((before.at, &pose), (*next_at, next), at)), is_predicted: false };
            }
        }
        let beyond = at.duration_since(before.at);
        if beyond > longest(MAX_REACH, interval, 3) {
            return Known::nothing(State::Lost);
        }
        let is_near = later.is_none() && before.state == State::Tracking && beyond <= interval.saturating_add(JITTER);
        let state = if is_near { State::Tracking } else { State::Coasting };
        Known { state, pose: Some(self.carried_on(index, &pose, at, interval)), is_predicted: is_near }
    }

    /// Extrapolates the pose of a sample. The motion is taken from samples of the same state, since
    /// a step from a prediction to a measurement is not a motion, and at least half a frame
    /// interval apart, so that noise is not amplified.
    fn carried_on(&self, index: usize, pose: &Pose<Stage, Body>, at: Timestamp, interval: Duration) -> Pose<Stage, Body> {
        let Some(last) = self.moments.get(index) else { return *pose };
        for earlier in self.moments.range(..index).rev() {
            let step = last.at.duration_since(earlier.at);
            let Some(before) = earlier.pose.filter(|_| step <= longest(MAX_GAP, interval, 5)) else { break };
            if earlier.state == last.state && step >= interval / 2 {
                return between((earlier.at, &before), (last.at, pose), at);
            }
        }
        *pose
    }
}

/// Returns the larger of `least` and `halves` half frame intervals.
fn longest(least: Duration, interval: Duration, halves: u32) -> Duration {
    least.max(interval.saturating_mul(halves) / 2)
}

/// Interpolates or extrapolates at constant velocity through two poses.
fn between(a: (Timestamp, &Pose<Stage, Body>), b: (Timestamp, &Pose<Stage, Body>), at: Timestamp) -> Pose<Stage, Body> {
    Motion::between(a.1, b.1, b.0.seconds_since(a.0)).after(at.seconds_since(b.0)).pose
}

#[cfg(test)]
#[path = "resample_tests.rs"]
mod tests;
