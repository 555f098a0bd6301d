//! The matcher: a frame in, a sighting of every body out.
//!
//! A body that was aligned lately is followed: aligned from where it should be by now. For the others features are
//! found and matched once; each has its candidate poses (failing those, where it should be), of which the first that the
//! picture clearly verifies is aligned in turn. Its lock decides what that means. The matcher owns all buffers of the hot
//! path.

use crossbeam_channel::{Receiver, Sender};
use image::GrayImage;
use nalgebra::{Matrix3, Matrix6, Vector2};
use tracing::{debug, debug_span};

use super::acquire::{candidates, surface_matches};
use super::align::{Aligner, Alignment, Eye, FrameLevels, Jerk, MotionEstimate, Patch, Sensor, ShutterClue, UsedPixel};
use super::lock::{Lock, LockState};
use super::reference::{PreparedBody, halve_into};
use super::registration::SearchPicture;
use super::settings::TrackerSettings;
use super::shutter::Shutter;
use super::surface::BodySpec;
use super::two_view::{TwoView, two_view};
use super::verify::{FittedAnchor, Verified, VerifyBuffers, View, verify};
use crate::camera::{CameraModel, Normalized};
use crate::compute_clock::ComputeClock;
use crate::features::{ExtractorOptions, Feature, FeatureExtractor, Workers};
use crate::frame::Frame;
use crate::geometry::resection::{Observation, Twist, perturbed};
use crate::geometry::{Body, Camera, Pose};
use crate::matching::{Match, MatchBuffers, ReferenceIndex};

/// What a frame showed of one body.
#[derive(Debug, Clone)]
pub struct BodySighting {
    /// The lock's verdict.
    pub state: LockState,
    /// The verified pose; present while tracking.
    pub verified: Option<Verified>,
}

/// What a frame showed.
#[derive(Debug, Clone)]
pub struct Sighting {
    /// Row number.
    pub sequence: u64,
    /// Stamp of the frame, nanoseconds.
    pub timestamp_ns: i64,
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

/// The pixels that the poses of a frame rest on.
#[derive(Debug, Clone)]
pub struct UsedPixels {
    /// Row number of the frame.
    pub sequence: u64,
    /// Of all bodies that were aligned.
    pub pixels: Vec<UsedPixel>,
}

struct TrackedBody {
    body: PreparedBody,
    /// Its surfaces' numbers in the reference index.
    surfaces: std::ops::Range<u32>,
    lock: Lock,
    aligner: Aligner,
    patches: Vec<Patch>,
    /// The motion at the last aligned frame, and its stamp.
    motion: Option<(MotionEstimate, i64)>,
    /// How jerky that is.
    jerk: Jerk,
    /// The last verified pose, its stamp, and the motion that led to it.
    before: Option<(Pose<Camera, Body>, i64, Option<Twist>)>,
    /// What the last frame said of the shutter, where that is asked and the body was aligned.
    clue: Option<ShutterClue>,
    /// The pixels that the last pose rests on, where somebody watches them.
    used: Option<Vec<UsedPixel>>,
}

impl TrackedBody {
    /// Aligns the body and judges the result. `is_expected`: the start comes from the motion of an aligned body.
    fn align(
        &mut self,
        frame: &Frame,
        levels: &mut FrameLevels,
        eye: &Eye,
        expected: &MotionEstimate,
        is_expected: bool,
    ) -> Option<Verified> {
        let found = self.aligner.align(levels, eye, expected)?;
        debug!(
            share = found.share(),
            tiles = found.tiles,
            scale = found.scale,
            inliers = found.inliers,
            surprise = found.surprise,
            "aligned"
        );
        if !found.is_credible(is_expected) {
            return None;
        }
        self.clue = self.aligner.shutter_clue();
        if !is_expected {
            self.jerk = Jerk::default();
        } else if self.clue.is_none() {
            // Where the shutter is in question, jerk must not explain what a wrong one does.
            self.jerk.learn(expected, &found.estimate.motion);
        }
        self.motion = Some((found.estimate, frame.timestamp_ns));
        if let Some(used) = &mut self.used {
            self.aligner.used_pixels(eye, used);
        }
        self.aligner.patches(eye, &found.estimate.motion, &mut self.patches);
        Some(aligned(&self.body, &found, &self.patches, eye.camera()))
    }

