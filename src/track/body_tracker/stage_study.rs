//! Studies of the stage for survey and diagnosis: what frames say about shutter and model, and what
//! is recognised in a picture without the config's sizes. None of this runs while tracking.

use image::GrayImage;

use super::BodyTracker;
use crate::camera::Shutter;
use crate::frame::Frame;
use crate::geometry::{Body, Camera, Pose};
use crate::motion::{Motion, MotionEstimate};
use crate::track::acquire::candidate::{SurfaceMatch, SurfaceView};
use crate::track::align::{AlignRequest, Alignment, ShutterClue, Start};
use crate::track::body::tracked_body::TrackedBody;
use crate::track::model_error::misfit::ModelReport;
use crate::track::patches::verify::Verified;

/// A study of the stage with a tracker's pictures.
pub struct StageStudy<'a> {
    pub(super) tracker: &'a mut BodyTracker,
}

impl StageStudy<'_> {
    /// Fixes the shutter to this one; from now on every frame is asked what it says about it (see
    /// [`shutter_clue`](Self::shutter_clue)).
    pub fn ask_shutter(&mut self, shutter: Shutter) {
        (self.tracker.shutter, self.tracker.is_shutter_fixed) = (shutter, true);
        self.tracker.search.set_shutter(shutter, 0.0);
        self.tracker.bodies.iter_mut().for_each(|body| body.ask_shutter(shutter));
    }

    /// From now on checks every frame against the stage's model, for
    /// [`model_report`](Self::model_report).
    pub fn study_model(&mut self) {
        self.tracker.bodies.iter_mut().take(1).for_each(|stage| stage.model.study_thoroughly(&stage.body));
    }

    /// Returns how well the stage's model fitted the frames.
    pub fn model_report(&self) -> ModelReport {
        self.tracker.bodies.first().map_or_else(ModelReport::default, |stage| stage.model.report(&stage.body, &self.tracker.camera))
    }

    /// Returns what the last frame says about the shutter, estimated on the stage; `None` if the
    /// shutter is not asked or the stage was not aligned.
    pub fn shutter_clue(&self) -> Option<ShutterClue> {
        self.tracker.bodies.first()?.attempt.clue
    }

    /// Aligns the stage from a start with the given uncertainty (one sigma, metres and radians) and
    /// returns the result; `None` if nothing converges. Leaves track state and motion unchanged.
    pub fn try_start(&mut self, frame: &Frame, start: &Pose<Body, Camera>, shift_m: f64, turn_rad: f64) -> Option<Alignment> {
        self.aligned_from(frame, |stage| stage.unseen(*start, [shift_m, turn_rad], None))
    }

    /// As [`try_start`](Self::try_start), from a motion of which the rates are known, too: one
    /// sigma of them in metres and radians per second.
    pub fn try_moving_start(&mut self, frame: &Frame, start: &Motion, of_pose: [f64; 2], of_rates: [f64; 2]) -> Option<Alignment> {
        self.aligned_from(frame, |stage| {
            let mut expected = stage.unseen(start.pose, of_pose, None);
            expected.motion.velocity = start.velocity;
            expected.motion.angular_velocity = start.angular_velocity;
            for axis in 6..12 {
                expected.covariance[(axis, axis)] = of_rates[axis / 3 - 2].powi(2);
            }
            expected
        })
    }

    /// Aligns the stage from a start as the search does from features, with all checks on what it
    /// finds (mirror solution, period, certainty); one sigma in metres and radians. `None` if the
    /// pose is refused. What is learnt slowly (light, noise, exposure) learns from a pose that is
    /// not refused.
    pub fn found_at(&mut self, frame: &Frame, start: &Pose<Body, Camera>, shift_m: f64, turn_rad: f64) -> Option<Verified> {
        if !self.tracker.fits(&frame.image) {
            return None;
        }
        let BodyTracker { levels, bodies, camera_rays, .. } = &mut *self.tracker;
        levels.update(&frame.image);
        let stage = bodies.first_mut()?;
        let expected = stage.unseen(*start, [shift_m, turn_rad], None);
        stage.align_found(frame, levels, camera_rays, &Start::found(&expected))
    }

    /// Aligns the stage with a frame from what is expected of its motion.
    fn aligned_from(&mut self, frame: &Frame, expected: impl FnOnce(&TrackedBody) -> MotionEstimate) -> Option<Alignment> {
        if !self.tracker.fits(&frame.image) {
            return None;
        }
        let BodyTracker { levels, bodies, camera_rays, .. } = &mut *self.tracker;
        levels.update(&frame.image);
        let stage = bodies.first_mut()?;
        let expected = expected(stage);
        let request = AlignRequest::new(Start::found(&expected), stage.track.was_reported());
        Some(stage.aligner.align(levels, camera_rays, &request)?.alignment)
    }

    /// Returns the stage's surfaces that are recognised in a picture, without using any configured
    /// size; for diagnosing a config that does not fit. Leaves track state and motion unchanged.
    pub fn recognise(&mut self, image: &GrayImage) -> Vec<SurfaceView> {
        if !self.tracker.fits(image) {
            return Vec::new();
        }
        let BodyTracker { bodies, search, .. } = &mut *self.tracker;
        bodies.first().map_or(Vec::new(), |stage| search.recognise(image, stage))
    }

    /// Returns the pose of the stage estimated from features in a picture, and the matches that
    /// support it; for diagnosing a model that does not fit yet. Leaves track state and motion
    /// unchanged.
    pub fn recognised_pose(&mut self, image: &GrayImage) -> Option<(Pose<Body, Camera>, Vec<SurfaceMatch>)> {
        if !self.tracker.fits(image) {
            return None;
        }
        let BodyTracker { bodies, search, .. } = &mut *self.tracker;
        search.recognised_pose(image, bodies.first()?)
    }

    /// Like [`recognised_pose`](Self::recognised_pose), but uses only the strongest features, in a
    /// fifth of the time. May return `None` where that one finds a pose.
    pub fn quickly_recognised_pose(&mut self, image: &GrayImage) -> Option<Pose<Body, Camera>> {
        if !self.tracker.fits(image) {
            return None;
        }
        let BodyTracker { bodies, search, .. } = &mut *self.tracker;
        search.quickly_recognised_pose(image, bodies.first()?)
    }

    /// Returns the number of patches of one of the stage's surfaces that fitted the last verified
    /// pose.
    pub fn fitting_patches(&self, surface: usize) -> usize {
        self.tracker.bodies.first().map_or(0, |stage| stage.anchors.fitting().iter().filter(|a| a.surface as usize == surface).count())
    }
}
