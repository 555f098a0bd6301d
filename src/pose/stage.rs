//! The pose stage itself: one body estimate after another, the stage first.

use nalgebra::Matrix6;

use super::covariance::{covariance_of_camera, covariance_of_object};
use super::filter::{FilterSettings, PoseFilter};
use super::prediction::MotionHistory;
use crate::geometry::{Body, Camera, Pose, Stage};
use crate::track::{BodySighting, LockState, Sighting};

/// What is said of one pose after a frame.
#[derive(Debug, Clone)]
pub struct BodyEstimate<From> {
    /// The state to publish.
    pub state: LockState,
    /// For use: measured (filtered where a filter is set), or predicted while coasting.
    pub pose: Option<Pose<Stage, From>>,
    /// Measured in this frame, with the covariance of [δp, δθ] in stage axes.
    pub measured: Option<(Pose<Stage, From>, Matrix6<f64>)>,
}

/// What is said of the camera and the objects after a frame.
#[derive(Debug, Clone)]
pub struct PoseEstimate {
    /// `T_stage_camera`.
    pub camera: BodyEstimate<Camera>,
    /// `T_stage_object` of each object.
    pub objects: Vec<BodyEstimate<Body>>,
}

/// Turns sightings into estimates; remembers motion for the prediction.
#[derive(Debug)]
pub struct PoseStage {
    filter: FilterSettings,
    camera: BodyMotion<Camera>,
    objects: Vec<BodyMotion<Body>>,
}

/// What is remembered of one body's motion.
#[derive(Debug)]
struct BodyMotion<From> {
    history: MotionHistory<Stage, From>,
    filter: PoseFilter<From>,
}

impl<From> BodyMotion<From> {
    fn new(filter: FilterSettings) -> Self {
        Self { history: MotionHistory::default(), filter: PoseFilter::new(filter) }
    }
}

impl Default for PoseStage {
    /// Without a filter.
    fn default() -> Self {
        Self::with_filter(FilterSettings::default())
    }
}

impl PoseStage {
    /// With the filter that `[filter]` asks for, one for every body.
    pub fn with_filter(filter: FilterSettings) -> Self {
        Self { filter, camera: BodyMotion::new(filter), objects: Vec::new() }
    }

    /// Takes the sighting of the next frame.
    pub fn estimate(&mut self, sighting: &Sighting) -> PoseEstimate {
        let filter = self.filter;
        self.objects.resize_with(sighting.objects.len(), || BodyMotion::new(filter));
        if !sighting.is_timed {
            return PoseEstimate {
                camera: unseen(&self.camera.history),
                objects: self.objects.iter().map(|o| unseen(&o.history)).collect(),
            };
        }
        let seen = sighting.stage.verified.as_ref().map(|v| {
            // The stage's body frame is the stage frame.
            let t_camera_stage: Pose<Camera, Stage> = v.pose.renamed();
            (t_camera_stage.inverse(), covariance_of_camera(&t_camera_stage, &v.covariance))
        });
        let camera = settle(sighting.stage.state, seen, sighting.timestamp_ns, &mut self.camera);
        let objects = sighting
            .objects
            .iter()
            .zip(&mut self.objects)
            .map(|(object, motion)| object_estimate(object, &camera, sighting.timestamp_ns, motion))
            .collect();
        PoseEstimate { camera, objects }
    }
}

/// An object is not tracking while the stage is not: its pose in the stage needs the camera's.
fn object_estimate(
    object: &BodySighting,
    camera: &BodyEstimate<Camera>,
    timestamp_ns: i64,
    motion: &mut BodyMotion<Body>,
) -> BodyEstimate<Body> {
    let state = match (object.state, camera.state) {
        (LockState::Tracking, LockState::Tracking) => LockState::Tracking,
        (LockState::Tracking | LockState::Coasting, LockState::Coasting | LockState::Tracking) => LockState::Coasting,
        (LockState::Tracking | LockState::Coasting, _) => LockState::Lost,
        (state, _) => state,
    };
    let measured = match (&object.verified, &camera.measured) {
        (Some(v), Some((t_stage_camera, covariance))) => {
            Some((*t_stage_camera * v.pose, covariance_of_object(t_stage_camera, covariance, &v.pose, &v.covariance)))
        }
        _ => None,
    };
    settle(state, measured, timestamp_ns, motion)
}

/// Fits pose and state together: measured while tracking, predicted while coasting, nothing else.
fn settle<From>(
    state: LockState,
    measured: Option<(Pose<Stage, From>, Matrix6<f64>)>,
    timestamp_ns: i64,
    motion: &mut BodyMotion<From>,
) -> BodyEstimate<From> {
    let BodyMotion { history, filter } = motion;
    if let (LockState::Tracking, Some((pose, covariance))) = (state, measured) {
        history.measured(timestamp_ns, &pose);
        let told = filter.measured(timestamp_ns, &pose, &covariance);
        return BodyEstimate { state, pose: Some(told), measured: Some((pose, covariance)) };
    }
    let predicted = history.predicted(timestamp_ns).filter(|_| matches!(state, LockState::Tracking | LockState::Coasting));
    if let Some(pose) = predicted {
        let pose = filter.predicted(timestamp_ns).unwrap_or(pose);
        return BodyEstimate { state: LockState::Coasting, pose: Some(pose), measured: None };
    }
    history.reset();
    filter.reset();
    unseen(history)
}

/// Nothing to say of a body but whether it was ever measured in the stage.
fn unseen<From>(history: &MotionHistory<Stage, From>) -> BodyEstimate<From> {
    let state = if history.is_known() { LockState::Lost } else { LockState::Searching };
    BodyEstimate { state, pose: None, measured: None }
}

#[cfg(test)]
#[path = "stage_tests.rs"]
mod tests;
