//! The tracker takes a frame and returns what it shows of every body, the stage and the objects.
//!
//! Per frame it runs in this order: [`TrackedBody::follow`] aligns each body that was aligned
//! lately, starting at its predicted pose; [`BodySearch`] searches for the others; model checks may
//! then refuse or withhold poses and widen their covariance; each body's track state turns the
//! result into a [`BodyObservation`]; last, the tracker learns the shutter. It may use all rooms of
//! `track`.
//!
//! - `observation`: what it returns
//! - `model_checks`: refuses and withholds poses that the model does not explain
//! - `stage_study`: for survey and diagnosis, what one frame shows of the stage

mod model_checks;
mod observation;
mod stage_study;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crossbeam_channel::Receiver;
use image::GrayImage;
use nalgebra::Matrix6;
use tracing::{debug, debug_span};

pub use self::observation::{BodyObservation, FrameObservation};
pub use self::stage_study::StageStudy;
use super::acquire::feature_search::FeatureSearch;
use super::acquire::view_bank::ViewStore;
use super::align::{AlignSurface, CameraRays, FrameLevels, is_sharp};
use super::body::clock_steps::ClockSteps;
use super::body::frame_interval::FrameInterval;
use super::body::learnt_camera::{LearntCamera, LearntTime};
use super::body::learnt_readout::{LearntReadout, ReadoutEstimate};
use super::body::pixel_watch::{PixelWatch, Used, UsedPixels};
use super::body::reason::Reason;
use super::body::shutter_news::ShutterNews;
use super::body::track_state::{State, TrackStateMachine};
use super::body::tracked_body::TrackedBody;
use super::body::tracked_body::body_model::{ModelFit, Observed};
use super::body_search::{BodySearch, Scene, Spent};
use super::model_error::lens_doubt::covariance_by_lens;
use super::model_error::lens_watch::{LensState, LensWatch};
use super::model_error::moments::MixtureWatch;
use super::patches::verify::Verified;
use super::scene::surface::BodySpec;
use super::settings::TrackerSettings;
use super::tuning::frame_order::TUNING;
use super::two_view::{TwoViewBuffers, two_view};
use crate::camera::{CameraModel, KnownShutter, Shutter};
use crate::compute_clock::ComputeClock;
use crate::features::Workers;
use crate::frame::{Frame, Timestamp};
use crate::light::CameraCurve;

/// Finds all bodies in every frame; needs no starting pose.
pub struct BodyTracker {
    camera: CameraModel,
    settings: TrackerSettings,
    clock: ComputeClock,
    shutter: Shutter,
    readout: LearntReadout,
    /// Whether the shutter is fixed by [`StageStudy::ask_shutter`]: frames are asked about
    /// it but do not change it.
    is_shutter_fixed: bool,
    /// Whether it was already reported that frames contradict the configured exposure.
    is_exposure_contradicted: bool,
    interval: FrameInterval,
    /// The stage first, then the objects.
    bodies: Vec<TrackedBody>,
    search: BodySearch,
    two_view_buffers: TwoViewBuffers,
    /// The current frame's verified pose of each body.
    verified: Vec<Option<Verified>>,
    /// How well the model fits each verified body.
    fits: Vec<Option<ModelFit>>,
    lens_watch: LensWatch,
    /// When a followed stage was last recognised to check the focal length by its matches.
    matches_asked: Option<Timestamp>,
    mixtures: MixtureWatch,
    /// Covariance of the stage's pose due to its motion within a frame that mixes two moments.
    by_mixture: Option<Matrix6<f64>>,
    clock_steps: ClockSteps,
    camera_rays: CameraRays,
    levels: FrameLevels,
    watcher: Option<PixelWatch>,
    /// See [`has_reported`](Self::has_reported).
    has_reported: bool,
}

