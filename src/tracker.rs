//! The tracker without threads: matcher and pose stage, one call per frame.

use std::sync::Arc;

use crossbeam_channel::Receiver;
use image::GrayImage;
use thiserror::Error;

use crate::camera::{CameraModel, KnownShutter};
use crate::compute_clock::ComputeClock;
use crate::frame::{Frame, Timestamp};
use crate::pose::{BodyEstimate, FilterSettings, FixedCamera, PoseEstimate, PoseStage};
use crate::record::{EssentialMotion, Measurement, ObjectSample, PoseSample, StageTimes, State, TwoViewModel};
use crate::track::{BodySpec, BodyTracker, FrameObservation, LearntCamera, Reason, SurfaceError, TrackerSettings, UsedPixels, ViewStore};

/// Everything needed to build a tracker.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct TrackerSetup {
    /// The camera, at the size of the frames to come.
    pub camera: CameraModel,
    /// What is known of its shutter; the rest is estimated while tracking.
    pub shutter: KnownShutter,
    /// Mask with 0 at pixels to ignore; as large as the frames.
    pub mask: Option<GrayImage>,
    /// The stage.
    pub stage: BodySpec,
    /// Tracked objects.
    pub objects: Vec<BodySpec>,
    /// A camera that stands still, at this pose: the stage need not be seen, and may have no
    /// surfaces. `None`: the pose is measured.
    pub fixed: Option<FixedCamera>,
    /// Tuning parameters.
    pub settings: TrackerSettings,
    /// The clock that measures a sample's compute times; the default never advances.
    pub clock: ComputeClock,
    /// What an earlier session learnt about this camera in this mode; empty by default.
    pub learnt: LearntCamera,
    /// Cache for data computed from the reference pictures at start-up; none by default.
    pub store: Option<Arc<dyn ViewStore>>,
}

/// Why a setup cannot become a tracker.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum SetupError {
    /// The mask's size is not the camera's.
    #[error("the mask is {}x{} pixels, the camera's frames {}x{}; scale the mask to the frames", size.0, size.1, wanted.0, wanted.1)]
    MaskSize {
        /// Width and height of the mask, pixels.
        size: (u32, u32),
        /// Width and height of the camera, pixels.
        wanted: (u32, u32),
    },
    /// An impossible shutter time.
    #[error("{name} is {seconds} s; give a number{}", if *name == "exposure_s" { " of 0 or more" } else { "" })]
    Shutter {
        /// Name of the setting.
        name: &'static str,
        /// The value, as configured.
        seconds: f64,
    },
    /// A body without surfaces.
    #[error("the body `{body}` has no surface; give it one, or leave it out")]
    NoSurface {
        /// Name of the body.
        body: String,
    },
    /// A surface without a picture or a size.
    #[error("the surface `{surface}` of the body `{body}`: {problem}")]
    Surface {
        /// Name of the body.
        body: String,
        /// Name of the surface.
        surface: String,
        /// What is wrong with the surface.
        problem: SurfaceError,
    },
}

impl TrackerSetup {
    /// A camera that looks at a stage. No mask, no objects, an unknown shutter and default
    /// settings; set the fields to change that.
    pub fn new(camera: CameraModel, stage: BodySpec) -> Self {
        Self {
            camera,
            shutter: KnownShutter::default(),
            mask: None,
            stage,
            objects: Vec::new(),
            fixed: None,
            settings: TrackerSettings::default(),
            clock: ComputeClock::default(),
            learnt: LearntCamera::default(),
            store: None,
        }
    }

    /// Marks the setup as a trial: lens findings from its frames are not logged.
    pub fn as_trial(mut self) -> Self {
        self.settings.is_trial = true;
        self
    }

