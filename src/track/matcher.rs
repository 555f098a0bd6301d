//! The matcher: a frame in, a sighting of every body out.
//!
//! A body that was aligned lately is followed: aligned from where it should be by now. The others are looked for. Its track state decides what the
//! outcome means for each.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crossbeam_channel::Receiver;
use image::GrayImage;
use nalgebra::Matrix6;
use tracing::{debug, debug_span};

use super::acquire::{SurfaceMatch, SurfaceView};
use super::align::{AlignSurface, Alignment, CameraRays, FrameLevels, ShutterClue, is_sharp};
use super::body_search::{BodySearch, Scene};
use super::feature_search::FeatureSearch;
use super::focal_doubt::FocalDoubt;
use super::frame_interval::FrameInterval;
use super::lens_doubt::covariance_by_lens;
use super::lens_watch::{LensState, LensWatch};
use super::misfit::{ModelNews, ModelReport};
use super::pixel_watch::{PixelWatch, Used, UsedPixels};
use super::reason::Reason;
use super::row_motion::RowMotion;
use super::settings::TrackerSettings;
use super::surface::BodySpec;
use super::track_state::State;
use super::tracked_body::{ModelFit, TrackedBody};
use super::two_view::{TwoView, TwoViewBuffers, two_view};
use super::verify::Verified;
use super::view_bank::ViewStore;
use crate::camera::{CameraModel, Shutter};
use crate::compute_clock::ComputeClock;
use crate::features::Workers;
use crate::frame::{Frame, Timestamp};
use crate::geometry::{Body, Camera, Pose};

/// Largest standard deviation of an object's direction, radians (one degree), by what its tiles leave displaced. A false pose of a small picture has half its tiles, and
/// their pixels tell it well; but they lie where no pose puts them: of 16 objects one was followed so for 28 frames, with 0.033 to 0.085. Of 2300 right poses of small,
/// quick and blurred objects none had more than 0.008 (with a correlation length of 0.3 of the
/// object; with 0.4 they are somewhat larger, and were not counted again). Raised, such poses are given; lowered, blurred objects are given up.
const LARGEST_MISFIT_TURN: f64 = std::f64::consts::PI / 180.0;

/// A frame in which another focal length is likely counts so much for what frames usually say. Raised, a slow zoom passes for the stage; lowered, a path around a stage that does not fit passes
/// for a zoom for longer.
const DOUBTED_SHARE: f64 = 0.1;

/// What a frame showed of one body.
#[derive(Debug, Clone)]
pub struct BodySighting {
    /// The track state's verdict.
    pub state: State,
    /// The verified pose; present while tracking.
    pub verified: Option<Verified>,
    /// Why it is not tracking; `None` while it is.
    pub reason: Option<Reason>,
}

/// What a frame showed.
#[derive(Debug, Clone)]
pub struct Sighting {
    /// Row number.
    pub sequence: u64,
    /// Stamp of the frame.
    pub timestamp: Timestamp,
    /// False for a skipped row: its stamp tells nothing of the time, so it neither continues nor ends a track.
    pub is_timed: bool,
    /// The stage itself.
    pub stage: BodySighting,
    /// Homography and essential matrix of the stage; present while tracking.
    pub two_view: Option<TwoView>,
    /// The objects, in the order of the config.
    pub objects: Vec<BodySighting>,
    /// A part of the stage's model that the frames speak against, told once each.
    pub misfit: Option<ModelNews>,
    /// Compute on finding candidates, milliseconds over all workers.
    pub acquire_ms: f64,
    /// Compute on registration and verification, milliseconds over all workers.
    pub align_ms: f64,
}

impl Sighting {
    /// A row without a picture, for this reason; the states are the stage's and the objects'.
    fn without_picture(
        sequence: u64,
        timestamp: Timestamp,
        is_timed: bool,
        reason: Reason,
        states: impl IntoIterator<Item = State>,
    ) -> Self {
        let mut bodies = states.into_iter().map(|state| BodySighting { state, verified: None, reason: Some(reason) });
        // There is always a stage.
        let stage = bodies.next().unwrap_or(BodySighting { state: State::Searching, verified: None, reason: Some(reason) });
        Self {
            sequence,
            timestamp,
            is_timed,
            stage,
            two_view: None,
            objects: bodies.collect(),
            misfit: None,
            acquire_ms: 0.0,
            align_ms: 0.0,
        }
    }
}

