//! The tracker without threads: matcher and pose stage, one call a frame.

use crossbeam_channel::Receiver;
use image::GrayImage;

use crate::camera::CameraModel;
use crate::capture::{Row, RowContent};
use crate::compute_clock::ComputeClock;
use crate::frame::Frame;
use crate::pose::{BodyEstimate, FilterSettings, PoseEstimate, PoseStage};
use crate::record::{EssentialMotion, Measurement, ObjectSample, PoseSample, StageTimes, State, TwoViewModel};
use crate::simulate::VirtualStage;
use crate::track::{BodySpec, LockState, Matcher, Reason, Sighting, TrackerSettings, UsedPixels};

/// Everything a tracker is made from.
#[derive(Debug, Clone)]
pub struct TrackerSetup {
    /// The camera, at the size of the frames to come.
    pub camera: CameraModel,
    /// Exposure in seconds; 0 = unknown: learnt while the camera moves.
    pub exposure_s: f64,
    /// First row to last in seconds; 0 = global shutter or unknown.
    pub readout_s: f64,
    /// Pixels to leave out (0); the frames' size.
    pub mask: Option<GrayImage>,
    /// The stage.
    pub stage: BodySpec,
    /// Tracked objects.
    pub objects: Vec<BodySpec>,
    /// Tunables.
    pub settings: TrackerSettings,
}

impl From<&VirtualStage> for TrackerSetup {
    /// What is true of a virtual stage; scenery stays untold.
    fn from(scene: &VirtualStage) -> Self {
        Self {
            camera: scene.camera,
            exposure_s: scene.exposure_s,
            readout_s: scene.readout_s,
            mask: None,
            stage: scene.stage.clone(),
            objects: scene.objects.iter().map(|object| object.body.clone()).collect(),
            settings: TrackerSettings::default(),
        }
    }
}

/// Tracks frame by frame in the calling thread (plus its workers inside a frame).
///
/// ```no_run
/// # fn example(setup: stagepose::TrackerSetup, frames: Vec<stagepose::frame::Frame>) {
/// let mut tracker = stagepose::Tracker::new(setup);
/// for frame in &frames {
///     let sample = tracker.track(frame);
///     println!("{}", sample.to_json_line());
/// }
/// # }
/// ```
pub struct Tracker {
    pub(super) matcher: Matcher,
    pub(super) poses: PoseRecorder,
}

/// The pose stage with the names that records carry.
pub(super) struct PoseRecorder {
    stage: PoseStage,
    names: Vec<String>,
}

impl Tracker {
    /// Prepares the reference pictures; takes a fraction of a second per surface.
    pub fn new(setup: TrackerSetup) -> Self {
        let names = setup.objects.iter().map(|o| o.name.clone()).collect();
        let matcher =
            Matcher::new(setup.camera, setup.readout_s, setup.exposure_s, setup.mask, &setup.stage, &setup.objects, setup.settings);
        Self { matcher, poses: PoseRecorder { stage: PoseStage::default(), names } }
    }

    /// With a filter between the measured pose and the one for use; from the next frame on.
    pub fn with_filter(mut self, filter: FilterSettings) -> Self {
        self.poses.stage = PoseStage::with_filter(filter);
        self
    }

    /// The pixels that poses rest on, frame by frame from now on; each frame's are there before its sample.
    pub fn watch_pixels(&mut self) -> Receiver<UsedPixels> {
        self.matcher.watch_pixels()
    }

    /// Tracks one frame. Frames must come in the order of their stamps.
    pub fn track(&mut self, frame: &Frame) -> PoseSample {
        let sighting = self.matcher.look(frame);
        self.poses.sample(&sighting, 0.0)
    }

    /// Tracks one row of a clip, whatever it holds: every row gets its sample.
    pub fn track_row(&mut self, row: &Row) -> PoseSample {
        let sighting = sight(&mut self.matcher, row);
        self.poses.sample(&sighting, row.decode.as_secs_f64() * 1e3)
    }
}

/// What the matcher makes of a row.
pub(super) fn sight(matcher: &mut Matcher, row: &Row) -> Sighting {
    match &row.content {
        RowContent::Frame(frame) => matcher.look(frame),
        RowContent::Undecodable(_) => matcher.look_away(row.sequence, row.timestamp_ns, Reason::Undecodable),
        RowContent::Skipped(_) => matcher.look_past(row.sequence, row.timestamp_ns),
    }
}

impl PoseRecorder {
    /// The sample of a sighting.
    pub(super) fn sample(&mut self, sighting: &Sighting, decode_ms: f64) -> PoseSample {
        let _span = tracing::debug_span!("pose", sequence = sighting.sequence).entered();
        let start = ComputeClock::start();
        let PoseEstimate { camera, objects } = self.stage.estimate(sighting);
        let measurement = measurement(sighting, &camera);
        let objects = self.names.iter().zip(objects).map(|(name, o)| object_sample(name, o)).collect();
        let pose_ms = start.elapsed_ms();
        PoseSample {
            sequence: sighting.sequence,
            timestamp_ns: sighting.timestamp_ns,
            state: published(camera.state),
            pose: camera.pose,
            measurement,
            objects,
            reason: sighting.stage.reason.filter(|_| camera.state != LockState::Tracking),
            times: StageTimes { decode_ms, acquire_ms: sighting.acquire_ms, align_ms: sighting.align_ms, pose_ms, age_ms: None },
        }
    }
}

fn published(state: LockState) -> State {
    match state {
        LockState::Searching => State::Searching,
        LockState::Tracking => State::Tracking,
        LockState::Coasting => State::Coasting,
        LockState::Lost => State::Lost,
    }
}

fn measurement(sighting: &Sighting, camera: &BodyEstimate<crate::geometry::Camera>) -> Option<Measurement> {
    let (pose, covariance) = camera.measured.map(|m| (m.pose, m.covariance()))?;
    let verified = sighting.stage.verified.as_ref()?;
    let two_view = sighting.two_view.as_ref()?;
    let essential = two_view.essential.map(|(motion, inliers)| EssentialMotion {
        rotation: motion.rotation,
        translation_direction: motion.direction,
        inliers,
    });
    Some(Measurement {
        pose,
        covariance,
        model: if two_view.has_depth { TwoViewModel::Essential } else { TwoViewModel::Homography },
        homography: two_view.homography,
        essential,
        inliers: verified.inliers,
        rms_px: verified.rms_px,
    })
}

fn object_sample(name: &str, estimate: BodyEstimate<crate::geometry::Body>) -> ObjectSample {
    ObjectSample {
        name: name.to_owned(),
        state: published(estimate.state),
        pose: estimate.pose,
        covariance: estimate.measured.map(|m| m.covariance()),
    }
}
