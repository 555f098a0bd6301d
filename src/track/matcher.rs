//! The matcher takes a frame and returns what it shows of every body, the stage and the objects.
//!
//! Per frame it runs in this order: [`TrackedBody::follow`] aligns each body that was aligned
//! lately, starting at its predicted pose; [`BodySearch`] searches for the others; model checks may
//! then refuse or withhold poses and widen their covariance; each body's track state turns the
//! result into a [`BodySighting`]; last, the matcher learns the shutter. It may use all rooms of
//! `track`.

use super::tuning::frame_order::TUNING;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crossbeam_channel::Receiver;
use image::GrayImage;
use nalgebra::{Matrix6, Vector6};
use tracing::{debug, debug_span};

use super::acquire::candidate::{SurfaceMatch, SurfaceView};
use super::acquire::feature_search::FeatureSearch;
use super::acquire::matched_focal::matched_focal;
use super::acquire::view_bank::ViewStore;
use super::align::{AlignSurface, Alignment, CameraRays, FrameLevels, ShutterClue, is_sharp};
use super::body::clock_steps::ClockSteps;
use super::body::frame_interval::FrameInterval;
use super::body::learnt_camera::{LearntCamera, LearntTime};
use super::body::learnt_readout::{Known, LearntReadout};
use super::body::pixel_watch::{PixelWatch, Used, UsedPixels};
use super::body::reason::Reason;
use super::body::shutter_news::ShutterNews;
use super::body::track_state::{State, TrackStateMachine};
use super::body::tracked_body::{ModelFit, TrackedBody};
use super::body_search::{BodySearch, Scene, Spent};
use super::model_error::focal_clue::FocalClue;
use super::model_error::lens_doubt::covariance_by_lens;
use super::model_error::lens_watch::{LensState, LensWatch};
use super::model_error::misfit::{ModelNews, ModelReport};
use super::model_error::moments::{Found, Mixture, MixtureWatch, Verdict};
use super::patches::row_motion::RowMotion;
use super::patches::verify::Verified;
use super::scene::surface::BodySpec;
use super::settings::TrackerSettings;
use super::two_view::{TwoView, TwoViewBuffers, two_view};
use crate::camera::{CameraModel, KnownShutter, Shutter};
use crate::compute_clock::ComputeClock;
use crate::features::Workers;
use crate::frame::{Frame, Timestamp};
use crate::geometry::resection::perturbed;
use crate::geometry::{Body, Camera, Pose};
use crate::motion::Motion;

/// What a frame shows of one body.
#[derive(Debug, Clone)]
pub struct BodySighting {
    /// The track state's verdict.
    pub state: State,
    /// The verified pose; present while tracking.
    pub verified: Option<Verified>,
    /// Why the body is not tracked; `None` while it is.
    pub reason: Option<Reason>,
}