impl BodyTracker {
    /// Prepares the reference pictures of all bodies, the stage first. Takes a fraction of a second
    /// per surface whose views `store` does not have.
    pub fn new(
        camera: CameraModel,
        shutter: KnownShutter,
        mask: Option<GrayImage>,
        specs: &[&BodySpec],
        settings: TrackerSettings,
        clock: ComputeClock,
        store: Option<Arc<dyn ViewStore>>,
    ) -> Self {
        let (readout, shutter) = (LearntReadout::new(shutter.readout_s, None), shutter.or_zero());
        let at_start = Workers::of_all_processors();
        let (surfaces, mut prepared): (Vec<_>, Vec<_>) = (specs.iter().flat_map(|spec| &spec.surfaces).collect(), Vec::new());
        at_start.map_into(&surfaces, &mut prepared, |surface| AlignSurface::new(surface));
        let mut prepared = prepared.into_iter();
        let mut bodies: Vec<TrackedBody> = Vec::new();
        for spec in specs {
            let first = bodies.last().map_or(0, |b| b.surfaces.end);
            bodies.push(TrackedBody::new(spec, prepared.by_ref().take(spec.surfaces.len()).collect(), first, shutter));
        }
        bodies.iter_mut().take(1).for_each(|stage| stage.track = TrackStateMachine::of_camera());
        let curve = CameraCurve::new(settings.transfer.unwrap_or_default());
        bodies.iter_mut().for_each(|body| body.aligner.assume_curve(&curve, settings.transfer.is_none()));
        let mut levels = FrameLevels::default();
        levels.set_curve(&curve);
        let features = FeatureSearch::new(bodies.iter_mut().flat_map(|b| &mut b.body.surfaces), settings.features, store, &at_start);
        let mut search = BodySearch::new(camera, shutter, mask.clone(), features, &settings, clock);
        search.set_shutter(shutter, readout.used().sigma_s);
        Self {
            camera_rays: CameraRays::new(camera, mask),
            levels,
            watcher: None,
            has_reported: false,
            camera,
            clock,
            shutter,
            readout,
            is_shutter_fixed: false,
            is_exposure_contradicted: false,
            interval: FrameInterval::default(),
            bodies,
            search,
            two_view_buffers: TwoViewBuffers::default(),
            verified: Vec::new(),
            fits: Vec::new(),
            lens_watch: LensWatch::new(settings.is_trial),
            matches_asked: None,
            mixtures: MixtureWatch::default(),
            by_mixture: None,
            clock_steps: ClockSteps::default(),
            settings,
        }
    }

    /// Returns how many rounds each body's alignment solved since the start, the stage's first.
    pub fn rounds(&self) -> Vec<u64> {
        self.bodies.iter().map(|body| body.aligner.rounds()).collect()
    }

    /// Converts a row's timestamp into the tracker's own time, which never runs backwards. Use it
    /// for all rows where the source's clock may be set back.
    pub fn own_time(&mut self, stamp: Timestamp) -> Timestamp {
        self.clock_steps.own(stamp)
    }

    /// Searches for every body in a frame. A frame whose size differs from the camera's is reported
    /// as skipped.
    pub fn track_frame(&mut self, frame: &Frame) -> FrameObservation {
        let _span = debug_span!("match", sequence = frame.sequence).entered();
        if !self.fits(&frame.image) {
            return self.miss_frame(frame.sequence, frame.timestamp, Reason::Skipped);
        }
        self.note_pixels();
        self.interval.update(frame.timestamp);
        let learnt = self.learnt();
        let doubt = (!self.is_shutter_fixed).then(|| self.readout.next_doubt());
        for tracked in &mut self.bodies {
            tracked.begin_frame(doubt, self.interval.to_next_s());
        }
        let start = self.clock.start();
        self.levels.update(&frame.image);
        self.bend_curve();
        self.verified.clear();
        for tracked in &mut self.bodies {
            let _span = debug_span!("follow", body = %tracked.body.name).entered();
            self.verified.push(tracked.follow(frame, &mut self.levels, &self.camera_rays));
        }
        let mut align_ms = start.elapsed_ms();
        let Self { levels, bodies, verified, .. } = self;
        let spent = self.search.find_missing(&mut Scene { frame, levels, rays: &self.camera_rays, bodies, verified });
        self.withhold_mixture(frame);
        let spent = self.ask_for_copies(frame, spent);
        align_ms += spent.align_ms;
        self.show_pixels(frame.sequence);
        let start = self.clock.start();
        self.fit_models(frame.timestamp);
        self.refuse_misfits();
        let lens = self.watch_lens(frame);
        let (misfit, extra_ms) = self.study_stage(frame, lens).unwrap_or_default();
        align_ms += start.elapsed_ms() + extra_ms;
        let stage = self.observe_body(0, frame.timestamp, lens);
        let objects = (1..self.bodies.len()).map(|k| self.observe_body(k, frame.timestamp, lens)).collect();
        self.has_reported = stage.state == State::Tracking;
        let start = self.clock.start();
        self.learn_readout();
        let two_view = stage.verified.as_ref().zip(stage.rms_px).map(|(verified, rms_px)| {
            let _span = debug_span!("two_view").entered();
            let TrackedBody { body, anchors, .. } = &self.bodies[0];
            two_view(
                body,
                &verified.t_camera_body(),
                rms_px,
                anchors.fitting(),
                &self.camera,
                self.settings.seed,
                &mut self.two_view_buffers,
            )
        });
        align_ms += start.elapsed_ms();
        FrameObservation {
            sequence: frame.sequence,
            timestamp: frame.timestamp,
            is_timed: true,
            stage,
            two_view,
            objects,
            misfit,
            mixture: self.mixtures.news(),
            shutter_news: self.shutter_news(),
            learnt,
            acquire_ms: spent.acquire_ms,
            align_ms,
        }
    }

