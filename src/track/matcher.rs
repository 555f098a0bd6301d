//! The matcher: a frame in, a sighting of every body out.
//!
//! A body that was aligned lately is followed: aligned from where it should be by now. For the others features are
//! found and matched once; each has its candidate poses (failing those, where it should be), of which the first that the
//! picture clearly verifies is aligned in turn. Its track state decides what that means. The matcher owns all buffers of the hot
//! path.

use crossbeam_channel::{Receiver, Sender};
use image::GrayImage;
use nalgebra::Vector2;
use tracing::{debug, debug_span};

use super::acquire::{SurfaceMatch, SurfaceView, candidates, surface_matches, surface_view};
use super::align::{Alignment, CameraRays, FrameLevels, ShutterClue, UsedPixel};
use super::frame_interval::FrameInterval;
use super::frame_look::FrameLook;
use super::lens_doubt::{covariance_by_lens, covariance_by_shape};
use super::lens_watch::{LensState, LensWatch};
use super::reason::Reason;
use super::registration::SearchPicture;
use super::row_motion::RowMotion;
use super::settings::TrackerSettings;
use super::surface::BodySpec;
use super::track_state::State;
use super::tracked_body::{FIRST_SHIFT, FIRST_TURN, ModelFit, TrackedBody};
use super::two_view::{TwoView, TwoViewBuffers, two_view};
use super::unexplained::Unexplained;
use super::verify::{Verified, VerifyBuffers, View};
use crate::camera::{CameraModel, Shutter};
use crate::compute_clock::ComputeClock;
use crate::features::{ExtractorOptions, Feature, FeatureExtractor, Workers};
use crate::frame::{Frame, Timestamp};
use crate::geometry::{Body, Camera, Pose};
use crate::matching::{Match, MatchBuffers, ReferenceIndex};
use crate::motion::MotionEstimate;

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
        Self { sequence, timestamp, is_timed, stage, two_view: None, objects: bodies.collect(), acquire_ms: 0.0, align_ms: 0.0 }
    }
}

/// The pixels that the poses of a frame rest on.
#[derive(Debug, Clone)]
pub struct UsedPixels {
    /// Row number of the frame.
    pub sequence: u64,
    /// Of all bodies that were aligned.
    pub pixels: Vec<UsedPixel>,
}

/// Finds all bodies in every frame, from scratch.
pub struct Matcher {
    camera: CameraModel,
    settings: TrackerSettings,
    mask: Option<GrayImage>,
    clock: ComputeClock,
    shutter: Shutter,
    interval: FrameInterval,
    /// The stage first, then the objects.
    bodies: Vec<TrackedBody>,
    index: ReferenceIndex,
    workers: Workers,
    extractor: FeatureExtractor,
    features: Vec<Feature>,
    unexplained: Unexplained,
    matches: Vec<Match>,
    match_buffers: MatchBuffers,
    verify_buffers: VerifyBuffers,
    two_view_buffers: TwoViewBuffers,
    /// What the frame showed of each body.
    verified: Vec<Option<Verified>>,
    /// How well the model fits what was shown.
    fits: Vec<Option<ModelFit>>,
    lens_watch: LensWatch,
    half: GrayImage,
    camera_rays: CameraRays,
    levels: FrameLevels,
    watcher: Option<Sender<UsedPixels>>,
}

/// Lowe's ratio (2004, section 7.1): a match counts where its distance is less than this share of the second nearest's. He took 0.8; more
/// are let through here, as acquisition bears a majority of wrong matches. Raised, more of them are wrong; lowered, dim stages keep too
/// few.
const RATIO: f32 = 0.85;
/// Reference features of all surfaces together, and of one at least. Chosen, not tuned. Raised, matching costs more in proportion; lowered,
/// fewer features of a stage that is seen in part or small are among them.
const REFERENCE_FEATURES: usize = 4000;
const LEAST_REFERENCE_FEATURES: usize = 700;
/// Artwork is looked at for features at no more than this many pixels across, or down where it is higher: no camera resolves more. Raised,
/// features are spent on detail that no frame shows; lowered, close views find fewer.
const LARGEST_REFERENCE_PX: u32 = 2000;
/// Candidates of a body that are put to the test per frame, of four at most, best first. Two planar poses and one in reserve. Raised,
/// frames without the stage cost more; lowered to 1, the wrong one of two planar poses may be the only one tried.
const TRIED: usize = 3;

