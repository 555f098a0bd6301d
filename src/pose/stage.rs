//! The pose stage itself: estimates one body after another, the stage first.

use nalgebra::Matrix6;

use super::filter::{FilterSettings, PoseFilter};
use super::fixed::{FixedCamera, FixedWatch};
use super::measured::Measured;
use crate::frame::Timestamp;
use crate::geometry::covariance::covariance_of_object;
use crate::geometry::{Body, Camera, Pose, Stage};
use crate::motion::MotionHistory;
use crate::track::{BodyObservation, FrameObservation, State, Verified};

/// The estimate of one body after a frame.
#[derive(Debug, Clone)]
pub struct BodyEstimate<From> {
    /// The state to publish.
    pub state: State,
    /// The pose to report: measured (filtered if configured), or predicted while coasting.
    pub pose: Option<Pose<Stage, From>>,
    /// What was measured in this frame.
    pub measured: Option<Measured<From>>,
}

/// The estimates of the camera and the objects after a frame.
#[derive(Debug, Clone)]
pub struct PoseEstimate {
    /// `T_stage_camera`.
    pub camera: BodyEstimate<Camera>,
    /// `T_stage_object` of each object.
    pub objects: Vec<BodyEstimate<Body>>,
    /// Whether a fixed camera does not stand where it should.
    pub is_moved: bool,
}

/// Turns observations into estimates; keeps the motion history for predictions.
#[derive(Debug)]
pub struct PoseStage {
    filter: FilterSettings,
    /// A camera whose pose is configured.
    fixed: Option<FixedWatch>,
    camera: BodyMotion<Camera>,
    objects: Vec<BodyMotion<Body>>,
}

/// Motion history and filter of one body.
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
    /// Creates the stage with the configured filter, one for every body.
    pub fn with_filter(filter: FilterSettings) -> Self {
        Self { filter, fixed: None, camera: BodyMotion::new(filter), objects: Vec::new() }
    }

    /// Returns the stage with another filter, from the next frame on.
    pub fn filtered(self, filter: FilterSettings) -> Self {
        Self { fixed: self.fixed, ..Self::with_filter(filter) }
    }

    /// Whether the camera's pose is configured.
    pub fn is_fixed(&self) -> bool {
        self.fixed.is_some()
    }

    /// Takes the camera's pose as configured, from the next frame on.
    pub fn fixed(mut self, camera: Option<FixedCamera>) -> Self {
        self.fixed = camera.map(FixedWatch::new);
        self
    }

    /// Processes the observation of the next frame.
    pub fn estimate(&mut self, observation: &FrameObservation) -> PoseEstimate {
        let filter = self.filter;
        self.objects.resize_with(observation.objects.len(), || BodyMotion::new(filter));
        if !observation.is_timed {
            return PoseEstimate {
                camera: unseen(&self.camera.history),
                objects: self.objects.iter().map(|o| unseen(&o.history)).collect(),
                is_moved: self.fixed.as_ref().is_some_and(FixedWatch::is_moved),
            };
        }
        // The stage's body frame is the stage frame.
        let measured = |v: &Verified| Measured { pose: v.pose.renamed(), noise: v.covariance, by_model: v.by_model };
        let seen = observation.stage.verified.as_ref().map(measured);
        let camera = match self.fixed.as_mut().map(|fixed| fixed.look(seen.as_ref())) {
            None => settle(observation.stage.state, seen, observation.timestamp, &mut self.camera),
            Some(measured) => standing(measured, observation.timestamp, &mut self.camera),
        };
        let objects = observation
            .objects
            .iter()
            .zip(&mut self.objects)
            .map(|(object, motion)| object_estimate(object, &camera, observation.timestamp, motion))
            .collect();
        PoseEstimate { camera, objects, is_moved: self.fixed.as_ref().is_some_and(FixedWatch::is_moved) }
    }
}