    /// Starts from what an earlier run learnt about the camera. Configured values take precedence.
    pub fn begin_with(&mut self, learnt: &LearntCamera) {
        self.readout =
            self.readout.begun_with(learnt.readout.map(|LearntTime { seconds, sigma_s }| ReadoutEstimate { readout_s: seconds, sigma_s }));
        let used = self.readout.used();
        self.shutter.readout_s = used.readout_s;
        self.search.set_shutter(self.shutter, used.sigma_s);
        for body in &mut self.bodies {
            body.set_readout(used.readout_s, 0.0);
            learnt.curve.iter().for_each(|bend| body.aligner.take_learnt_bend(*bend));
            learnt.exposure.iter().for_each(|exposure| body.aligner.take_learnt_exposure(exposure.seconds, exposure.sigma_s));
        }
        self.bend_curve();
    }

    /// Decodes frames by the curve of the body that has taught most about it.
    fn bend_curve(&mut self) {
        let best = self.bodies.iter().filter_map(|body| body.aligner.learnt_bend()).max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((bend, _)) = best.filter(|(bend, _)| bend != self.levels.curve().bend()) {
            let curve = self.levels.curve().with_bend(&bend);
            self.levels.set_curve(&curve);
        }
    }

    /// Returns what frames have taught about the camera; excludes configured values.
    pub fn learnt(&self) -> LearntCamera {
        let readout = self.readout.learnt().map(|known| known.as_time());
        let exposure = self.bodies.first().and_then(|stage| stage.aligner.learnt_exposure());
        let curve = Some(*self.levels.curve().bend()).filter(|bend| bend.iter().any(|correction| *correction != 0.0));
        LearntCamera { readout, exposure: exposure.map(|(seconds, sigma_s)| LearntTime { seconds, sigma_s }), curve }
    }

    /// Learns the readout time from this frame: from the stage, or from an object if the stage is
    /// not seen.
    fn learn_readout(&mut self) {
        // In a mixture, rows differ because they show different moments, not because of the
        // readout.
        if self.mixtures.is_mixing() {
            return;
        }
        let given = self.bodies.iter().zip(&self.verified).filter(|(_, verified)| verified.is_some()).map(|(body, _)| body);
        // Do not blame a configured readout for residuals that the model does not explain anyway.
        let is_configured = self.readout.used().sigma_s == 0.0;
        let mut clues = given
            .filter(|body| !is_configured || body.model.covariance_by_misfit() == Matrix6::zeros())
            .filter_map(|body| body.attempt.clue);
        let Some(clue) = clues.find(|clue| clue.may_teach).filter(|_| !self.is_shutter_fixed) else { return };
        let was_s = self.shutter.readout_s;
        self.readout.update(&clue, self.interval.to_next_s());
        let used = self.readout.used();
        if used.readout_s != was_s {
            self.shutter.readout_s = used.readout_s;
            self.bodies.iter_mut().for_each(|body| body.set_readout(used.readout_s, used.readout_s - was_s));
        }
        self.search.set_shutter(self.shutter, used.sigma_s);
        debug!(
            readout_s = used.readout_s,
            sigma_s = used.sigma_s,
            clue = clue.readout.clue.score / clue.readout.clue.information,
            shown = clue.readout.shown,
            speed = clue.speed_px_s,
            "readout"
        );
    }

    /// Returns the news about the shutter after this frame, if any.
    fn shutter_news(&mut self) -> Option<ShutterNews> {
        if let Some(news) = self.readout.news() {
            return Some(news);
        }
        let [configured_s, found_s] = self.bodies[0].aligner.contradicted_exposure().filter(|_| !self.is_exposure_contradicted)?;
        self.is_exposure_contradicted = true;
        Some(ShutterNews::ExposureContradicted { configured_s, found_s })
    }

