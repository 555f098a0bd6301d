//! One body on one output: turns the tracker's pose into the pose that is sent, through rate,
//! safety and placement.

use std::sync::Arc;
use std::time::Duration;

use crossbeam_channel::Sender;
use nalgebra::Vector3;

use super::complaints::Complaints;
use super::limiter::{Limiter, Verdict};
use super::mounted::Mount;
use super::placement::Placement;
use super::report::{BodyChoice, BodyReport, Withheld};
use super::resample::{Known, Resampler};
use super::settings::{OnLoss, OutputSettings, Rate, SafetySettings};
use crate::frame::Timestamp;
use crate::geometry::{Body, Pose, Stage};
use crate::motion::Motion;
use crate::protocols::to_body_axes;
use crate::record::{PoseSample, State};

/// Maximum step between two poses of which a velocity is made, seconds. Chosen: four frames a
/// second still have one. Raised, an average over a longer time is sent as the velocity of now.
const LONGEST_STEP_S: f64 = 0.25;

/// Event: the safety limits began to withhold a body's pose.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseWithheld {
    /// The output's name.
    pub output: String,
    /// The body's name.
    pub body: String,
    /// The reason.
    pub reason: Withheld,
}

/// The state of one body on one output.
pub(super) struct BodyChannel {
    name: Arc<str>,
    choice: BodyChoice,
    mount: Option<Mount>,
    limiter: Limiter,
    resampler: Resampler,
    /// The last pose sent, and its instant.
    sent: Option<(Timestamp, Pose<Stage, Body>)>,
    /// Of the report before, the tracker's own pose as it was sent.
    passed: Option<(Timestamp, Pose<Stage, Body>)>,
    placement: Placement,
    on_loss: OnLoss,
    complaints: Complaints,
    output: String,
    events: Sender<PoseWithheld>,
    is_withheld: bool,
}

impl BodyChannel {
    /// Creates the channel of a body on an output; it reports to `events` when its limits begin to
    /// withhold the pose.
    pub fn new(
        (name, choice): (Arc<str>, BodyChoice),
        mount: Option<Mount>,
        limits: SafetySettings,
        output: &OutputSettings,
        events: Sender<PoseWithheld>,
    ) -> Self {
        let delay = match output.rate {
            Rate::Fixed { delay, .. } => delay,
            Rate::Every(_) => output.delay,
        };
        Self {
            name,
            choice,
            mount,
            limiter: Limiter::new(limits),
            resampler: Resampler::new(delay),
            sent: None,
            passed: None,
            placement: output.placement,
            on_loss: output.on_loss,
            complaints: Complaints::new(&output.name),
            output: output.name.clone(),
            events,
            is_withheld: false,
        }
    }

    /// Returns what a sample states about this body.
    pub fn known(&self, sample: &PoseSample) -> Known {
        match (self.choice, self.mount) {
            (BodyChoice::Mount, Some(mount)) => {
                let carrier = known_of(mount.carrier, sample);
                Known { pose: carrier.pose.map(|pose| mount.carried(&pose)), ..carrier }
            }
            (choice, _) => known_of(choice, sample),
        }
    }

    /// Keeps what a sample stated for later ticks.
    pub fn keep(&mut self, at: Timestamp, known: Known) {
        self.resampler.push(at, known);
    }

    /// Returns what is known at a tick, with frames `interval` apart.
    pub fn at(&self, at: Timestamp, interval: Duration) -> Known {
        self.resampler.at(at, interval)
    }

    /// Returns the report to send. `holds` tells whether the protocol can represent a pose.
    pub fn report(&mut self, at: Timestamp, known: Known, holds: &dyn Fn(&Pose<Stage, Body>) -> bool) -> BodyReport {
        let mut report = BodyReport {
            name: self.name.clone(),
            choice: self.choice,
            state: known.state,
            withheld: None,
            pose: None,
            velocity: None,
            held: None,
            is_blended: false,
            is_predicted: known.is_predicted,
            is_passed: false,
        };
        match known.pose.map(|pose| self.judged(at, &pose, holds)) {
            Some(Verdict::Pass(pose)) => (report.pose, report.is_passed) = (Some(self.placement.apply(&pose)), true),
            Some(Verdict::Blend(pose)) => {
                report.pose = Some(self.placement.apply(&pose));
                (report.state, report.is_blended, report.is_predicted) = (State::Coasting, true, false);
            }
            Some(Verdict::Withhold(reason)) => self.withhold(reason, &mut report),
            None => self.limiter.gap(),
        }
        self.is_withheld = report.withheld.is_some();
        let passed = report.pose.filter(|_| report.is_passed).map(|pose| (at, pose));
        let before = std::mem::replace(&mut self.passed, passed);
        report.velocity = before.zip(passed).and_then(|(before, passed)| velocity(&before, &passed));
        match (report.pose, self.sent) {
            (Some(pose), _) => self.sent = Some((at, pose)),
            (None, Some((sent, pose))) if self.on_loss == OnLoss::Hold => {
                (report.pose, report.held, report.is_predicted) = (Some(pose), Some(at.duration_since(sent)), false);
            }
            (None, _) => report.is_predicted = false,
        }
        report
    }

    fn judged(&mut self, at: Timestamp, pose: &Pose<Stage, Body>, holds: &dyn Fn(&Pose<Stage, Body>) -> bool) -> Verdict {
        if pose.is_finite() && !holds(&self.placement.apply(pose)) {
            self.limiter.gap();
            return Verdict::Withhold(Withheld::OutOfRange);
        }
        self.limiter.judge(at, pose)
    }

    fn withhold(&mut self, reason: Withheld, report: &mut BodyReport) {
        (report.state, report.withheld) = (State::Lost, Some(reason));
        self.complaints
            .say(|| format!("event: the pose of {} is withheld, {}; check [safety] and the tracking", self.name, reason.words()));
        if !self.is_withheld {
            // The receiver may be gone or full; the log has the event too.
            let _ = self.events.try_send(PoseWithheld { output: self.output.clone(), body: self.name.to_string(), reason });
        }
    }
}

/// Returns the velocity and the angular velocity between two poses that are sent, if they are near
/// enough in time to tell it.
fn velocity(before: &(Timestamp, Pose<Stage, Body>), now: &(Timestamp, Pose<Stage, Body>)) -> Option<[Vector3<f64>; 2]> {
    let step_s = now.0.seconds_since(before.0);
    let motion = || Motion::between(&before.1, &now.1, step_s);
    (step_s > 0.0 && step_s <= LONGEST_STEP_S).then(motion).map(|motion| [motion.velocity, motion.angular_velocity])
}

/// Returns what a sample states about a body that is tracked itself.
fn known_of(choice: BodyChoice, sample: &PoseSample) -> Known {
    let (state, pose) = match choice {
        BodyChoice::Camera => (sample.state, sample.pose.as_ref().map(to_body_axes)),
        BodyChoice::Object(index) => match sample.objects.get(index) {
            Some(object) => (object.state, object.pose),
            None => return Known::nothing(State::Searching),
        },
        // No mount is configured.
        BodyChoice::Mount => return Known::nothing(State::Searching),
    };
    Known { state, pose, is_predicted: false }
}