    /// Remembers a verified pose for the motion of the next frame.
    fn remember(&mut self, timestamp_ns: i64, pose: &Pose<Camera, Body>) {
        let twist = self.before_at(timestamp_ns).map(|(before, dt_s, _)| Twist::between(&before, pose, dt_s));
        self.before = Some((*pose, timestamp_ns, twist));
    }

    /// Where the body should be at a stamp, carried on from the last verified poses.
    fn predicted(&self, timestamp_ns: i64) -> Option<Pose<Camera, Body>> {
        let (before, dt_s, twist) = self.before_at(timestamp_ns)?;
        Some(twist.map_or(before, |twist| perturbed(&before, &(twist.0 * dt_s))))
    }

    /// The last verified pose as seen from a stamp, if it is recent enough to tell of motion.
    fn before_at(&self, timestamp_ns: i64) -> Option<(Pose<Camera, Body>, f64, Option<Twist>)> {
        let (pose, then_ns, twist) = self.before?;
        let dt_s = timestamp_ns.saturating_sub(then_ns) as f64 * 1e-9;
        (dt_s > 1e-4 && dt_s <= LONGEST_MOTION_GAP_S).then_some((pose, dt_s, twist))
    }
}

/// Finds all bodies in every frame, from scratch.
pub struct Matcher {
    camera: CameraModel,
    settings: TrackerSettings,
    mask: Option<GrayImage>,
    readout_s: f64,
    /// The stage first, then the objects.
    bodies: Vec<TrackedBody>,
    index: ReferenceIndex,
    workers: Workers,
    extractor: FeatureExtractor,
    features: Vec<Feature>,
    matches: Vec<Match>,
    match_buffers: MatchBuffers,
    verify_buffers: VerifyBuffers,
    half: GrayImage,
    eye: Eye,
    levels: FrameLevels,
    watcher: Option<Sender<UsedPixels>>,
}

/// Lowe's ratio.
const RATIO: f32 = 0.85;
/// Reference features of all surfaces together, and of one at least.
const REFERENCE_FEATURES: usize = 4000;
const LEAST_REFERENCE_FEATURES: usize = 700;
/// Artwork is looked at for features at no more than this many pixels across: no camera resolves more.
const LARGEST_REFERENCE_PX: u32 = 2000;
/// Verified poses further apart tell nothing of the motion within a frame, seconds.
const LONGEST_MOTION_GAP_S: f64 = 0.07;
/// An aligned body is followed over gaps up to this, seconds.
const LONGEST_FOLLOWED_GAP_S: f64 = 0.1;
/// How far off a pose that features found may be, one sigma: of the distance, and radians.
const FIRST_SHIFT: f64 = 0.003;
const FIRST_TURN: f64 = 0.003;
/// Candidates of a body that are put to the test per frame.
const TRIED: usize = 3;
/// Share of fitting anchors beyond which no rival is asked.
const CLEAR_SHARE: f64 = 0.6;

impl Matcher {
    /// Prepares the reference pictures; takes a fraction of a second per surface.
    pub fn new(
        camera: CameraModel,
        readout_s: f64,
        exposure_s: f64,
        mask: Option<GrayImage>,
        stage: &BodySpec,
        objects: &[BodySpec],
        settings: TrackerSettings,
    ) -> Self {
        let workers = Workers::new(settings.threads);
        let mut bodies = Vec::new();
        let mut next = 0;
        for spec in std::iter::once(stage).chain(objects) {
            let body = PreparedBody::new(spec);
            let surfaces = next..next + body.surfaces.len() as u32;
            next = surfaces.end;
            let aligner = Aligner::new(&body, Sensor { readout_s, exposure_s });
            bodies.push(TrackedBody {
                body,
                surfaces,
                lock: Lock::default(),
                aligner,
                patches: Vec::new(),
                motion: None,
                jerk: Jerk::default(),
                before: None,
                clue: None,
                used: None,
            });
        }
        let index = reference_index(&bodies, &workers);
        workers.take_extra_ms();
        Self {
            eye: Eye::new(camera, mask.clone()),
            levels: FrameLevels::default(),
            watcher: None,
            camera,
            settings,
            mask,
            readout_s,
            bodies,
            index,
            workers,
            extractor: FeatureExtractor::default(),
            features: Vec::new(),
            matches: Vec::new(),
            match_buffers: MatchBuffers::default(),
            verify_buffers: VerifyBuffers::default(),
            half: GrayImage::default(),
        }
    }