/// Maximum standard deviation, over all axes, of a reported object pose: of the direction, radians
/// (0.15 degrees, half of what counts as wrong), and of the position as a fraction of its distance
/// from the camera. Less certain poses are not reported; a small object that is nearly occluded or
/// blurred is still followed from frame to frame. Raised, such poses are reported: of poses with a
/// stated sigma of 0.15-0.2 degrees, one in seven is wrong, of those up to 0.3, one in four.
/// Lowered, small objects are reported in fewer frames.
const MAX_ROTATION: f64 = 0.15 * std::f64::consts::PI / 180.0;
const MAX_SHIFT: f64 = 0.01;

/// An object is not tracked while the stage is not, because its stage pose needs the camera's; nor
/// while noise leaves its pose uncertain.
fn object_estimate(
    object: &BodyObservation,
    camera: &BodyEstimate<Camera>,
    timestamp: Timestamp,
    motion: &mut BodyMotion<Body>,
) -> BodyEstimate<Body> {
    let state = match (object.state, camera.state) {
        (State::Tracking, State::Tracking) => State::Tracking,
        (State::Tracking | State::Coasting, State::Coasting | State::Tracking) => State::Coasting,
        (State::Tracking | State::Coasting, _) => State::Lost,
        (state, _) => state,
    };
    let measured = match (&object.verified, &camera.measured) {
        (Some(v), Some(camera)) => {
            let together = |camera_part, own_part| covariance_of_object(&camera.pose, camera_part, &v.pose, own_part);
            let none = Matrix6::zeros();
            // One lens shifts both, mostly the same way, so counting them as independent is
            // conservative.
            let by_model = camera
                .by_model
                .or(v.by_model)
                .map(|_| together(camera.by_model.as_ref().unwrap_or(&none), v.by_model.as_ref().unwrap_or(&none)));
            Some(Measured { pose: camera.pose * v.pose.inverse(), noise: together(&camera.noise, &v.covariance), by_model })
        }
        _ => None,
    };
    let distance_m = object.verified.as_ref().map_or(0.0, |v| v.pose.translation.norm());
    let is_open = measured.is_some_and(|m: Measured<Body>| {
        let sigma = |first: usize| m.noise.fixed_view::<3, 3>(first, first).trace().sqrt();
        sigma(0) > MAX_SHIFT * distance_m || sigma(3) > MAX_ROTATION
    });
    // Lost at once, not coasting: how long this will last is unknown.
    if is_open && state == State::Tracking {
        settle(State::Lost, None, timestamp, motion)
    } else {
        settle(state, measured, timestamp, motion)
    }
}

/// Makes pose and state consistent: measured while tracking, predicted while coasting, none
/// otherwise.
fn settle<From>(state: State, measured: Option<Measured<From>>, timestamp: Timestamp, motion: &mut BodyMotion<From>) -> BodyEstimate<From> {
    let BodyMotion { history, filter } = motion;
    if let (State::Tracking, Some(measured)) = (state, measured) {
        history.measured(timestamp, &measured.pose);
        let filtered = filter.measured(timestamp, &measured.pose, &measured.noise);
        return BodyEstimate { state, pose: Some(filtered), measured: Some(measured) };
    }
    let predicted = history.predicted(timestamp).filter(|_| matches!(state, State::Tracking | State::Coasting));
    if let Some(pose) = predicted {
        let pose = filter.predicted(timestamp).unwrap_or(pose);
        return BodyEstimate { state: State::Coasting, pose: Some(pose), measured: None };
    }
    history.reset();
    filter.reset();
    unseen(history)
}

/// Returns the estimate of a camera that stands still, or counts as moved: never filtered, never
/// predicted.
fn standing(measured: Option<Measured<Camera>>, timestamp: Timestamp, motion: &mut BodyMotion<Camera>) -> BodyEstimate<Camera> {
    let Some(measured) = measured else {
        return unseen(&motion.history);
    };
    motion.history.measured(timestamp, &measured.pose);
    BodyEstimate { state: State::Tracking, pose: Some(measured.pose), measured: Some(measured) }
}

/// Returns an estimate without a pose; the state tells whether the body was ever measured in the
/// stage.
fn unseen<From>(history: &MotionHistory<Stage, From>) -> BodyEstimate<From> {
    let state = if history.is_known() { State::Lost } else { State::Searching };
    BodyEstimate { state, pose: None, measured: None }
}

#[cfg(test)]
#[path = "stage_tests.rs"]
mod tests;