    /// Checks whether the frame shows a second copy of the stage's picture. Runs only when the
    /// stage was found without continuing its track. If exactly one of the two is where the stage
    /// can be by now, that one is the stage; if both are, nothing is reported as long as both are
    /// seen. Skipped while the lens counts as moved: nothing is reported then, and what the pose
    /// leaves unexplained is the stage itself.
    fn ask_for_copies(&mut self, frame: &Frame, spent: Spent) -> Spent {
        if self.lens_watch.is_moved() {
            return spent;
        }
        let Self { levels, bodies, verified, search, .. } = self;
        let Some(first) = verified[0] else { return spent };
        if bodies[0].track.continues_at(&first.pose, frame.timestamp) {
            return spent;
        }
        let mut scene = Scene { frame, levels, rays: &self.camera_rays, bodies, verified };
        let copy = search.find_copy(0, &mut scene);
        let may_have_come = |pose| scene.bodies[0].track.may_have_come(pose, frame.timestamp);
        let come = [Some(&first), copy.as_ref()].map(|found| found.is_some_and(|found| may_have_come(&found.pose)));
        match copy {
            Some(copy) if come == [false, true] => {
                search.align_copy(0, &mut scene, &copy);
                // What was found first is not the stage.
                scene.bodies[0].attempt.reason = scene.verified[0].is_none().then_some(Reason::Jumped);
            }
            Some(_) if come == [true, true] => scene.bodies[0].copy_seen_at = Some(frame.timestamp),
            _ => {}
        }
        let stage = &mut self.bodies[0];
        let is_open = |then: Timestamp| frame.timestamp.seconds_since(then) <= TUNING.copy_memory_s;
        if come[0] && stage.copy_seen_at.is_some_and(is_open) {
            self.verified[0] = None;
            stage.withhold(Reason::Ambiguous);
        }
        self.search.spent()
    }

    /// Updates the track state of body `k` with the frame's pose and returns what the frame shows.
    fn observe_body(&mut self, k: usize, timestamp: Timestamp, lens: LensState) -> BodyObservation {
        let (tracked, mut verified) = (&mut self.bodies[k], self.verified[k]);
        if let Some(v) = &verified {
            tracked.remember(timestamp, &v.pose);
        }
        if lens != LensState::Fits && verified.take().is_some() {
            tracked.attempt.reason = Some(Reason::LensMoved);
        }
        if lens == LensState::Moved {
            return BodyObservation::without_pose(tracked.track.withhold(), tracked.attempt.reason.unwrap_or(Reason::LensMoved));
        }
        // A conclusive frame confirms itself, unless model misfit leaves the pose uncertain.
        let is_known = |v: &Verified| is_sharp(&(v.covariance + tracked.model.covariance_by_misfit()), tracked.aligner.distance_m(&v.pose));
        let conclusive = verified.is_some_and(|v| v.is_conclusive && is_known(&v));
        let confirm_frames = if conclusive { 1 } else { self.settings.confirm_frames };
        let pose = verified.as_ref().map(|v| &v.pose);
        let coast_s = longest_coast_s(&self.settings, &self.interval);
        let state = tracked.track.update(timestamp, pose, coast_s, confirm_frames);
        let reason = tracked.attempt.reason.or_else(|| tracked.track.doubt().map(Reason::of_doubt)).filter(|_| state != State::Tracking);
        let mut verified = verified.filter(|_| state == State::Tracking);
        let rms_px = verified.map(|v| self.fits[k].map_or(v.solver_rms_px, |fit| fit.rms_px));
        if let Some(v) = &mut verified {
            v.by_model = self.covariance_by_model(k, v);
        }
        BodyObservation { state, verified, rms_px, reason }
    }