    /// Looks for every body in a frame. A frame of another size than the camera's shows nothing.
    pub fn look(&mut self, frame: &Frame) -> Sighting {
        let _span = debug_span!("match", sequence = frame.sequence).entered();
        if frame.image.dimensions() != (self.camera.width(), self.camera.height()) {
            return self.look_away(frame.sequence, frame.timestamp_ns);
        }
        for tracked in &mut self.bodies {
            tracked.clue = None;
        }
        let start = ComputeClock::start();
        self.levels.update(&frame.image);
        let mut verified: Vec<Option<Verified>> = (0..self.bodies.len()).map(|k| self.follow(k, frame)).collect();
        let mut align_ms = start.elapsed_ms();
        let mut acquire_ms = 0.0;
        if verified.iter().any(Option::is_none) {
            self.extract(frame, &mut acquire_ms);
            for (k, verified) in verified.iter_mut().enumerate().filter(|(_, v)| v.is_none()) {
                *verified = self.find(k, frame, &mut acquire_ms, &mut align_ms);
            }
        }
        self.show_pixels(frame.sequence);
        let mut sightings = Vec::with_capacity(self.bodies.len());
        for (tracked, verified) in self.bodies.iter_mut().zip(verified) {
            if let Some(v) = &verified {
                tracked.remember(frame.timestamp_ns, &v.pose);
            }
            // A frame that leaves no doubt confirms itself, unless the motion during its readout is still unknown.
            let conclusive = verified.as_ref().is_some_and(|v| v.is_conclusive) && self.readout_s == 0.0;
            let confirm_frames = if conclusive { 1 } else { self.settings.confirm_frames };
            let pose = verified.as_ref().map(|v| &v.pose);
            let state = tracked.lock.update(frame.timestamp_ns, pose, self.settings.coast_s, confirm_frames);
            let verified = verified.filter(|_| state == LockState::Tracking);
            sightings.push(BodySighting { state, verified });
        }
        let start = ComputeClock::start();
        let two_view = sightings[0].verified.as_ref().map(|v| {
            let _span = debug_span!("two_view").entered();
            two_view(&self.bodies[0].body, v, &self.camera, self.settings.seed)
        });
        align_ms += start.elapsed_ms();
        let objects = sightings.split_off(1);
        let stage = sightings.remove(0);
        Sighting {
            sequence: frame.sequence,
            timestamp_ns: frame.timestamp_ns,
            is_timed: true,
            stage,
            two_view,
            objects,
            acquire_ms,
            align_ms,
        }
    }

    /// Time went on, but there was no picture.
    pub fn look_away(&mut self, sequence: u64, timestamp_ns: i64) -> Sighting {
        let (coast_s, confirm) = (self.settings.coast_s, self.settings.confirm_frames);
        let mut states =
            self.bodies.iter_mut().map(|b| BodySighting { state: b.lock.update(timestamp_ns, None, coast_s, confirm), verified: None });
        // There is always a stage.
        let stage = states.next().unwrap_or(BodySighting { state: LockState::Searching, verified: None });
        let objects = states.collect();
        Sighting { sequence, timestamp_ns, is_timed: true, stage, two_view: None, objects, acquire_ms: 0.0, align_ms: 0.0 }
    }