impl Matcher {
    /// Prepares the reference pictures; takes a fraction of a second per surface.
    pub fn new(
        camera: CameraModel,
        shutter: Shutter,
        mask: Option<GrayImage>,
        stage: &BodySpec,
        objects: &[BodySpec],
        settings: TrackerSettings,
        clock: ComputeClock,
    ) -> Self {
        let workers = Workers::new(settings.threads).measured_with(clock);
        let mut bodies: Vec<TrackedBody> = Vec::new();
        for spec in std::iter::once(stage).chain(objects) {
            let first = bodies.last().map_or(0, |b| b.surfaces.end);
            bodies.push(TrackedBody::new(spec, first, shutter));
        }
        let index = reference_index(&bodies, &workers);
        workers.take_extra_ms();
        Self {
            camera_rays: CameraRays::new(camera, mask.clone()),
            levels: FrameLevels::default(),
            watcher: None,
            camera,
            settings,
            mask,
            clock,
            shutter,
            interval: FrameInterval::default(),
            bodies,
            index,
            workers,
            extractor: FeatureExtractor::default(),
            features: Vec::new(),
            unexplained: Unexplained::default(),
            matches: Vec::new(),
            match_buffers: MatchBuffers::default(),
            verify_buffers: VerifyBuffers::default(),
            two_view_buffers: TwoViewBuffers::default(),
            verified: Vec::new(),
            fits: Vec::new(),
            lens_watch: LensWatch::default(),
            half: GrayImage::default(),
        }
    }

