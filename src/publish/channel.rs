//! One body on one output: from the tracker's pose to the pose that is sent, through rate, safety and placement.

use std::sync::Arc;

use crossbeam_channel::Sender;

use super::body_pose::body_of_camera;
use super::complaints::Complaints;
use super::limiter::{Limiter, Verdict};
use super::placement::Placement;
use super::report::{BodyReport, Standing, Withheld};
use super::resample::Resampler;
use super::settings::{BodyChoice, OnLoss, OutputSettings, SafetySettings};
use crate::geometry::{Body, Pose, Stage};
use crate::record::PoseSample;

/// What a sample, or a tick, says of a body.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known {
    pub standing: Standing,
    pub pose: Option<Pose<Stage, Body>>,
}

/// The safety limits began to hold a body's pose back.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseWithheld {
    /// The output.
    pub output: String,
    /// The body.
    pub body: String,
    /// Why.
    pub reason: Withheld,
}

/// What belongs to one body between samples.
pub(super) struct BodyChannel {
    name: Arc<str>,
    choice: BodyChoice,
    limiter: Limiter,
    resampler: Resampler,
    /// As the last sample said.
    standing: Standing,
    sent: Option<Pose<Stage, Body>>,
    placement: Placement,
    on_loss: OnLoss,
    complaints: Complaints,
    output: String,
    events: Sender<PoseWithheld>,
    is_withheld: bool,
}

impl BodyChannel {
    /// A body of an output; it tells `events` when its limits begin to hold the pose back.
    pub fn new(name: Arc<str>, choice: BodyChoice, limits: SafetySettings, output: &OutputSettings, events: Sender<PoseWithheld>) -> Self {
        Self {
            name,
            choice,
            limiter: Limiter::new(limits),
            resampler: Resampler::default(),
            standing: Standing::Searching,
            sent: None,
            placement: output.placement,
            on_loss: output.on_loss,
            complaints: Complaints::new(&output.name),
            output: output.name.clone(),
            events,
            is_withheld: false,
        }
    }

    /// What a sample says of this body; a mere prediction counts as nothing where the format cannot mark it.
    pub fn known(&self, sample: &PoseSample, marks_coasting: bool) -> Known {
        let (state, pose) = match self.choice {
            BodyChoice::Camera => (sample.state, sample.pose.as_ref().map(body_of_camera)),
            BodyChoice::Object(index) => match sample.objects.get(index) {
                Some(object) => (object.state, object.pose),
                None => return Known { standing: Standing::Searching, pose: None },
            },
        };
        let standing = Standing::from(state);
        let is_usable = marks_coasting || standing != Standing::Coasting;
        Known { standing, pose: pose.filter(|_| is_usable) }
    }

    /// Keeps a sample for the ticks to come.
    pub fn keep(&mut self, at_ns: i64, known: Known) {
        self.standing = known.standing;
        match known.pose {
            Some(pose) => self.resampler.push(at_ns, pose),
            None => self.resampler.reset(),
        }
    }

    /// What is known at a tick.
    pub fn at(&self, at_ns: i64) -> Known {
        let pose = self.resampler.at(at_ns);
        let standing = match self.standing {
            Standing::Tracking | Standing::Coasting if pose.is_none() => Standing::Lost,
            standing => standing,
        };
        Known { standing, pose }
    }

    /// No frame came for too long: the samples before are no longer a motion.
    pub fn stale(&mut self) -> Known {
        self.resampler.reset();
        Known { standing: Standing::Stale, pose: None }
    }

    /// What is sent of it.
    pub fn report(&mut self, at_ns: i64, known: Known) -> BodyReport {
        let mut report = BodyReport {
            name: self.name.clone(),
            standing: known.standing,
            pose: None,
            is_held: false,
            is_blended: false,
            is_untouched: known.pose.is_some() && self.placement.is_identity(),
        };
        match known.pose.map(|pose| self.limiter.judge(at_ns, &pose)) {
            Some(Verdict::Pass(pose)) => report.pose = Some(self.placement.apply(&pose)),
            Some(Verdict::Blend(pose)) => {
                report.pose = Some(self.placement.apply(&pose));
                (report.standing, report.is_blended, report.is_untouched) = (Standing::Coasting, true, false);
            }
            Some(Verdict::Withhold(reason)) => {
                (report.standing, report.is_untouched) = (Standing::Withheld(reason), false);
                self.complaints
                    .say(|| format!("event: the pose of {} is withheld, {}; check [safety] and the tracking", self.name, reason.words()));
                if !self.is_withheld {
                    // Nobody may be listening, or too late: the log has it too.
                    let _ = self.events.try_send(PoseWithheld { output: self.output.clone(), body: self.name.to_string(), reason });
                }
            }
            None => self.limiter.gap(),
        }
        self.is_withheld = matches!(report.standing, Standing::Withheld(_));
        match report.pose {
            Some(pose) => self.sent = Some(pose),
            None if self.on_loss == OnLoss::Hold => {
                (report.pose, report.is_held, report.is_untouched) = (self.sent, self.sent.is_some(), false)
            }
            None => {}
        }
        report
    }
}
