//! What a frame shows of the stage and the objects.

use crate::frame::Timestamp;
use crate::track::body::learnt_camera::LearntCamera;
use crate::track::body::reason::Reason;
use crate::track::body::shutter_news::ShutterNews;
use crate::track::body::track_state::State;
use crate::track::model_error::misfit::ModelNews;
use crate::track::model_error::moments::Mixture;
use crate::track::patches::verify::Verified;
use crate::track::two_view::TwoView;

/// What a frame shows of one body.
#[derive(Debug, Clone)]
pub struct BodyObservation {
    /// The track state's verdict.
    pub state: State,
    /// The verified pose; present while tracking.
    pub verified: Option<Verified>,
    /// Root mean square of the displacements of its tiles or anchors, pixels; present with the
    /// pose.
    pub rms_px: Option<f64>,
    /// Why the body is not tracked; `None` while it is.
    pub reason: Option<Reason>,
}

impl BodyObservation {
    /// Returns a body without a pose.
    pub(super) fn without_pose(state: State, reason: Reason) -> Self {
        Self { state, verified: None, rms_px: None, reason: Some(reason) }
    }
}

/// What a frame shows of all bodies.
#[derive(Debug, Clone)]
pub struct FrameObservation {
    /// Row number of the record.
    pub sequence: u64,
    /// Timestamp of the frame.
    pub timestamp: Timestamp,
    /// False for a skipped row: its timestamp is unreliable, so it neither continues nor ends a
    /// track.
    pub is_timed: bool,
    /// The stage.
    pub stage: BodyObservation,
    /// Homography and essential matrix of the stage; present while tracking.
    pub two_view: Option<TwoView>,
    /// The objects, in the order of the config.
    pub objects: Vec<BodyObservation>,
    /// A part of the stage's model that the frames contradict; each is reported once.
    pub misfit: Option<ModelNews>,
    /// How frames that show two moments at once are composed; reported once.
    pub mixture: Option<Mixture>,
    /// News about the shutter; each is reported once.
    pub shutter_news: Option<ShutterNews>,
    /// What earlier frames had taught about the camera before this one.
    pub learnt: LearntCamera,
    /// Compute spent on finding candidates, milliseconds summed over all workers.
    pub acquire_ms: f64,
    /// Compute spent on registration and verification, milliseconds summed over all workers.
    pub align_ms: f64,
}

impl FrameObservation {
    /// Returns the observation of a row without a picture. `states`: the stage's first, then the
    /// objects'.
    pub(super) fn without_picture(
        sequence: u64,
        timestamp: Timestamp,
        is_timed: bool,
        reason: Reason,
        states: impl IntoIterator<Item = State>,
    ) -> Self {
        let mut bodies = states.into_iter().map(|state| BodyObservation::without_pose(state, reason));
        // There is always a stage; the fallback only avoids a panic.
        let stage = bodies.next().unwrap_or(BodyObservation::without_pose(State::Searching, reason));
        Self {
            sequence,
            timestamp,
            is_timed,
            stage,
            two_view: None,
            objects: bodies.collect(),
            misfit: None,
            mixture: None,
            shutter_news: None,
            learnt: LearntCamera::default(),
            acquire_ms: 0.0,
            align_ms: 0.0,
        }
    }
}
