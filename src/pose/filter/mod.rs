//! Filters: what happens between the measured pose and the one that is given for use.
//!
//! Off by default: then `pose` equals `measured`. A filter calms a pose down, at the price of a delay, and estimates the velocity that a
//! prediction needs. Nothing is carried across a loss. The covariance in the record stays that of the measurement.

mod kalman;
mod one_euro;

use nalgebra::{Matrix6, UnitQuaternion, Vector3};

use crate::geometry::{Pose, Stage};
use kalman::Kalman;
use one_euro::OneEuro;

pub use kalman::KalmanSettings;
pub use one_euro::OneEuroSettings;

/// `[filter]`
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FilterSettings {
    /// Which filter.
    pub kind: FilterKind,
    /// The pose is told for this long after the frame, seconds: about the time until it is seen or moved by.
    pub predict_s: f64,
}

/// Which filter.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum FilterKind {
    /// The pose is the measured one.
    #[default]
    Off,
    /// A low-pass whose cutoff rises with speed.
    OneEuro(OneEuroSettings),
    /// Constant velocity on SE(3), weighted by the measurement's covariance.
    Kalman(KalmanSettings),
}

/// A pose with its velocities, in stage axes.
#[derive(Debug, Clone, Copy)]
struct Motion<From> {
    pose: Pose<Stage, From>,
    /// Metres per second.
    velocity: Vector3<f64>,
    /// Radians per second.
    turn_rate: Vector3<f64>,
}

impl<From> Motion<From> {
    fn at_rest(pose: Pose<Stage, From>) -> Self {
        Self { pose, velocity: Vector3::zeros(), turn_rate: Vector3::zeros() }
    }

    /// The pose after moving on for `seconds`.
    fn after(&self, seconds: f64) -> Pose<Stage, From> {
        let turn = UnitQuaternion::from_scaled_axis(self.turn_rate * seconds);
        Pose::new(turn * self.pose.rotation, self.pose.translation + self.velocity * seconds)
    }
}

/// Stamps further apart than this are no continuation, seconds.
const LONGEST_STEP_S: f64 = 0.25;
/// Without measurements the velocity fades with this time constant, seconds, as it does without a filter.
const FADE_S: f64 = 0.2;

/// The filter of one body.
#[derive(Debug, Clone)]
pub(super) struct PoseFilter<From> {
    settings: FilterSettings,
    state: Option<(i64, State<From>)>,
}

#[derive(Debug, Clone)]
enum State<From> {
    OneEuro(OneEuro<From>),
    Kalman(Box<Kalman<From>>),
}

impl<From> PoseFilter<From> {
    pub fn new(settings: FilterSettings) -> Self {
        Self { settings, state: None }
    }

    /// Takes the measurement of a stamp and gives the pose for use.
    pub fn measured(&mut self, timestamp_ns: i64, pose: &Pose<Stage, From>, covariance: &Matrix6<f64>) -> Pose<Stage, From> {
        let step_s = self.state.as_ref().map(|(last_ns, _)| timestamp_ns.saturating_sub(*last_ns) as f64 * 1e-9);
        let state = match (self.state.take(), self.settings.kind) {
            (_, FilterKind::Off) => return *pose,
            (Some((_, mut state)), _) if step_s.is_some_and(|dt| dt > 0.0 && dt <= LONGEST_STEP_S) => {
                state.update(step_s.unwrap_or(0.0), pose, covariance);
                state
            }
            (_, FilterKind::OneEuro(settings)) => State::OneEuro(OneEuro::start(settings, pose)),
            (_, FilterKind::Kalman(settings)) => State::Kalman(Box::new(Kalman::start(settings, pose, covariance))),
        };
        let told = state.motion().after(self.settings.predict_s);
        self.state = Some((timestamp_ns, state));
        // A measurement that overflows the filter's numbers ends the filter, not the tracking.
        if told.is_finite() {
            return told;
        }
        self.reset();
        *pose
    }

    /// The pose of a stamp without a measurement.
    pub fn predicted(&self, timestamp_ns: i64) -> Option<Pose<Stage, From>> {
        let (last_ns, state) = self.state.as_ref()?;
        let gap_s = timestamp_ns.saturating_sub(*last_ns) as f64 * 1e-9;
        let fade = (-gap_s / FADE_S).exp();
        let pose = state.motion().after(FADE_S * (1.0 - fade) + self.settings.predict_s * fade);
        pose.is_finite().then_some(pose)
    }

    /// A loss: what comes next is no continuation.
    pub fn reset(&mut self) {
        self.state = None;
    }
}

impl<From> State<From> {
    fn update(&mut self, step_s: f64, pose: &Pose<Stage, From>, covariance: &Matrix6<f64>) {
        match self {
            Self::OneEuro(filter) => filter.update(step_s, pose),
            Self::Kalman(filter) => filter.update(step_s, pose, covariance),
        }
    }

    fn motion(&self) -> &Motion<From> {
        match self {
            Self::OneEuro(filter) => &filter.motion,
            Self::Kalman(filter) => &filter.motion,
        }
    }
}

#[cfg(test)]
mod tests;