    /// A row that tells nothing of its time (a stamp out of order): nothing changes.
    pub fn look_past(&self, sequence: u64, timestamp_ns: i64) -> Sighting {
        let idle = |b: &TrackedBody| {
            let state = if b.lock.state() == LockState::Searching { LockState::Searching } else { LockState::Lost };
            BodySighting { state, verified: None }
        };
        let stage = idle(&self.bodies[0]);
        let objects = self.bodies[1..].iter().map(idle).collect();
        Sighting { sequence, timestamp_ns, is_timed: false, stage, two_view: None, objects, acquire_ms: 0.0, align_ms: 0.0 }
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
    pub fn ask_shutter(&mut self, sensor: Sensor) {
        self.readout_s = sensor.readout_s;
        self.bodies.iter_mut().for_each(|b| b.aligner.ask_shutter(sensor));
    }

    /// What the last frame said of the shutter through the stage; `None` where it is not asked, or the stage was not aligned.
    pub fn shutter_clue(&self) -> Option<ShutterClue> {
        self.bodies.first()?.clue
    }

    /// Features of the frame and their matches, for bodies that were lost.
    fn extract(&mut self, frame: &Frame, acquire_ms: &mut f64) {
        let _span = debug_span!("detect").entered();
        let start = ComputeClock::start();
        let options = ExtractorOptions { count: self.settings.features, ..Default::default() };
        self.extractor.extract(&frame.image, self.mask.as_ref(), &options, &self.workers, &mut self.features);
        self.index.match_features(&self.features, RATIO, &self.workers, &mut self.match_buffers, &mut self.matches);
        halve_into(&frame.image, &mut self.half);
        *acquire_ms += start.elapsed_ms() + self.workers.take_extra_ms();
    }

    /// Aligns a body from where it should be; `None` where it was not aligned lately, or the picture does not bear it out.
    fn follow(&mut self, k: usize, frame: &Frame) -> Option<Verified> {
        let tracked = &mut self.bodies[k];
        let (estimate, then_ns) = tracked.motion.take()?;
        let dt_s = frame.timestamp_ns.saturating_sub(then_ns) as f64 * 1e-9;
        if dt_s <= 0.0 || dt_s > LONGEST_FOLLOWED_GAP_S {
            return None;
        }
        let _span = debug_span!("follow", body = %tracked.body.name).entered();
        let expected = estimate.after(dt_s, tracked.aligner.distance(&estimate.motion.pose), &tracked.jerk);
        tracked.align(frame, &mut self.levels, &self.eye, &expected, true)
    }

    /// The best verified pose of a body in this frame, aligned where that succeeds.
    fn find(&mut self, k: usize, frame: &Frame, acquire_ms: &mut f64, align_ms: &mut f64) -> Option<Verified> {
        let verified = self.find_by_features(k, frame, acquire_ms, align_ms)?;
        let start = ComputeClock::start();
        let tracked = &mut self.bodies[k];
        let back = verified.pose.inverse();
        let distance = tracked.aligner.distance(&back);
        let first = MotionEstimate::unseen(back, distance, FIRST_SHIFT * distance, FIRST_TURN);
        let aligned = tracked.align(frame, &mut self.levels, &self.eye, &first, false);
        *align_ms += start.elapsed_ms();
        aligned.or(Some(verified))
    }

    /// The best pose that patches at matched features verify.
    fn find_by_features(&mut self, k: usize, frame: &Frame, acquire_ms: &mut f64, align_ms: &mut f64) -> Option<Verified> {
        let tracked = &self.bodies[k];
        let start = ComputeClock::start();
        let found = {
            let _span = debug_span!("acquire", body = %tracked.body.name).entered();
            let own = surface_matches(&self.matches, &self.features, self.index.features(), tracked.surfaces.clone(), &self.camera);
            let found = candidates(&tracked.body, &own, &self.camera, self.settings.seed);
            debug!(matches = own.len(), candidates = found.len(), inliers = found.first().map_or(0, |c| c.inliers));
            found
        };
        *acquire_ms += start.elapsed_ms();
        let start = ComputeClock::start();
        let _span = debug_span!("align", body = %tracked.body.name).entered();
        let view = View {
            camera: &self.camera,
            full: SearchPicture { image: &frame.image, scale: 1.0, mask: self.mask.as_ref() },
            half: SearchPicture { image: &self.half, scale: 2.0, mask: self.mask.as_ref() },
            shutter: Shutter { readout_s: self.readout_s, before: tracked.before_at(frame.timestamp_ns) },
            workers: &self.workers,
        };
        let continued = tracked.lock.is_continued();
        let starts = found.iter().take(TRIED).map(|c| c.pose);
        let mut best = best_verified(tracked, starts, &view, continued, &mut self.verify_buffers);
        if best.is_none() && continued {
            // Too few features, as under blur or steep tilt: where the body should be by now is a start as good as any.
            let predicted = tracked.predicted(frame.timestamp_ns);
            best = best_verified(tracked, predicted.into_iter(), &view, continued, &mut self.verify_buffers);
        }
        *align_ms += start.elapsed_ms() + self.workers.take_extra_ms();
        best
    }

    /// The camera that frames are taken with.
    pub fn camera(&self) -> &CameraModel {
        &self.camera
    }
}

/// An alignment in the terms of the record: pose and covariance of `T_camera_body`, and correspondences.
fn aligned(body: &PreparedBody, found: &Alignment, patches: &[Patch], camera: &CameraModel) -> Verified {
    let pose = found.estimate.motion.pose.inverse();
    // R <- R Exp(δθ), p <- p + δp of the inverse, as a left perturbation of the pose: φ = -δθ, τ = -Rᵀ δp.
    let mut by_error = Matrix6::zeros();
    by_error.fixed_view_mut::<3, 3>(0, 0).copy_from(&(-pose.rotation_matrix()));
    by_error.fixed_view_mut::<3, 3>(3, 3).copy_from(&(-Matrix3::identity()));
    let covariance = by_error * found.covariance * by_error.transpose();
    let anchor = |p: &Patch| {
        let spec = &body.surfaces[p.surface as usize].spec;
        let artwork = spec.artwork_from_metres(p.on_surface_m);
        let point = spec.body_point(artwork);
        let seen = pose.transform(&point);
        let steady_px = camera.project(Normalized(seen.coords.xy() / seen.z)).0 + p.shift_px;
        let observation = Observation { point, pixel: steady_px, information: p.information, delay_s: 0.0, group: p.tile };
        FittedAnchor { surface: p.surface, artwork, observation, steady_px }
    };
    Verified {
        pose,
        covariance: (covariance + covariance.transpose()) * 0.5,
        anchors: patches.iter().map(anchor).collect(),
        share: found.share(),
        inliers: found.inliers as usize,
        rms_px: found.rms_px,
        is_conclusive: found.is_conclusive(),
    }
}

/// Puts starts to the test, and takes the first clear success, or the best of what passes.
fn best_verified(
    tracked: &TrackedBody,
    starts: impl Iterator<Item = Pose<Camera, Body>>,
    view: &View,
    continued: bool,
    buffers: &mut VerifyBuffers,
) -> Option<Verified> {
    let mut best: Option<Verified> = None;
    for start in starts {
        match verify(&tracked.body, &start, view, continued, buffers) {
            Ok(v) => {
                debug!(anchors = v.anchors.len(), share = v.share, rms_px = v.rms_px, "verified");
                let clear = v.share > CLEAR_SHARE;
                if best.as_ref().is_none_or(|b| v.anchors.len() > b.anchors.len()) {
                    best = Some(v);
                }
                if clear {
                    break;
                }
            }
            Err(refusal) => debug!(?refusal, "refused"),
        }
    }
    best
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
