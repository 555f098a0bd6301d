//! Filters: what happens between the measured pose and the one that is given for use.
//!
//! Off by default: then `pose` equals `measured`. A filter calms a pose down, at the price of a delay, and estimates the velocity that a
//! prediction needs. Whatever the filter says, a prediction reaches no further than recent measurements support: at most `PREDICTED_WAYS`
//! times as far as the body moved, in its direction, within the time it reaches ahead. So a jump is never blown up by more than that, and a body
//! that stands has no prediction as soon as it has stood for that time. Nothing is carried across a loss. The covariance in the
//! record stays that of the measurement.

mod evenness;
mod fading;
mod follower;
mod kalman;
mod memories;
mod one_euro;
mod place;

use nalgebra::{Matrix6, Vector3};

use crate::frame::Timestamp;
use crate::geometry::{Pose, Stage};
use crate::motion::{FADE_S, Motion, Reach};
use kalman::Kalman;
use one_euro::OneEuro;

pub use kalman::KalmanSettings;
pub use one_euro::OneEuroSettings;

/// `[filter]`
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct FilterSettings {
    /// Which filter.
    pub kind: FilterKind,
    /// The pose is predicted for this long after the frame, seconds: about the time until it is seen or moved by.
    pub predict_s: f64,
}

/// Which filter.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub enum FilterKind {
    /// The pose is the measured one.
    #[default]
    Off,
    /// A low-pass whose cutoff rises with speed.
    OneEuro(OneEuroSettings),
    /// Constant acceleration with a fading memory, weighted by the measurement's covariance.
    Kalman(KalmanSettings),
}

/// Longest reach of a prediction, in shares of how far the body moved within the time it reaches ahead. 1 would cut predictions
/// short wherever a body speeds up; more lets a jump that is taken for a motion swing out by more.
const PREDICTED_WAYS: f64 = 2.0;
/// Stamps further apart than this are no continuation, seconds, unless the frame intervals themselves are that long: by then a hand may
/// have turned back. Raised, a filter carries an old motion across gaps; lowered, brief hiccups start it anew.
const LONGEST_STEP_S: f64 = 0.25;
/// This many frame intervals are always a continuation: one dropped frame, and some
/// unevenness. Raised, slow cameras are filtered across more dropped frames.
const LONGEST_STEP_FRAMES: f64 = 2.5;
/// No continuation, however long the frame intervals are, seconds. Raised, clips of stills are filtered as if they were one motion.
const NO_CONTINUATION_S: f64 = 1.0;

/// The filter of one body.
#[derive(Debug, Clone)]
pub(super) struct PoseFilter<From> {
    settings: FilterSettings,
    running: Option<Running<From>>,
    /// What bounds predictions.
    reach: Reach<Stage, From>,
}

/// A filter between two measurements.
#[derive(Debug, Clone)]
struct Running<From> {
    last: Timestamp,
    /// The last two frame intervals, seconds, as far as they are known.
    intervals_s: [Option<f64>; 2],
    state: State<From>,
}

#[derive(Debug, Clone)]
enum State<From> {
    OneEuro(OneEuro<From>),
    Kalman(Box<Kalman>),
}

impl<From> PoseFilter<From> {
    pub fn new(settings: FilterSettings) -> Self {
        Self { settings, running: None, reach: Reach::default() }
    }

    /// Takes the measurement of a stamp and gives the pose for use.
    pub fn measured(&mut self, timestamp: Timestamp, pose: &Pose<Stage, From>, covariance: &Matrix6<f64>) -> Pose<Stage, From> {
        if self.settings.kind == FilterKind::Off {
            return *pose;
        }
        let (mut intervals_s, mut continued) = ([None; 2], None);
        if let Some(mut running) = self.running.take() {
            let step_s = timestamp.seconds_since(running.last);
            if step_s > 0.0 {
                intervals_s = [Some(step_s), running.intervals_s[0]];
                if step_s <= running.longest_step_s() {
                    running.state.update(timestamp, step_s, pose, covariance);
                    continued = Some(running.state);
                }
            }
        }
        let state = continued.unwrap_or_else(|| {
            self.reach.clear();
            State::start(&self.settings, pose, covariance)
        });
        self.reach.push(timestamp, pose);
        let running = Running { last: timestamp, intervals_s, state };
        let told = self.after(&running, 0.0);
        self.running = Some(running);
        // A measurement that overflows the filter's numbers ends the filter, not the tracking.
        if told.is_finite() {
            return told;
        }
        self.reset();
        *pose
    }

    /// The pose of a stamp without a measurement.
    pub fn predicted(&self, timestamp: Timestamp) -> Option<Pose<Stage, From>> {
        let running = self.running.as_ref()?;
        let gap_s = timestamp.seconds_since(running.last);
        Some(self.after(running, gap_s)).filter(Pose::is_finite)
    }

    /// A loss: what comes next is no continuation.
    pub fn reset(&mut self) {
        self.running = None;
        self.reach.clear();
    }

    /// The pose for use so long after the last measurement. The prediction fades, and so does the velocity that carries the pose on: it
    /// goes on by at most as much as the body moved within the last `FADE_S`.
    fn after(&self, running: &Running<From>, gap_s: f64) -> Pose<Stage, From> {
        let motion = running.state.motion();
        let predict_s = self.settings.predict_s;
        let fade = (-gap_s.max(0.0) / FADE_S).exp();
        let ahead =
            |velocity: Vector3<f64>, acceleration: Vector3<f64>| velocity * predict_s + acceleration * (predict_s * predict_s / 2.0);
        let ahead = [ahead(motion.velocity, motion.acceleration), ahead(motion.turn_rate, motion.turn_acceleration)];
        let ahead = self.reach.supports(ahead, PREDICTED_WAYS, predict_s);
        let on = self.reach.carries([motion.velocity, motion.turn_rate], FADE_S);
        let [way, turn] = [0, 1].map(|part| ahead[part] * fade + on[part] * (1.0 - fade));
        motion.pose.moved(&way, &turn)
    }
}

impl<From> Running<From> {
    /// Stamps further apart are no continuation.
    fn longest_step_s(&self) -> f64 {
        let interval_s = self.intervals_s.iter().flatten().copied().fold(f64::INFINITY, f64::min);
        if interval_s.is_finite() { (LONGEST_STEP_FRAMES * interval_s).clamp(LONGEST_STEP_S, NO_CONTINUATION_S) } else { LONGEST_STEP_S }
    }
}

impl<From> State<From> {
    fn start(settings: &FilterSettings, pose: &Pose<Stage, From>, covariance: &Matrix6<f64>) -> Self {
        match settings.kind {
            FilterKind::Kalman(kalman) => Self::Kalman(Box::new(Kalman::start(kalman, settings.predict_s, pose, covariance))),
            FilterKind::OneEuro(one_euro) => Self::OneEuro(OneEuro::start(one_euro, pose)),
            // Never asked for.
            FilterKind::Off => Self::OneEuro(OneEuro::start(OneEuroSettings::default(), pose)),
        }
    }

    fn update(&mut self, timestamp: Timestamp, step_s: f64, pose: &Pose<Stage, From>, covariance: &Matrix6<f64>) {
        match self {
            Self::OneEuro(filter) => filter.update(step_s, pose),
            Self::Kalman(filter) => filter.update(timestamp, step_s, pose, covariance),
        }
    }

    fn motion(&self) -> Motion<Stage, From> {
        match self {
            Self::OneEuro(filter) => filter.motion,
            Self::Kalman(filter) => filter.motion(),
        }
    }
}

#[cfg(test)]
mod scenario_tests;
#[cfg(test)]
mod tests;