    fn checked(&self) -> Result<(), SetupError> {
        let wanted = (self.camera.width(), self.camera.height());
        if let Some(size) = self.mask.as_ref().map(GrayImage::dimensions).filter(|size| *size != wanted) {
            return Err(SetupError::MaskSize { size, wanted });
        }
        if let Some((name, seconds)) = self.shutter.or_zero().impossible_time() {
            return Err(SetupError::Shutter { name, seconds });
        }
        for body in std::iter::once(&self.stage).chain(&self.objects) {
            let name = || body.name.clone();
            let may_be_empty = self.fixed.is_some() && std::ptr::eq(body, &self.stage);
            if body.surfaces.is_empty() && !may_be_empty {
                return Err(SetupError::NoSurface { body: name() });
            }
            for surface in &body.surfaces {
                surface.check().map_err(|problem| SetupError::Surface { body: name(), surface: surface.name.clone(), problem })?;
            }
        }
        Ok(())
    }
}

/// Why a frame cannot be tracked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum FrameError {
    /// Its size is not the camera's.
    #[error("the frame is {}x{} pixels, but the camera is calibrated for {}x{}; scale the calibration to the frames", size.0, size.1, wanted.0, wanted.1)]
    Size {
        /// Width and height of the frame, pixels.
        size: (u32, u32),
        /// Width and height of the camera, pixels.
        wanted: (u32, u32),
    },
    /// Its stamp is not later than the previous frame's.
    #[error("the frame's time stamp {timestamp} does not follow {last}; give frames in the order they were taken")]
    Stamp {
        /// Stamp of the frame.
        timestamp: Timestamp,
        /// Stamp of the previous frame.
        last: Timestamp,
    },
}

/// Tracks frame by frame on the calling thread (plus worker threads within a frame).
///
/// ```no_run
/// # fn example(setup: stagepose::TrackerSetup, frames: Vec<stagepose::Frame>) -> Result<(), Box<dyn std::error::Error>> {
/// let mut tracker = stagepose::Tracker::new(setup)?;
/// for frame in &frames {
///     let sample = tracker.track(frame)?;
///     println!("{}", sample.to_json_line());
/// }
/// # Ok(())
/// # }
/// ```
pub struct Tracker {
    pub(crate) matcher: BodyTracker,
    pub(crate) poses: PoseRecorder,
    /// Stamp of the last frame of [`Tracker::track`].
    last: Option<Timestamp>,
}

/// The pose stage, with the object names for the records.
pub(crate) struct PoseRecorder {
    stage: PoseStage,
    names: Vec<String>,
    clock: ComputeClock,
}

impl Tracker {
    /// Prepares the reference pictures. Takes a fraction of a second per surface, less if the
    /// setup's store has them cached.
    ///
    /// # Errors
    /// When parts of the setup contradict each other.
    pub fn new(setup: TrackerSetup) -> Result<Self, SetupError> {
        setup.checked()?;
        let names = setup.objects.iter().map(|o| o.name.clone()).collect();
        let bodies: Vec<&BodySpec> = std::iter::once(&setup.stage).chain(&setup.objects).collect();
        let mut matcher = BodyTracker::new(setup.camera, setup.shutter, setup.mask, &bodies, setup.settings, setup.clock, setup.store);
        matcher.begin_with(&setup.learnt);
        Ok(Self { matcher, poses: PoseRecorder { stage: PoseStage::default().fixed(setup.fixed), names, clock: setup.clock }, last: None })
    }

    /// Adds a filter between the measured pose and the reported one, from the next frame on.
    pub fn with_filter(mut self, filter: FilterSettings) -> Self {
        self.poses.stage = std::mem::take(&mut self.poses.stage).filtered(filter);
        self
    }

    /// Returns what has been learnt about the camera so far.
    pub fn learnt(&self) -> LearntCamera {
        self.matcher.learnt()
    }

    /// Reports the pixels that poses are based on, frame by frame from now on; each frame's arrive
    /// before its sample.
    pub fn watch_pixels(&mut self) -> Receiver<UsedPixels> {
        self.matcher.watch_pixels()
    }