/// Finds all bodies in every frame, from scratch.
pub struct Matcher {
    camera: CameraModel,
    settings: TrackerSettings,
    clock: ComputeClock,
    shutter: Shutter,
    interval: FrameInterval,
    /// The stage first, then the objects.
    bodies: Vec<TrackedBody>,
    search: BodySearch,
    two_view_buffers: TwoViewBuffers,
    /// What the frame showed of each body.
    verified: Vec<Option<Verified>>,
    /// How well the model fits what was shown.
    fits: Vec<Option<ModelFit>>,
    lens_watch: LensWatch,
    /// How far the focal length may be off in the last frame.
    focal: FocalDoubt,
    camera_rays: CameraRays,
    levels: FrameLevels,
    watcher: Option<PixelWatch>,
}

impl Matcher {
    /// Prepares the reference pictures of all bodies, the stage first; takes a fraction of a second per surface whose views the store does not have.
    pub fn new(
        camera: CameraModel,
        shutter: Shutter,
        mask: Option<GrayImage>,
        specs: &[&BodySpec],
        settings: TrackerSettings,
        clock: ComputeClock,
        store: Option<Arc<dyn ViewStore>>,
    ) -> Self {
        let at_start = Workers::of_all_processors();
        let (surfaces, mut prepared): (Vec<_>, Vec<_>) = (specs.iter().flat_map(|spec| &spec.surfaces).collect(), Vec::new());
        at_start.map_into(&surfaces, &mut prepared, |surface| AlignSurface::new(surface));
        let mut prepared = prepared.into_iter();
        let mut bodies: Vec<TrackedBody> = Vec::new();
        for spec in specs {
            let first = bodies.last().map_or(0, |b| b.surfaces.end);
            bodies.push(TrackedBody::new(spec, prepared.by_ref().take(spec.surfaces.len()).collect(), first, shutter));
        }
        let features = FeatureSearch::new(bodies.iter_mut().flat_map(|b| &mut b.body.surfaces), settings.features, store, &at_start);
        let search = BodySearch::new(camera, shutter, mask.clone(), features, &settings, clock);
        Self {
            camera_rays: CameraRays::new(camera, mask),
            levels: FrameLevels::default(),
            watcher: None,
            camera,
            clock,
            shutter,
            interval: FrameInterval::default(),
            bodies,
            search,
            two_view_buffers: TwoViewBuffers::default(),
            verified: Vec::new(),
            fits: Vec::new(),
            lens_watch: LensWatch::new(settings.is_trial),
            focal: FocalDoubt::default(),
            settings,
        }
    }

    /// Looks for every body in a frame. A frame of another size than the camera's shows nothing.
    pub fn look(&mut self, frame: &Frame) -> Sighting {
        let _span = debug_span!("match", sequence = frame.sequence).entered();
        if frame.image.dimensions() != (self.camera.width(), self.camera.height()) {
            return self.look_away(frame.sequence, frame.timestamp, Reason::Skipped);
        }
        self.note_pixels();
        self.interval.update(frame.timestamp);
        for tracked in &mut self.bodies {
            (tracked.clue, tracked.refusal, tracked.reason) = (None, None, None);
            tracked.tried.clear();
            tracked.followed_from = None;
            tracked.expect_next(self.interval.to_next_s());
        }
        let start = self.clock.start();
        self.levels.update(&frame.image);
        self.verified.clear();
        for tracked in &mut self.bodies {
            let _span = debug_span!("follow", body = %tracked.body.name).entered();
            self.verified.push(tracked.follow(frame, &mut self.levels, &self.camera_rays));
        }
        let mut align_ms = start.elapsed_ms();
        let Self { levels, bodies, verified, .. } = self;
        let spent = self.search.find_missing(&mut Scene { frame, levels, rays: &self.camera_rays, bodies, verified });
        align_ms += spent.align_ms;
        self.show_pixels(frame.sequence);
        let start = self.clock.start();
        self.fit_models(frame.timestamp);
        self.refuse_misfits();
        let lens = self.watch_lens();
        let (misfit, extra_ms) = self.study_stage(frame, lens).unwrap_or_default();
        align_ms += start.elapsed_ms() + extra_ms;
        let stage = self.sighting_of(0, frame.timestamp, lens);
        let objects = (1..self.bodies.len()).map(|k| self.sighting_of(k, frame.timestamp, lens)).collect();
        let start = self.clock.start();
        let two_view = stage.verified.as_ref().map(|v| {
            let _span = debug_span!("two_view").entered();
            let TrackedBody { body, anchors, .. } = &self.bodies[0];
            two_view(body, v, anchors, &self.camera, self.settings.seed, &mut self.two_view_buffers)
        });
        align_ms += start.elapsed_ms();
        Sighting {
            sequence: frame.sequence,
            timestamp: frame.timestamp,
            is_timed: true,
            stage,
            two_view,
            objects,
            misfit,
            acquire_ms: spent.acquire_ms,
            align_ms,
        }
    }