    /// Returns the covariance of [δp, δθ], body axes, of a verified pose of body `k` from the
    /// uncertainty of lens, shapes, places and shutter, and from misfit; `None` if there is none.
    fn covariance_by_model(&self, k: usize, verified: &Verified) -> Option<Matrix6<f64>> {
        let tracked = &self.bodies[k];
        let TrackedBody { body, anchors, model, .. } = tracked;
        let observed = Observed { body, anchors, verified, camera: &self.camera };
        let observations = anchors.fitting().iter().map(|anchor| &anchor.observation);
        let by_lens = covariance_by_lens(&verified.pose, &self.camera, observations).filter(|_| self.settings.adds_lens_doubt);
        let by_focal = self.lens_watch.deviation().filter(|_| self.fits[k].is_some());
        let by_model = [
            by_lens,
            model.covariance_by_shape(&observed),
            model.covariance_by_surfaces(&observed),
            by_focal.and_then(|deviation| model.covariance_by_focal(verified, deviation, tracked.aligner.distance_m(&verified.pose))),
            Some(model.covariance_by_misfit()).filter(|covariance| *covariance != Matrix6::zeros()),
            tracked.covariance_by_readout(verified, self.readout.sigma_s()),
            self.by_mixture.filter(|_| k == 0),
        ];
        by_model.into_iter().flatten().reduce(|sum, more| sum + more)
    }

    /// Whether the last frame resulted in a tracked pose of the stage.
    pub fn has_reported(&self) -> bool {
        self.has_reported
    }

    /// Advances the time by a row without a picture and returns its observation.
    pub fn miss_frame(&mut self, sequence: u64, timestamp: Timestamp, reason: Reason) -> FrameObservation {
        self.interval.update(timestamp);
        let (coast_s, confirm) = (longest_coast_s(&self.settings, &self.interval), self.settings.confirm_frames);
        let learnt = self.learnt();
        let states = self.bodies.iter_mut().map(|b| b.track.update(timestamp, None, coast_s, confirm));
        FrameObservation { learnt, ..FrameObservation::without_picture(sequence, timestamp, true, reason, states) }
    }

    /// Returns the observation of a row whose timestamp is unusable (out of order); changes no
    /// state.
    pub fn skip_row(&self, sequence: u64, timestamp: Timestamp) -> FrameObservation {
        let idle = |b: &TrackedBody| if b.track.state() == State::Searching { State::Searching } else { State::Lost };
        let observation = FrameObservation::without_picture(sequence, timestamp, false, Reason::Skipped, self.bodies.iter().map(idle));
        FrameObservation { learnt: self.learnt(), ..observation }
    }

    /// Starts sending the pixels that poses rest on: per frame, before the frame's observation is
    /// returned.
    pub fn watch_pixels(&mut self) -> Receiver<UsedPixels> {
        self.watch(None)
    }

    /// Like [`watch_pixels`](Self::watch_pixels), but only for frames that arrive while `wanted` is
    /// true; the others cost nothing.
    pub fn watch_pixels_while(&mut self, wanted: Arc<AtomicBool>) -> Receiver<UsedPixels> {
        self.watch(Some(wanted))
    }

    fn watch(&mut self, wanted: Option<Arc<AtomicBool>>) -> Receiver<UsedPixels> {
        let (watch, receiver) = PixelWatch::new(wanted);
        self.watcher = Some(watch);
        receiver
    }

    /// Turns the recording of used pixels on or off before a frame.
    fn note_pixels(&mut self) {
        let Some(watcher) = &self.watcher else { return };
        let is_wanted = watcher.is_wanted();
        for body in self.bodies.iter_mut().filter(|body| body.used.is_some() != is_wanted) {
            body.used = is_wanted.then(Used::default);
        }
    }

    fn show_pixels(&mut self, sequence: u64) {
        let Some(watcher) = &self.watcher else { return };
        // Either all bodies record their pixels or none does.
        if self.bodies.iter().any(|body| body.used.is_some()) {
            watcher.show(sequence, self.bodies.iter_mut().filter_map(|body| body.used.as_mut()));
        }
    }

    /// Opens a study of the stage, for survey and diagnosis.
    pub fn study(&mut self) -> StageStudy<'_> {
        StageStudy { tracker: self }
    }

    /// Whether a picture has the camera's size.
    fn fits(&self, image: &GrayImage) -> bool {
        image.dimensions() == (self.camera.width(), self.camera.height())
    }

    /// Returns the camera that takes the frames.
    pub fn camera(&self) -> &CameraModel {
        &self.camera
    }
}

/// Returns how long a body may coast, seconds: at least to the next frame, so that a slow camera
/// can miss one. A configured 0 stays 0: no pose is ever predicted.
fn longest_coast_s(settings: &TrackerSettings, interval: &FrameInterval) -> f64 {
    if settings.coast_s > 0.0 { settings.coast_s.max(interval.to_next_s()) } else { 0.0 }
}
