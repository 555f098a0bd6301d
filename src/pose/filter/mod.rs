//! Filters between the measured pose and the reported one.
//!
//! Off by default: then `pose` equals `measured`. A filter smooths a pose, at the price of a delay,
//! and estimates the velocity that a prediction needs. A prediction never exceeds what recent
//! measurements support: at most `PREDICTED_WAYS` times as far as the body moved, in its direction,
//! within the prediction span. So a jump is never amplified by more than that, and a body that has
//! stood still for that span is not predicted to move. Nothing carries over a loss. The covariance
//! in the record stays that of the measurement.

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

/// The config section `[filter]`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct FilterSettings {
    /// The kind of filter.
    pub kind: FilterKind,
    /// How far past the frame the pose is predicted, seconds: about the time until it is displayed
    /// or acted on.
    pub predict_s: f64,
}

/// The kind of filter.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub enum FilterKind {
    /// No filter: the reported pose is the measured one.
    #[default]
    Off,
    /// A low-pass filter whose cutoff rises with speed.
    OneEuro(OneEuroSettings),
    /// Constant acceleration with fading memory, weighted by the measurement's covariance.
    Kalman(KalmanSettings),
}

/// Maximum reach of a prediction, as a multiple of how far the body moved within the prediction
/// span. At 1, predictions are cut short whenever a body speeds up; raised, a jump mistaken for
/// motion overshoots more.
const PREDICTED_WAYS: f64 = 2.0;
/// Maximum time between stamps for continuity, seconds, unless the frame interval itself is that
/// long: by then a hand may have reversed. Raised, a filter carries old motion across gaps;
/// lowered, brief hiccups restart it.
const MAX_STEP_S: f64 = 0.25;
/// Number of frame intervals that always count as continuous: one dropped frame, and some
/// unevenness. Raised, slow cameras are filtered across more dropped frames.
const MAX_STEP_FRAMES: f64 = 2.5;
/// Time that always breaks continuity, seconds, at any frame interval. Raised, clips of stills are
/// filtered as one motion.
const NO_CONTINUATION_S: f64 = 1.0;

/// The filter of one body.
#[derive(Debug, Clone)]
pub(super) struct PoseFilter<From> {
    settings: FilterSettings,
    running: Option<Running<From>>,
    /// Limits predictions.
    reach: Reach<Stage, From>,
}

/// The filter's state between two measurements.
#[derive(Debug, Clone)]
struct Running<From> {
    last: Timestamp,
    /// The last two frame intervals, seconds, if known.
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

    /// Takes the measurement at a stamp and returns the pose to report.
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
        let output = self.after(&running, 0.0);
        self.running = Some(running);
        // A measurement that overflows the filter's numbers ends the filter, not the tracking.
        if output.is_finite() {
            return output;
        }
        self.reset();
        *pose
    }

    /// Returns the pose at a stamp without a measurement.
    pub fn predicted(&self, timestamp: Timestamp) -> Option<Pose<Stage, From>> {
        let running = self.running.as_ref()?;
        let gap_s = timestamp.seconds_since(running.last);
        Some(self.after(running, gap_s)).filter(Pose::is_finite)
    }

    /// Resets after a loss: the next measurement is not a continuation.
    pub fn reset(&mut self) {
        self.running = None;
        self.reach.clear();
    }

    /// Returns the pose to report this long after the last measurement. The prediction fades, and
    /// so does the velocity that extrapolates the pose: it adds at most what the body moved within
    /// the last `FADE_S`.
    fn after(&self, running: &Running<From>, gap_s: f64) -> Pose<Stage, From> {
        let motion = running.state.motion();
        let predict_s = self.settings.predict_s;
        let fade = (-gap_s.max(0.0) / FADE_S).exp();
        let ahead =
            |velocity: Vector3<f64>, acceleration: Vector3<f64>| velocity * predict_s + acceleration * (predict_s * predict_s / 2.0);
        let ahead = [ahead(motion.velocity, motion.acceleration), ahead(motion.angular_velocity, motion.angular_acceleration)];
        let ahead = self.reach.supports(ahead, PREDICTED_WAYS, predict_s);
        let on = self.reach.carries([motion.velocity, motion.angular_velocity], FADE_S);
        let [way, rotation] = [0, 1].map(|part| ahead[part] * fade + on[part] * (1.0 - fade));
        motion.pose.moved(&way, &rotation)
    }
}

impl<From> Running<From> {
    /// Returns the maximum time between stamps for continuity.
    fn longest_step_s(&self) -> f64 {
        let interval_s = self.intervals_s.iter().flatten().copied().fold(f64::INFINITY, f64::min);
        if interval_s.is_finite() { (MAX_STEP_FRAMES * interval_s).clamp(MAX_STEP_S, NO_CONTINUATION_S) } else { MAX_STEP_S }
    }
}

impl<From> State<From> {
    fn start(settings: &FilterSettings, pose: &Pose<Stage, From>, covariance: &Matrix6<f64>) -> Self {
        match settings.kind {
            FilterKind::Kalman(kalman) => Self::Kalman(Box::new(Kalman::start(kalman, settings.predict_s, pose, covariance))),
            FilterKind::OneEuro(one_euro) => Self::OneEuro(OneEuro::start(one_euro, pose)),
            // Never reached: `Off` has no running filter.
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