    /// Asks every body that was found how well the model fits.
    fn fit_models(&mut self, timestamp: Timestamp) {
        let (camera, shutter) = (&self.camera, self.shutter);
        self.fits.clear();
        let bodies = self.bodies.iter_mut().zip(&self.verified);
        self.fits.extend(bodies.enumerate().map(|(k, (body, verified))| {
            let Some(verified) = verified else {
                body.forget_model_error();
                return None;
            };
            let rows = RowMotion { shutter, before: body.before_at(timestamp) };
            body.model_fit(verified, camera, &rows, k == 0)
        }));
    }

    /// What of the models' misfit a lens that was moved would explain.
    fn watch_lens(&mut self) -> LensState {
        // All are seen through one lens: the body that tells most of it speaks. An object that was just found may be none.
        let bodies = &self.bodies;
        let may_speak = |k: usize| k == 0 || bodies[k].track.is_continued();
        let clues = self.fits.iter().enumerate().filter(|(k, _)| may_speak(*k)).filter_map(|(_, fit)| fit.as_ref()?.focal);
        let clue = clues.min_by(|a, b| a.changed.sigma.total_cmp(&b.changed.sigma));
        let calibrated = self.calibrated_sigma();
        let is_seen = self.fits.iter().any(Option::is_some);
        let lens = self.lens_watch.update(clue.as_ref(), is_seen, calibrated);
        let step = self.fits.first().and_then(|fit| fit.as_ref()?.step);
        self.focal.update(clue.as_ref(), step);
        // What a lens that was moved says is no habit of the stage.
        let share = if self.focal.is_doubted() { DOUBTED_SHARE } else { 1.0 };
        if lens == LensState::Fits {
            let asked = self.bodies.iter_mut().zip(&self.fits).filter(|(_, fit)| fit.is_some());
            asked.for_each(|(body, _)| body.remember_focal(share));
        }
        lens
    }

    /// One sigma of the logarithm of the focal length, by its calibration.
    fn calibrated_sigma(&self) -> f64 {
        let focal_px = self.camera.intrinsics().fx;
        self.camera.doubt().map_or(0.0, |doubt| doubt.uncertainty.focal_px[0] / (3.0 * focal_px))
    }

    /// Refuses the objects whose tiles lie so far from where any pose puts them that the pose is none. But blur displaces tiles as well while the motion is unknown, so an object that was just
    /// found is followed for one more frame, which shows its motion.
    fn refuse_misfits(&mut self) {
        for k in 1..self.bodies.len() {
            let turn = self.fits[k].and_then(|fit| fit.at_most).map_or(0.0, |c| c.fixed_view::<3, 3>(3, 3).trace().max(0.0).sqrt());
            if turn > LARGEST_MISFIT_TURN {
                debug!(body = %self.bodies[k].body.name, turn, "misfit");
                (self.verified[k], self.fits[k]) = (None, None);
                let was_followed = self.bodies[k].followed_from.is_some();
                let refuse = if was_followed { TrackedBody::give_up } else { TrackedBody::leave_open };
                refuse(&mut self.bodies[k], Reason::NoPoseFits);
            }
        }
    }

    /// Lets the frame say what of the stage's model it speaks against, if it is time for one; and the workers' time, milliseconds.
    fn study_stage(&mut self, frame: &Frame, lens: LensState) -> Option<(Option<ModelNews>, f64)> {
        let tracked = self.bodies.first_mut()?;
        if !tracked.is_study_due(lens == LensState::Fits) {
            return None;
        }
        let verified = self.verified.first()?.as_ref()?;
        Some(self.search.study(frame, tracked, verified))
    }

