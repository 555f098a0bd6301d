//! What is known of a body at any instant, from the samples around it: interpolated between two, or carried on for a moment after the last.
//!
//! A fixed-rate output asks for its own ticks. A tick is `tracking` only where a measurement stands behind it: between two measured
//! frames that follow one another, or at most one frame interval after the newest one. Inside a gap, and further on, it is `coasting`;
//! across a loss nothing is made up. Samples stay known for as long as a delayed tick may ask for them, losses included.

use std::collections::VecDeque;

use super::report::Standing;
use crate::geometry::{Body, Pose, Stage};
use crate::motion::Motion;

/// Samples kept at least, for the motion that they show,
const FEWEST_KEPT: usize = 8;
/// and at most: a delay of half a second at far more frames a second than cameras have.
const MOST_KEPT: usize = 2048;
/// Samples further apart have nothing between them: this, or 2.5 frame intervals where those are longer, nanoseconds.
const LONGEST_GAP_NS: i64 = 250_000_000;
/// The motion is carried on for at most this long, or 1.5 frame intervals where those are longer, nanoseconds.
const LONGEST_REACH_NS: i64 = 100_000_000;
/// Stamps scatter; a tick that lies one frame interval and this much after a frame is still within the interval, nanoseconds.
const JITTER_NS: i64 = 1_000_000;

/// What a sample, or a tick, says of a body.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known {
    pub standing: Standing,
    pub pose: Option<Pose<Stage, Body>>,
    /// Carried on from the newest frame.
    pub is_predicted: bool,
}

impl Known {
    /// No pose, for this reason.
    pub fn nothing(standing: Standing) -> Self {
        Self { standing, pose: None, is_predicted: false }
    }
}

/// What one sample said of the body.
#[derive(Debug, Clone, Copy)]
struct Moment {
    at_ns: i64,
    standing: Standing,
    pose: Option<Pose<Stage, Body>>,
}

/// The last samples of one body.
#[derive(Debug, Clone)]
pub(super) struct Resampler {
    moments: VecDeque<Moment>,
    kept_ns: i64,
}

impl Resampler {
    /// For ticks that ask for the pose of at most `delay_ns` ago.
    pub fn new(delay_ns: i64) -> Self {
        Self { moments: VecDeque::new(), kept_ns: delay_ns.saturating_add(LONGEST_GAP_NS) }
    }

    /// Takes what a sample said; stamps that do not rise are passed over.
    pub fn push(&mut self, at_ns: i64, known: Known) {
        if self.moments.back().is_some_and(|last| last.at_ns >= at_ns) {
            return;
        }
        self.moments.push_back(Moment { at_ns, standing: known.standing, pose: known.pose });
        let is_over =
            |first: &Moment, kept: usize| kept > MOST_KEPT || kept > FEWEST_KEPT && at_ns.saturating_sub(first.at_ns) > self.kept_ns;
        while self.moments.front().is_some_and(|first| is_over(first, self.moments.len())) {
            self.moments.pop_front();
        }
    }

    /// What is known at an instant, where frames are `interval_ns` apart.
    pub fn at(&self, at_ns: i64, interval_ns: i64) -> Known {
        let after = self.moments.partition_point(|m| m.at_ns <= at_ns);
        let Some((index, before)) = after.checked_sub(1).and_then(|index| Some((index, self.moments.get(index)?))) else {
            return Known::nothing(Standing::Searching);
        };
        let Some(pose) = before.pose else { return Known::nothing(before.standing) };
        if before.at_ns == at_ns {
            return Known { standing: before.standing, pose: Some(pose), is_predicted: false };
        }
        let later = self.moments.get(after);
        if let Some(Moment { at_ns: later_ns, standing, pose: Some(next) }) = later {
            let step_ns = later_ns.saturating_sub(before.at_ns);
            if step_ns <= longest(LONGEST_GAP_NS, interval_ns, 5) {
                // A longer step has lost frames in it.
                let is_whole = step_ns <= longest(0, interval_ns, 3);
                let is_measured = before.standing == Standing::Tracking && *standing == Standing::Tracking;
                let standing = if is_whole && is_measured { Standing::Tracking } else { Standing::Coasting };
                return Known { standing, pose: Some(between((before.at_ns, &pose), (*later_ns, next), at_ns)), is_predicted: false };
            }
        }
        let beyond_ns = at_ns.saturating_sub(before.at_ns);
        if beyond_ns > longest(LONGEST_REACH_NS, interval_ns, 3) {
            return Known::nothing(Standing::Lost);
        }
        let is_near = later.is_none() && before.standing == Standing::Tracking && beyond_ns <= interval_ns.saturating_add(JITTER_NS);
        let standing = if is_near { Standing::Tracking } else { Standing::Coasting };
        Known { standing, pose: Some(self.carried_on(index, &pose, at_ns, interval_ns)), is_predicted: is_near }
    }

    /// The pose of a sample, carried on by the motion that led to it. The motion is that of samples of one kind, for a step from a
    /// prediction to a measurement is none, and at least half a frame interval apart, so that noise is not made large.
    fn carried_on(&self, index: usize, pose: &Pose<Stage, Body>, at_ns: i64, interval_ns: i64) -> Pose<Stage, Body> {
        let Some(last) = self.moments.get(index) else { return *pose };
        for earlier in self.moments.range(..index).rev() {
            let step_ns = last.at_ns.saturating_sub(earlier.at_ns);
            let Some(before) = earlier.pose.filter(|_| step_ns <= longest(LONGEST_GAP_NS, interval_ns, 5)) else { break };
            if earlier.standing == last.standing && step_ns >= interval_ns / 2 {
                return between((earlier.at_ns, &before), (last.at_ns, pose), at_ns);
            }
        }
        *pose
    }
}

/// A length of time, or so many half frame intervals where those are longer.
fn longest(least_ns: i64, interval_ns: i64, halves: i64) -> i64 {
    least_ns.max(interval_ns.saturating_mul(halves) / 2)
}

/// On the even motion through two poses; beyond the second it goes on.
fn between(a: (i64, &Pose<Stage, Body>), b: (i64, &Pose<Stage, Body>), at_ns: i64) -> Pose<Stage, Body> {
    let seconds = |from_ns: i64, to_ns: i64| to_ns.saturating_sub(from_ns) as f64 * 1e-9;
    Motion::between(a.1, b.1, seconds(a.0, b.0)).after(seconds(b.0, at_ns)).pose
}

#[cfg(test)]
#[path = "resample_tests.rs"]
mod tests;