/// What a frame shows of all bodies.
#[derive(Debug, Clone)]
pub struct Sighting {
    /// Row number of the record.
    pub sequence: u64,
    /// Timestamp of the frame.
    pub timestamp: Timestamp,
    /// False for a skipped row: its timestamp is unreliable, so it neither continues nor ends a
    /// track.
    pub is_timed: bool,
    /// The stage.
    pub stage: BodySighting,
    /// Homography and essential matrix of the stage; present while tracking.
    pub two_view: Option<TwoView>,
    /// The objects, in the order of the config.
    pub objects: Vec<BodySighting>,
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

impl Sighting {
    /// Returns the sighting of a row without a picture. `states`: the stage's first, then the
    /// objects'.
    fn without_picture(
        sequence: u64,
        timestamp: Timestamp,
        is_timed: bool,
        reason: Reason,
        states: impl IntoIterator<Item = State>,
    ) -> Self {
        let mut bodies = states.into_iter().map(|state| BodySighting { state, verified: None, reason: Some(reason) });
        // There is always a stage; the fallback only avoids a panic.
        let stage = bodies.next().unwrap_or(BodySighting { state: State::Searching, verified: None, reason: Some(reason) });
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

/// Finds all bodies in every frame; needs no starting pose.
pub struct Matcher {
    camera: CameraModel,
    settings: TrackerSettings,
    clock: ComputeClock,
    shutter: Shutter,
    readout: LearntReadout,
    /// Whether the shutter is fixed by [`ask_shutter`](Self::ask_shutter): frames are asked about
    /// it but do not change it.
    is_shutter_given: bool,
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
    /// See [`has_given`](Self::has_given).
    has_given: bool,
}

impl Matcher {
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
        let features = FeatureSearch::new(bodies.iter_mut().flat_map(|b| &mut b.body.surfaces), settings.features, store, &at_start);
        let mut search = BodySearch::new(camera, shutter, mask.clone(), features, &settings, clock);
        search.set_shutter(shutter, readout.used().sigma_s);
        Self {
            camera_rays: CameraRays::new(camera, mask),
            levels: FrameLevels::default(),
            watcher: None,
            has_given: false,
            camera,
            clock,
            shutter,
            readout,
            is_shutter_given: false,
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

    /// Converts a row's timestamp into the matcher's own time, which never runs backwards. Use it
    /// for all rows where the source's clock may be set back.
    pub fn own_time(&mut self, stamp: Timestamp) -> Timestamp {
        self.clock_steps.own(stamp)
    }

    /// Searches for every body in a frame. A frame whose size differs from the camera's is reported
    /// as skipped.
    pub fn look(&mut self, frame: &Frame) -> Sighting {
        let _span = debug_span!("match", sequence = frame.sequence).entered();
        if frame.image.dimensions() != (self.camera.width(), self.camera.height()) {
            return self.look_away(frame.sequence, frame.timestamp, Reason::Skipped);
        }
        self.note_pixels();
        self.interval.update(frame.timestamp);
        let learnt = self.learnt();
        let doubt = (!self.is_shutter_given).then(|| self.readout.next_doubt());
        for tracked in &mut self.bodies {
            tracked.expect_readout(doubt);
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
        let stage = self.sighting_of(0, frame.timestamp, lens);
        let objects = (1..self.bodies.len()).map(|k| self.sighting_of(k, frame.timestamp, lens)).collect();
        self.has_given = stage.state == State::Tracking;
        let start = self.clock.start();
        self.learn_readout();
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
            mixture: self.mixtures.news(),
            shutter_news: self.shutter_news(),
            learnt,
            acquire_ms: spent.acquire_ms,
            align_ms,
        }
    }

    /// Starts from what an earlier run learnt about the camera. Configured values take precedence.
    pub fn begin_with(&mut self, learnt: &LearntCamera) {
        self.readout = self.readout.begun_with(learnt.readout.map(|LearntTime { seconds, sigma_s }| Known { readout_s: seconds, sigma_s }));
        let used = self.readout.used();
        self.shutter.readout_s = used.readout_s;
        self.search.set_shutter(self.shutter, used.sigma_s);
        for body in &mut self.bodies {
            body.take_readout(used.readout_s, 0.0);
            learnt.exposure.iter().for_each(|exposure| body.aligner.take_learnt_exposure(exposure.seconds, exposure.sigma_s));
        }
    }

    /// Returns what frames have taught about the camera; excludes configured values.
    pub fn learnt(&self) -> LearntCamera {
        let readout = self.readout.learnt().map(|known| known.as_time());
        let exposure = self.bodies.first().and_then(|stage| stage.aligner.learnt_exposure());
        LearntCamera { readout, exposure: exposure.map(|(seconds, sigma_s)| LearntTime { seconds, sigma_s }) }
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
        let mut clues = given.filter(|body| !is_configured || body.covariance_by_misfit() == Matrix6::zeros()).filter_map(|body| body.clue);
        let Some(clue) = clues.find(|clue| clue.may_teach).filter(|_| !self.is_shutter_given) else { return };
        let was_s = self.shutter.readout_s;
        self.readout.hear(&clue, self.interval.to_next_s());
        let used = self.readout.used();
        if used.readout_s != was_s {
            self.shutter.readout_s = used.readout_s;
            self.bodies.iter_mut().for_each(|body| body.take_readout(used.readout_s, used.readout_s - was_s));
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

    /// Withholds the stage's pose if the camera moves and the frame shows two moments at once. If
    /// the camera hardly moves, the pose is kept, with a covariance for the unknown moment within
    /// the frame interval before it.
    fn withhold_mixture(&mut self, frame: &Frame) {
        self.by_mixture = None;
        let interval_s = self.interval.to_next_s();
        let Self { levels, bodies, verified, mixtures, camera, .. } = self;
        let (Some(pose), Some(stage)) = (verified[0].map(|v| v.pose), bodies.first_mut()) else { return };
        // Uses poses alone: the velocity estimated within a mixed frame is wrong.
        let Some((before, dt_s, twist)) = stage.before_at(frame.timestamp) else {
            if mixtures.is_mixing() {
                verified[0] = None;
                stage.remember(frame.timestamp, &pose);
                stage.leave_open(Reason::Mixed);
            }
            return;
        };
        let motion = Motion::between(&before.inverse(), &pose, dt_s);
        let motion_before = twist.map(|twist| Motion::between(&perturbed(&before, &(twist.0 * -dt_s)).inverse(), &before.inverse(), dt_s));
        let motion_before = motion_before.map(|then| Motion { pose, ..then });
        let TrackedBody { body, anchors, .. } = &*stage;
        let found = Found { image: &frame.image, body, anchors, camera, motion, motion_before, interval_s };
        match mixtures.look(&found, levels) {
            Verdict::Whole => {}
            Verdict::Slow => {
                let off = [Some(motion), motion_before].into_iter().flatten().map(|motion| {
                    let [shift, turn] = pose.step_to(&motion.after(-0.5 * interval_s).pose);
                    let turn = pose.rotation * turn;
                    let step = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
                    step * step.transpose()
                });
                self.by_mixture = off.reduce(|sum, more| sum + more);
            }
            Verdict::Withheld => {
                verified[0] = None;
                stage.remember(frame.timestamp, &pose);
                stage.leave_open(Reason::Mixed);
            }
        }
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
                scene.bodies[0].reason = scene.verified[0].is_none().then_some(Reason::Jumped);
            }
            Some(_) if come == [true, true] => scene.bodies[0].two_seen = Some(frame.timestamp),
            _ => {}
        }
        let stage = &mut self.bodies[0];
        let is_open = |then: Timestamp| frame.timestamp.seconds_since(then) <= TUNING.copy_memory_s;
        if come[0] && stage.two_seen.is_some_and(is_open) {
            self.verified[0] = None;
            stage.leave_open(Reason::Ambiguous);
        }
        self.search.spent()
    }

    /// Computes how well the model fits every body that was found.
    fn fit_models(&mut self, timestamp: Timestamp) {
        let (camera, shutter, asks_focal) = (&self.camera, self.shutter, self.lens_watch.asks());
        let readout_sigma_s = self.readout.used().sigma_s;
        self.fits.clear();
        let bodies = self.bodies.iter_mut().zip(&self.verified);
        self.fits.extend(bodies.enumerate().map(|(k, (body, verified))| {
            let Some(verified) = verified else {
                body.forget_model_error();
                return None;
            };
            let rows = RowMotion { shutter, readout_sigma_s, before: body.before_at(timestamp) };
            body.model_fit(verified, camera, &rows, asks_focal, k == 0)
        }));
    }

    /// Updates the lens watch with this frame and returns whether a moved lens would explain the
    /// misfit.
    fn watch_lens(&mut self, frame: &Frame) -> LensState {
        // All bodies are seen through one lens, so the body with the smallest sigma decides. An
        // object that was only just found may be a false detection and does not count.
        let bodies = &self.bodies;
        let may_speak = |k: usize| k == 0 || bodies[k].track.is_continued();
        let clues = self.fits.iter().enumerate().filter_map(|(k, fit)| Some((k, fit.as_ref()?.focal.as_ref()?)));
        // An unknown readout time displaces rows as a changed focal length would.
        let clues = clues.filter(|(k, _)| may_speak(*k) && !bodies[*k].is_readout_in_doubt());
        let clue = clues.min_by(|a, b| a.1.sigma.total_cmp(&b.1.sigma));
        let clue = clue.map(|(body, clue)| {
            self.lens_watch.listen_to(body);
            *clue
        });
        self.ask_matches(frame, clue.as_ref());
        let focal_px = self.camera.intrinsics().fx;
        let doubt = self.camera.doubt().map_or(0.0, |doubt| doubt.uncertainty.focal_px[0] / (3.0 * focal_px));
        let is_seen = self.fits.iter().zip(&self.bodies).any(|(fit, body)| fit.is_some() && !body.is_readout_in_doubt());
        let step = self.fits.first().and_then(|fit| fit.as_ref()?.step);
        self.lens_watch.update(clue.as_ref(), step, is_seen, doubt)
    }

    /// Asks feature matches for the focal length: those that found the stage, and, at most once per
    /// `focal_match_interval_s`, those of a frame whose tiles disagree with earlier matches.
    fn ask_matches(&mut self, frame: &Frame, clue: Option<&FocalClue>) {
        let Some(found) = self.verified[0] else { return };
        let stage = &mut self.bodies[0];
        let mut matches = std::mem::take(&mut stage.seen.matches);
        let is_due = self.matches_asked.is_none_or(|then| frame.timestamp.seconds_since(then) >= TUNING.focal_match_interval_s);
        if matches.is_empty() && is_due && clue.is_some_and(|clue| self.lens_watch.is_disputed(clue)) {
            self.matches_asked = Some(frame.timestamp);
            let views = self.search.recognise(&frame.image, stage);
            matches.extend(views.iter().flat_map(|view| view.observed(&stage.body)));
        }
        if !matches.is_empty() {
            let suspected = self.lens_watch.by_matches();
            let is_global = self.shutter.readout_s == 0.0 && self.readout.used().sigma_s == 0.0;
            let said = matched_focal(&found.pose.inverse(), &self.camera, &stage.body, &matches, is_global, suspected);
            self.lens_watch.hear_matches(said);
        }
    }

    /// Refuses objects whose residual tile displacements no pose explains. Blur displaces tiles too
    /// while the motion is unknown, so a newly found object is followed for one more frame, which
    /// shows its motion.
    fn refuse_misfits(&mut self) {
        for k in 1..self.bodies.len() {
            let turn = self.fits[k].and_then(|fit| fit.at_most).map_or(0.0, |c| c.fixed_view::<3, 3>(3, 3).trace().max(0.0).sqrt());
            if turn > TUNING.max_misfit_direction_sigma {
                debug!(body = %self.bodies[k].body.name, turn, "misfit");
                (self.verified[k], self.fits[k]) = (None, None);
                let was_followed = self.bodies[k].followed_from.is_some();
                let refuse = if was_followed { TrackedBody::give_up } else { TrackedBody::leave_open };
                refuse(&mut self.bodies[k], Reason::NoPoseFits);
            }
        }
    }

    /// Checks the frame against the stage's model, if a check is due. Returns the news and the
    /// workers' time, milliseconds.
    fn study_stage(&mut self, frame: &Frame, lens: LensState) -> Option<(Option<ModelNews>, f64)> {
        let tracked = self.bodies.first_mut()?;
        if !tracked.is_study_due(lens == LensState::Fits && !tracked.is_readout_in_doubt()) {
            return None;
        }
        let verified = self.verified.first()?.as_ref()?;
        Some(self.search.study(frame, tracked, verified))
    }

    /// Updates the track state of body `k` with the frame's pose and returns the sighting.
    fn sighting_of(&mut self, k: usize, timestamp: Timestamp, lens: LensState) -> BodySighting {
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
        // A conclusive frame confirms itself, unless model misfit leaves the pose uncertain.
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
            let by_lens = covariance_by_lens(&v.pose, &self.camera, observations).filter(|_| self.settings.adds_lens_doubt);
            let by_shape = tracked.covariance_by_shape(&v.pose, &self.camera);
            let fit = self.fits[k];
            let by_focal = self.lens_watch.strayed().filter(|_| fit.is_some());
            let by_focal = by_focal.and_then(|strayed| tracked.covariance_by_focal(&v.pose, strayed));
            let by_misfit = Some(tracked.covariance_by_misfit()).filter(|covariance| *covariance != Matrix6::zeros());
            let by_readout = tracked.covariance_by_readout(&v.pose, self.readout.sigma_s());
            let by_surfaces = tracked.covariance_by_surfaces(&v.pose, &self.camera);
            let by_mixture = self.by_mixture.filter(|_| k == 0);
            let by_model = [by_lens, by_shape, by_surfaces, by_focal, by_misfit, by_readout, by_mixture];
            v.by_model = by_model.into_iter().flatten().reduce(|sum, more| sum + more);
            v.rms_px = fit.map_or(v.rms_px, |fit| fit.rms_px);
        }
        BodySighting { state, verified, reason }
    }

    /// Whether the last frame resulted in a tracked pose of the stage.
    pub fn has_given(&self) -> bool {
        self.has_given
    }

    /// Advances the time by a row without a picture and returns its sighting.
    pub fn look_away(&mut self, sequence: u64, timestamp: Timestamp, reason: Reason) -> Sighting {
        self.interval.update(timestamp);
        let (coast_s, confirm) = (longest_coast_s(&self.settings, &self.interval), self.settings.confirm_frames);
        let learnt = self.learnt();
        let states = self.bodies.iter_mut().map(|b| b.track.update(timestamp, None, coast_s, confirm));
        Sighting { learnt, ..Sighting::without_picture(sequence, timestamp, true, reason, states) }
    }

    /// Returns the sighting of a row whose timestamp is unusable (out of order); changes no state.
    pub fn look_past(&self, sequence: u64, timestamp: Timestamp) -> Sighting {
        let idle = |b: &TrackedBody| if b.track.state() == State::Searching { State::Searching } else { State::Lost };
        let sighting = Sighting::without_picture(sequence, timestamp, false, Reason::Skipped, self.bodies.iter().map(idle));
        Sighting { learnt: self.learnt(), ..sighting }
    }

    /// Starts sending the pixels that poses rest on: per frame, before the frame's sighting is
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

    /// Fixes the shutter to this one; from now on every frame is asked what it says about it (see
    /// [`shutter_clue`](Self::shutter_clue)).
    pub fn ask_shutter(&mut self, shutter: Shutter) {
        (self.shutter, self.is_shutter_given) = (shutter, true);
        self.search.set_shutter(shutter, 0.0);
        self.bodies.iter_mut().for_each(|b| b.aligner.ask_shutter(shutter));
    }

    /// From now on checks every frame against the stage's model, for
    /// [`model_report`](Self::model_report).
    pub fn study_model(&mut self) {
        self.bodies.iter_mut().take(1).for_each(TrackedBody::study_model);
    }

    /// Returns how well the stage's model fitted the frames.
    pub fn model_report(&self) -> ModelReport {
        self.bodies.first().map_or_else(ModelReport::default, |stage| stage.model_report(&self.camera))
    }

    /// Returns what the last frame says about the shutter, estimated on the stage; `None` if the
    /// shutter is not asked or the stage was not aligned.
    pub fn shutter_clue(&self) -> Option<ShutterClue> {
        self.bodies.first()?.clue
    }

    /// Aligns the stage from a start with the given uncertainty (one sigma, metres and radians) and
    /// returns the result; `None` if nothing converges. Leaves track state and motion unchanged.
    pub fn try_start(&mut self, frame: &Frame, start: &Pose<Body, Camera>, shift_m: f64, turn_rad: f64) -> Option<Alignment> {
        if frame.image.dimensions() != (self.camera.width(), self.camera.height()) {
            return None;
        }
        self.levels.update(&frame.image);
        let stage = self.bodies.first_mut()?;
        let expected = stage.unseen(*start, [shift_m, turn_rad], None);
        Some(stage.aligner.align(&mut self.levels, &self.camera_rays, &expected, None)?.alignment)
    }

    /// Returns the stage's surfaces that are recognised in a picture, without using any configured
    /// size; for diagnosing a config that does not fit. Leaves track state and motion unchanged.
    pub fn recognise(&mut self, image: &GrayImage) -> Vec<SurfaceView> {
        if image.dimensions() != (self.camera.width(), self.camera.height()) {
            return Vec::new();
        }
        self.bodies.first().map_or(Vec::new(), |stage| self.search.recognise(image, stage))
    }

    /// Returns the pose of the stage estimated from features in a picture, and the matches that
    /// support it; for diagnosing a model that does not fit yet. Leaves track state and motion
    /// unchanged.
    pub fn recognised_pose(&mut self, image: &GrayImage) -> Option<(Pose<Body, Camera>, Vec<SurfaceMatch>)> {
        if image.dimensions() != (self.camera.width(), self.camera.height()) {
            return None;
        }
        self.search.recognised_pose(image, self.bodies.first()?)
    }

    /// Like [`recognised_pose`](Self::recognised_pose), but uses only the strongest features, in a
    /// fifth of the time. May return `None` where that one finds a pose.
    pub fn quickly_recognised_pose(&mut self, image: &GrayImage) -> Option<Pose<Body, Camera>> {
        if image.dimensions() != (self.camera.width(), self.camera.height()) {
            return None;
        }
        self.search.quickly_recognised_pose(image, self.bodies.first()?)
    }

    /// Returns the number of patches of one of the stage's surfaces that fitted the last verified
    /// pose.
    pub fn fitting_patches(&self, surface: usize) -> usize {
        self.bodies.first().map_or(0, |stage| stage.anchors.iter().filter(|a| a.surface as usize == surface).count())
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