    /// Like [`watch_pixels`](Self::watch_pixels), only for frames that arrive while `wanted` is
    /// true; other frames cost nothing.
    #[cfg(feature = "daemon")]
    pub(crate) fn watch_pixels_while(&mut self, wanted: std::sync::Arc<std::sync::atomic::AtomicBool>) -> Receiver<UsedPixels> {
        self.matcher.watch_pixels_while(wanted)
    }

    /// Tracks one frame.
    ///
    /// # Errors
    /// When the frame's size is not the camera's, or its stamp is not later than the last one. Such
    /// a frame is ignored.
    pub fn track(&mut self, frame: &Frame) -> Result<PoseSample, FrameError> {
        let (size, wanted) = (frame.image.dimensions(), (self.matcher.camera().width(), self.matcher.camera().height()));
        if size != wanted {
            return Err(FrameError::Size { size, wanted });
        }
        if let Some(last) = self.last.filter(|last| frame.timestamp <= *last) {
            return Err(FrameError::Stamp { timestamp: frame.timestamp, last });
        }
        self.last = Some(frame.timestamp);
        let observation = self.matcher.track_frame(frame);
        Ok(self.poses.sample(&observation, 0.0))
    }
}

impl PoseRecorder {
    /// Turns an observation into a sample.
    pub(crate) fn sample(&mut self, observation: &FrameObservation, decode_ms: f64) -> PoseSample {
        let _span = tracing::debug_span!("pose", sequence = observation.sequence).entered();
        let start = self.clock.start();
        let PoseEstimate { camera, objects, is_moved } = self.stage.estimate(observation);
        let measurement = if self.stage.is_fixed() { standing(&camera) } else { measurement(observation, &camera) };
        let reason = if is_moved { Some(Reason::CameraMoved) } else { observation.stage.reason };
        let objects = self.names.iter().zip(objects).map(|(name, o)| object_sample(name, o)).collect();
        let pose_ms = start.elapsed_ms();
        PoseSample {
            sequence: observation.sequence,
            timestamp: observation.timestamp,
            state: camera.state,
            pose: camera.pose,
            measurement,
            objects,
            reason: reason.filter(|_| camera.state != State::Tracking),
            learnt: observation.learnt,
            times: StageTimes { decode_ms, acquire_ms: observation.acquire_ms, align_ms: observation.align_ms, pose_ms, age_ms: None },
        }
    }
}

fn measurement(observation: &FrameObservation, camera: &BodyEstimate<crate::geometry::Camera>) -> Option<Measurement> {
    let measured = camera.measured?;
    let verified = observation.stage.verified.as_ref()?;
    let two_view = observation.two_view.as_ref()?;
    let essential = two_view.essential.map(|(motion, inliers)| EssentialMotion {
        rotation: motion.rotation,
        translation_direction: motion.direction,
        inliers,
    });
    Some(Measurement {
        pose: measured.pose,
        covariance: measured.covariance(),
        common: measured.common(),
        model: Some(if two_view.has_depth { TwoViewModel::Essential } else { TwoViewModel::Homography }),
        homography: two_view.homography,
        essential,
        inliers: Some(verified.inliers),
        rms_px: Some(observation.stage.rms_px?),
    })
}

/// Returns the measurement of a camera whose pose is configured: no frame has evidence for it.
fn standing(camera: &BodyEstimate<crate::geometry::Camera>) -> Option<Measurement> {
    let measured = camera.measured?;
    let (covariance, common) = (measured.covariance(), measured.common());
    Some(Measurement { covariance, common, ..Measurement::without_evidence(measured.pose) })
}

fn object_sample(name: &str, estimate: BodyEstimate<crate::geometry::Body>) -> ObjectSample {
    ObjectSample {
        name: name.to_owned(),
        state: estimate.state,
        pose: estimate.pose,
        covariance: estimate.measured.map(|m| m.covariance()),
        common: estimate.measured.map(|m| m.common()),
    }
}