    /// What the track state makes of the frame's pose of body `k`.
    fn sighting_of(&mut self, k: usize, timestamp: Timestamp, lens: LensState) -> BodySighting {
        let calibrated = self.calibrated_sigma();
        let (tracked, mut verified) = (&mut self.bodies[k], self.verified[k]);
        if let Some(v) = &verified {
            tracked.remember(timestamp, &v.pose);
        }
        if lens != LensState::Fits && verified.take().is_some() {
            tracked.reason = Some(Reason::LensMoved);
        }
        if lens == LensState::Moved {
            return BodySighting { state: tracked.track.withhold(), verified: None, reason: tracked.reason.or(Some(Reason::LensMoved)) };
        }
        // A frame that leaves no doubt confirms itself, unless what of the model does not fit leaves some.
        let is_known = |v: &Verified| is_sharp(&(v.covariance + tracked.covariance_by_misfit()), tracked.aligner.distance_m(&v.pose));
        let conclusive = verified.is_some_and(|v| v.is_conclusive && is_known(&v));
        let confirm_frames = if conclusive { 1 } else { self.settings.confirm_frames };
        let pose = verified.as_ref().map(|v| &v.pose);
        let coast_s = longest_coast_s(&self.settings, &self.interval);
        let state = tracked.track.update(timestamp, pose, coast_s, confirm_frames);
        let reason = tracked.reason.or_else(|| tracked.track.doubt().map(Reason::of_doubt)).filter(|_| state != State::Tracking);
        let mut verified = verified.filter(|_| state == State::Tracking);
        if let Some(v) = &mut verified {
            let observations = tracked.anchors.iter().map(|anchor| &anchor.observation);
            // Where nothing is asked of the focal length, its doubt is the calibration's.
            let adds = self.settings.adds_lens_doubt;
            let asked = self.fits[k].as_ref().and_then(|_| self.focal.sigma(calibrated, adds));
            let focal_scale = if asked.is_some() { 0.0 } else { 1.0 };
            let by_lens = covariance_by_lens(&v.pose, &self.camera, focal_scale, observations).filter(|_| adds);
            let by_shape = tracked.covariance_by_shape(&v.pose, &self.camera);
            let fit = self.fits[k];
            let by_surfaces = tracked.covariance_by_surfaces(&v.pose, &self.camera);
            let by_focal = asked.and_then(|sigma| tracked.covariance_by_focal(&v.pose, sigma));
            let by_misfit = Some(tracked.covariance_by_misfit()).filter(|covariance| *covariance != Matrix6::zeros());
            v.by_model = [by_lens, by_shape, by_surfaces, by_focal, by_misfit].into_iter().flatten().reduce(|sum, more| sum + more);
            v.rms_px = fit.map_or(v.rms_px, |fit| fit.rms_px);
        }
        BodySighting { state, verified, reason }
    }

    /// Time went on, but there was no picture, for this reason.
    pub fn look_away(&mut self, sequence: u64, timestamp: Timestamp, reason: Reason) -> Sighting {
        self.interval.update(timestamp);
        let (coast_s, confirm) = (longest_coast_s(&self.settings, &self.interval), self.settings.confirm_frames);
        let states = self.bodies.iter_mut().map(|b| b.track.update(timestamp, None, coast_s, confirm));
        Sighting::without_picture(sequence, timestamp, true, reason, states)
    }

    /// A row that tells nothing of its time (a stamp out of order): nothing changes.
    pub fn look_past(&self, sequence: u64, timestamp: Timestamp) -> Sighting {
        let idle = |b: &TrackedBody| if b.track.state() == State::Searching { State::Searching } else { State::Lost };
        Sighting::without_picture(sequence, timestamp, false, Reason::Skipped, self.bodies.iter().map(idle))
    }

    /// From now on the pixels that poses rest on are sent here, frame by frame, before the frame's sighting is given.
    pub fn watch_pixels(&mut self) -> Receiver<UsedPixels> {
        self.watch(None)
    }

    /// The same for the frames that come while `wanted` is true; the others cost nothing.
    pub fn watch_pixels_while(&mut self, wanted: Arc<AtomicBool>) -> Receiver<UsedPixels> {
        self.watch(Some(wanted))
    }

    fn watch(&mut self, wanted: Option<Arc<AtomicBool>>) -> Receiver<UsedPixels> {
        let (watch, receiver) = PixelWatch::new(wanted);
        self.watcher = Some(watch);
        receiver
    }

