//! The pose stage itself: one body estimate after another, the stage first.

use nalgebra::Matrix6;

use super::covariance::{covariance_of_camera, covariance_of_object};
use super::prediction::MotionHistory;
use crate::geometry::{Body, Camera, Pose, Stage};
use crate::track::{BodySighting, LockState, Sighting};

/// What is said of one pose after a frame.
#[derive(Debug, Clone)]
pub struct BodyEstimate<From> {
    /// The state to publish.
    pub state: LockState,
    /// For use: measured, or predicted while coasting.
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
#[derive(Debug, Default)]
pub struct PoseStage {
    camera: MotionHistory<Stage, Camera>,
    objects: Vec<MotionHistory<Stage, Body>>,
}

impl PoseStage {
    /// Takes the sighting of the next frame.
    pub fn estimate(&mut self, sighting: &Sighting) -> PoseEstimate {
        self.objects.resize_with(sighting.objects.len(), MotionHistory::default);
        if !sighting.is_timed {
            return PoseEstimate { camera: unseen(&self.camera), objects: self.objects.iter().map(unseen).collect() };
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
            .map(|(object, history)| object_estimate(object, &camera, sighting.timestamp_ns, history))
            .collect();
        PoseEstimate { camera, objects }
    }
}

/// An object is not tracking while the stage is not: its pose in the stage needs the camera's.
fn object_estimate(
    object: &BodySighting,
    camera: &BodyEstimate<Camera>,
    timestamp_ns: i64,
    history: &mut MotionHistory<Stage, Body>,
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
    settle(state, measured, timestamp_ns, history)
}

/// Fits pose and state together: measured while tracking, predicted while coasting, nothing else.
fn settle<From>(
    state: LockState,
    measured: Option<(Pose<Stage, From>, Matrix6<f64>)>,
    timestamp_ns: i64,
    history: &mut MotionHistory<Stage, From>,
) -> BodyEstimate<From> {
    if let (LockState::Tracking, Some((pose, covariance))) = (state, measured) {
        history.measured(timestamp_ns, &pose);
        return BodyEstimate { state, pose: Some(pose), measured: Some((pose, covariance)) };
    }
    let predicted = history.predicted(timestamp_ns).filter(|_| matches!(state, LockState::Tracking | LockState::Coasting));
    if let Some(pose) = predicted {
        return BodyEstimate { state: LockState::Coasting, pose: Some(pose), measured: None };
    }
    history.reset();
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