    /// Looks for every body in a frame. A frame of another size than the camera's shows nothing.
    pub fn look(&mut self, frame: &Frame) -> Sighting {
        let _span = debug_span!("match", sequence = frame.sequence).entered();
        if frame.image.dimensions() != (self.camera.width(), self.camera.height()) {
            return self.look_away(frame.sequence, frame.timestamp, Reason::Skipped);
        }
        self.interval.update(frame.timestamp);
        for tracked in &mut self.bodies {
            (tracked.clue, tracked.refusal, tracked.reason) = (None, None, None);
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
        let mut acquire_ms = 0.0;
        if self.verified.iter().any(Option::is_none) {
            if self.verified[0].is_some() {
                self.extract_unexplained(&frame.image, &mut acquire_ms);
            } else {
                self.extract(&frame.image, &mut acquire_ms);
            }
            self.levels.half_into(&mut self.half);
            for k in 0..self.bodies.len() {
                if self.verified[k].is_none() {
                    self.verified[k] = self.find(k, frame, &mut acquire_ms, &mut align_ms);
                }
            }
            self.give_reasons();
        }
        self.show_pixels(frame.sequence);
        let start = self.clock.start();
        let lens = self.watch_lens(frame.timestamp);
        align_ms += start.elapsed_ms();
        let stage = self.sighting_of(0, frame.timestamp, lens);
        let objects = (1..self.bodies.len()).map(|k| self.sighting_of(k, frame.timestamp, lens)).collect();
        let start = self.clock.start();
        let two_view = stage.verified.as_ref().map(|v| {
            let _span = debug_span!("two_view").entered();
            let TrackedBody { body, anchors, .. } = &self.bodies[0];
            two_view(body, v, anchors, &self.camera, self.settings.seed, &mut self.two_view_buffers)
        });
        align_ms += start.elapsed_ms();
        Sighting { sequence: frame.sequence, timestamp: frame.timestamp, is_timed: true, stage, two_view, objects, acquire_ms, align_ms }
    }

    /// Asks every body that was found how well the model fits, and what of it a lens that was moved would explain.
    fn watch_lens(&mut self, timestamp: Timestamp) -> LensState {
        let (camera, shutter, is_moved) = (&self.camera, self.shutter, self.lens_watch.is_moved());
        self.fits.clear();
        let bodies = self.bodies.iter_mut().zip(&self.verified);
        self.fits.extend(bodies.map(|(body, verified)| {
            let rows = RowMotion { shutter, before: body.before_at(timestamp) };
            body.model_fit(&verified.as_ref()?.pose, camera, &rows, is_moved)
        }));
        // All are seen through one lens: the body that tells most of it speaks.
        let clues = self.fits.iter().flatten().filter_map(|fit| fit.focal.as_ref());
        let clue = clues.min_by(|a, b| a.sigma.total_cmp(&b.sigma));
        let doubt = camera.doubt().map_or(0.0, |doubt| doubt.uncertainty.focal_px[0] / (3.0 * camera.intrinsics().fx));
        let is_seen = self.fits.iter().any(Option::is_some);
        self.lens_watch.update(clue, is_seen, doubt)
    }

    /// What the track state makes of the frame's pose of body `k`.
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
        // A frame that leaves no doubt confirms itself, unless the motion during its readout is still unknown.
        let conclusive = verified.is_some_and(|v| v.is_conclusive) && self.shutter.readout_s == 0.0;
        let confirm_frames = if conclusive { 1 } else { self.settings.confirm_frames };
        let pose = verified.as_ref().map(|v| &v.pose);
        let coast_s = longest_coast_s(&self.settings, &self.interval);
        let state = tracked.track.update(timestamp, pose, coast_s, confirm_frames);
        let reason = tracked.reason.or_else(|| tracked.track.doubt().map(Reason::of_doubt)).filter(|_| state != State::Tracking);
        let mut verified = verified.filter(|_| state == State::Tracking);
        if let Some(v) = &mut verified {
            let observations = tracked.anchors.iter().map(|anchor| &anchor.observation);
            let by_lens = covariance_by_lens(&v.pose, &self.camera, observations).filter(|_| self.settings.adds_lens_doubt);
            let by_shape = covariance_by_shape(&v.pose, &self.camera, &tracked.body.surfaces, &tracked.anchors);
            let fit = self.fits[k];
            v.by_model = [by_lens, by_shape, fit.and_then(|fit| fit.covariance)].into_iter().flatten().reduce(|sum, more| sum + more);
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
        let (sender, receiver) = crossbeam_channel::unbounded();
        self.watcher = Some(sender);
        self.bodies.iter_mut().for_each(|b| b.used = Some(Vec::new()));
        receiver
    }

    fn show_pixels(&mut self, sequence: u64) {
        let Some(watcher) = &self.watcher else { return };
        let pixels = self.bodies.iter_mut().filter_map(|b| b.used.as_mut()).flat_map(|used| used.drain(..)).collect();
        // Nobody may be watching any more.
        let _ = watcher.send(UsedPixels { sequence, pixels });
    }

    /// From now on the shutter is taken as given, and every frame is asked what it says of it.
    pub fn ask_shutter(&mut self, shutter: Shutter) {
        self.shutter = shutter;
        self.bodies.iter_mut().for_each(|b| b.aligner.ask_shutter(shutter));
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
        let expected = MotionEstimate::unseen(*start, stage.aligner.distance_m(start), shift_m, turn_rad);
        Some(stage.aligner.align(&mut self.levels, &self.camera_rays, &expected, None)?.alignment)
    }

    /// The stage's surfaces that are recognised in a picture, before any size is asked: for studies of a config that does not fit. Neither the
    /// lock nor the motion take notice.
    pub fn recognise(&mut self, image: &GrayImage) -> Vec<SurfaceView> {
        if image.dimensions() != (self.camera.width(), self.camera.height()) {
            return Vec::new();
        }
        self.extract(image, &mut 0.0);
        let Some(stage) = self.bodies.first() else { return Vec::new() };
        let own = surface_matches(&self.matches, &self.features, self.index.features(), stage.surfaces.clone(), &self.camera);
        (0..stage.surfaces.len() as u32).filter_map(|k| surface_view(k, &own, &self.camera, self.settings.seed)).collect()
    }

    /// Where features put the stage in a picture, and the matches that speak for it; for studies of a model that does not fit yet. Neither the lock nor the
    /// motion take notice.
    pub fn recognised_pose(&mut self, image: &GrayImage) -> Option<(Pose<Body, Camera>, Vec<SurfaceMatch>)> {
        if image.dimensions() != (self.camera.width(), self.camera.height()) {
            return None;
        }
        self.extract(image, &mut 0.0);
        let stage = self.bodies.first()?;
        let own = surface_matches(&self.matches, &self.features, self.index.features(), stage.surfaces.clone(), &self.camera);
        let (found, _) = candidates(&stage.body, &own, &self.camera, self.settings.seed);
        let pose = found.first()?.pose.inverse();
        let views = (0..stage.surfaces.len() as u32).filter_map(|k| surface_view(k, &own, &self.camera, self.settings.seed));
        Some((pose, views.flat_map(|view| view.matches).collect()))
    }

    /// Patches of one of the stage's surfaces that fitted the last verified pose.
    pub fn fitting_patches(&self, surface: usize) -> usize {
        self.bodies.first().map_or(0, |stage| stage.anchors.iter().filter(|a| a.surface as usize == surface).count())
    }

    /// Features of the frame and their matches, for bodies that were lost.
    fn extract(&mut self, image: &GrayImage, acquire_ms: &mut f64) {
        let _span = debug_span!("detect").entered();
        let start = self.clock.start();
        let options = ExtractorOptions { count: self.settings.features, ..Default::default() };
        self.extractor.extract(image, self.mask.as_ref(), &options, &self.workers, &mut self.features);
        self.index.match_features(&self.features, RATIO, &self.workers, &mut self.match_buffers, &mut self.matches);
        *acquire_ms += start.elapsed_ms() + self.workers.take_extra_ms();
    }

    /// As [`extract`](Self::extract), only where the frame shows something else than the bodies that were followed: once the stage's pose is
    /// known, the rest need not be looked for in front of what is plainly it.
    fn extract_unexplained(&mut self, image: &GrayImage, acquire_ms: &mut f64) {
        let _span = debug_span!("detect").entered();
        let start = self.clock.start();
        let seen = self.bodies.iter().zip(&self.verified).filter_map(|(b, v)| v.as_ref().map(|v| (&b.body, v.pose)));
        self.unexplained.look(seen, &mut self.levels, &self.camera_rays);
        self.unexplained.extract(image, self.mask.as_ref(), self.settings.features, &mut self.extractor, &self.workers, &mut self.features);
        self.index.match_features(&self.features, RATIO, &self.workers, &mut self.match_buffers, &mut self.matches);
        *acquire_ms += start.elapsed_ms() + self.workers.take_extra_ms();
    }

    /// Says of every body without a verified pose why it has none.
    fn give_reasons(&mut self) {
        let mut look = None;
        for (tracked, _) in self.bodies.iter_mut().zip(&self.verified).filter(|(_, verified)| verified.is_none()) {
            let look = look.get_or_insert_with(|| FrameLook::at(&self.half));
            let reason = Reason::of_failure(&tracked.seen, tracked.refusal, look, self.camera.width());
            debug!(body = %tracked.body.name, ?reason, seen = ?tracked.seen, refusal = ?tracked.refusal, ?look, "no pose");
            tracked.reason = Some(reason);
        }
    }

    /// The best verified pose of a body in this frame, aligned where that succeeds.
    fn find(&mut self, k: usize, frame: &Frame, acquire_ms: &mut f64, align_ms: &mut f64) -> Option<Verified> {
        let verified = self.find_by_features(k, frame, acquire_ms, align_ms)?;
        let start = self.clock.start();
        let tracked = &mut self.bodies[k];
        let distance = tracked.aligner.distance_m(&verified.pose);
        let [shift, turn] = MotionEstimate::off_by_readout(self.shutter.readout_s, distance);
        let first = MotionEstimate::unseen(verified.pose, distance, FIRST_SHIFT * distance + shift, FIRST_TURN + turn);
        let aligned = tracked.align(frame, &mut self.levels, &self.camera_rays, &first, None);
        *align_ms += start.elapsed_ms();
        aligned.or(Some(verified))
    }

    /// The best pose that patches at matched features verify.
    fn find_by_features(&mut self, k: usize, frame: &Frame, acquire_ms: &mut f64, align_ms: &mut f64) -> Option<Verified> {
        let tracked = &mut self.bodies[k];
        let start = self.clock.start();
        let found = {
            let _span = debug_span!("acquire", body = %tracked.body.name).entered();
            let own = surface_matches(&self.matches, &self.features, self.index.features(), tracked.surfaces.clone(), &self.camera);
            let (found, seen) = candidates(&tracked.body, &own, &self.camera, self.settings.seed);
            tracked.seen = seen;
            debug!(matches = own.len(), candidates = found.len(), inliers = found.first().map_or(0, |c| c.inliers));
            found
        };
        *acquire_ms += start.elapsed_ms();
        let start = self.clock.start();
        let _span = debug_span!("align", body = %tracked.body.name).entered();
        let view = View {
            camera: &self.camera,
            full: SearchPicture { image: &frame.image, scale: 1.0, mask: self.mask.as_ref() },
            half: SearchPicture { image: &self.half, scale: 2.0, mask: self.mask.as_ref() },
            row_motion: RowMotion { shutter: self.shutter, before: tracked.before_at(frame.timestamp) },
            workers: &self.workers,
        };
        let starts = found.iter().take(TRIED).map(|c| c.pose);
        let mut best = tracked.best_verified(starts, &view, &mut self.verify_buffers);
        if best.is_none() && tracked.track.is_continued() {
            // Too few features, as under blur or steep tilt: where the body should be by now is a start as good as any.
            let predicted = tracked.predicted(frame.timestamp);
            best = tracked.best_verified(predicted.into_iter(), &view, &mut self.verify_buffers);
        }
        *align_ms += start.elapsed_ms() + self.workers.take_extra_ms();
        best
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

/// Describes all surfaces, larger pictures at no more pixels than a camera resolves.
fn reference_index(bodies: &[TrackedBody], workers: &Workers) -> ReferenceIndex {
    let mut index = ReferenceIndex::default();
    let mut extractor = FeatureExtractor::default();
    let mut features = Vec::new();
    let surfaces: usize = bodies.iter().map(|b| b.body.surfaces.len()).sum();
    let count = (REFERENCE_FEATURES / surfaces.max(1)).max(LEAST_REFERENCE_FEATURES);
    for tracked in bodies {
        for (surface, number) in tracked.body.surfaces.iter().zip(tracked.surfaces.clone()) {
            let fits = |k: &usize| surface.octaves[*k].image.width().max(surface.octaves[*k].image.height()) <= LARGEST_REFERENCE_PX;
            let octave = (0..surface.octaves.len()).find(fits).unwrap_or(surface.octaves.len() - 1);
            let options = ExtractorOptions { count, levels: 16, area_power: 0.35, ..Default::default() };
            extractor.extract(&surface.octaves[octave].image, None, &options, workers, &mut features);
            let scale = f64::from(1u32 << octave);
            let half = Vector2::new(0.5, 0.5);
            index.add(number, &features, |p| (p + half) * scale - half, scale);
        }
    }
    index
}