    /// Before a frame: its pixels are noted where somebody wants them.
    fn note_pixels(&mut self) {
        let Some(watcher) = &self.watcher else { return };
        let is_wanted = watcher.is_wanted();
        for body in self.bodies.iter_mut().filter(|body| body.used.is_some() != is_wanted) {
            body.used = is_wanted.then(Used::default);
        }
    }

    fn show_pixels(&mut self, sequence: u64) {
        let Some(watcher) = &self.watcher else { return };
        // All of them note, or none.
        if self.bodies.iter().any(|body| body.used.is_some()) {
            watcher.show(sequence, self.bodies.iter_mut().filter_map(|body| body.used.as_mut()));
        }
    }

    /// From now on the shutter is taken as given, and every frame is asked what it says of it.
    pub fn ask_shutter(&mut self, shutter: Shutter) {
        self.shutter = shutter;
        self.search.set_shutter(shutter);
        self.bodies.iter_mut().for_each(|b| b.aligner.ask_shutter(shutter));
    }

    /// From now on every frame is asked which part of the stage's model it speaks against, for [`model_report`](Self::model_report).
    pub fn study_model(&mut self) {
        self.bodies.iter_mut().take(1).for_each(TrackedBody::study_model);
    }

    /// How well the stage's model fitted the frames.
    pub fn model_report(&self) -> ModelReport {
        self.bodies.first().map_or_else(ModelReport::default, |stage| stage.model_report(&self.camera))
    }

    /// What the last frame said of the shutter through the stage; `None` where it is not asked, or the stage was not aligned.
    pub fn shutter_clue(&self) -> Option<ShutterClue> {
        self.bodies.first()?.clue
    }

    /// Aligns the stage from a start that is known to so much (one sigma, metres and radians), and tells what came of it. `None` where
    /// nothing converges. Neither the track state nor the motion take notice.
    pub fn try_start(&mut self, frame: &Frame, start: &Pose<Body, Camera>, shift_m: f64, turn_rad: f64) -> Option<Alignment> {
        if frame.image.dimensions() != (self.camera.width(), self.camera.height()) {
            return None;
        }
        self.levels.update(&frame.image);
        let stage = self.bodies.first_mut()?;
        let expected = stage.unseen(*start, [shift_m, turn_rad], None);
        Some(stage.aligner.align(&mut self.levels, &self.camera_rays, &expected, None)?.alignment)
    }

    /// The stage's surfaces that are recognised in a picture, before any size is asked: for studies of a config that does not fit. Neither the
    /// lock nor the motion take notice.
    pub fn recognise(&mut self, image: &GrayImage) -> Vec<SurfaceView> {
        if image.dimensions() != (self.camera.width(), self.camera.height()) {
            return Vec::new();
        }
        self.bodies.first().map_or(Vec::new(), |stage| self.search.recognise(image, stage))
    }

    /// Where features put the stage in a picture, and the matches that speak for it; for studies of a model that does not fit yet. Neither the lock nor the
    /// motion take notice.
    pub fn recognised_pose(&mut self, image: &GrayImage) -> Option<(Pose<Body, Camera>, Vec<SurfaceMatch>)> {
        if image.dimensions() != (self.camera.width(), self.camera.height()) {
            return None;
        }
        self.search.recognised_pose(image, self.bodies.first()?)
    }

    /// The same pose by the strongest features alone, in a fifth of the time; `None` also where [`recognised_pose`](Self::recognised_pose) would find one.
    pub fn quickly_recognised_pose(&mut self, image: &GrayImage) -> Option<Pose<Body, Camera>> {
        if image.dimensions() != (self.camera.width(), self.camera.height()) {
            return None;
        }
        self.search.quickly_recognised_pose(image, self.bodies.first()?)
    }

    /// Patches of one of the stage's surfaces that fitted the last verified pose.
    pub fn fitting_patches(&self, surface: usize) -> usize {
        self.bodies.first().map_or(0, |stage| stage.anchors.iter().filter(|a| a.surface as usize == surface).count())
    }

    /// The camera that frames are taken with.
    pub fn camera(&self) -> &CameraModel {
        &self.camera
    }
}

/// How long a body may coast: to the next frame at least, or a slow camera could not miss one. 0 stays: no pose is ever predicted.
fn longest_coast_s(settings: &TrackerSettings, interval: &FrameInterval) -> f64 {
    if settings.coast_s > 0.0 { settings.coast_s.max(interval.to_next_s()) } else { 0.0 }
}
