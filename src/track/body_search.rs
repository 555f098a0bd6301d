//! Searches for the bodies that are not followed.
//!
//! Features propose candidate poses of a body. Each is aligned; the first one that the picture
//! confirms is the body's pose. Only if none is confirmed are patches registered, around the
//! candidates and around the predicted pose.
//!
//! If nothing is known, the whole frame is searched: first with few features, then with all. Once
//! the stage's pose is known, only the parts of the frame that it leaves unexplained are searched,
//! with a limited amount of work per frame.

use super::tuning::frame_order::TUNING;
use crate::track::acquire::tuning::TUNING as ACQUIRE_TUNING;
use image::GrayImage;
use tracing::{debug, debug_span};

use super::acquire::candidate::{Candidate, SurfaceMatch, SurfaceView, add_candidates_of_few, agreeing_matches, candidates, surface_view};
use super::acquire::expected_candidate::{expected_candidate, prefer_expected_tilt, put_first};
use super::acquire::feature_search::{FeatureSearch, Look};
use super::acquire::unexplained::Unexplained;
use super::align::{CameraRays, FrameLevels, Start};
use super::body::reason::Reason;
use super::body::tracked_body::{TrackedBody, is_near};
use super::frame::frame_look::FrameLook;
use super::patches::registration::SearchPicture;
use super::patches::row_motion::RowMotion;
use super::patches::verify::{FullView, Verified, VerifyBuffers, View, verify};
use super::settings::TrackerSettings;
use crate::camera::{CameraModel, Shutter};
use crate::compute_clock::ComputeClock;
use crate::features::Workers;
use crate::frame::{Frame, Timestamp};
use crate::geometry::{Body, Camera, Pose};
use crate::motion::MotionEstimate;

/// A frame in which bodies are missing, and what is known of it.
pub struct Scene<'a> {
    /// The frame.
    pub frame: &'a Frame,
    /// Its smaller levels.
    pub levels: &'a mut FrameLevels,
    /// The camera's rays.
    pub rays: &'a CameraRays,
    /// The stage first, then the objects.
    pub bodies: &'a mut [TrackedBody],
    /// The verified pose of each body, as far as found.
    pub verified: &'a mut [Option<Verified>],
}

impl Scene<'_> {
    /// Returns how the camera moves relative to the stage, for an object that is searched for once
    /// the stage is known.
    fn camera_motion(&self, body: usize) -> Option<MotionEstimate> {
        let is_known = body > 0 && self.verified[0].is_some();
        self.bodies[0].motion_at(self.frame.timestamp).filter(|_| is_known).copied()
    }

    fn is_complete(&self) -> bool {
        self.verified.iter().all(Option::is_some)
    }

    /// Returns the bodies that are not found in this frame.
    fn missing(&self) -> impl Iterator<Item = &TrackedBody> + Clone {
        self.bodies.iter().zip(&*self.verified).filter(|(_, verified)| verified.is_none()).map(|(body, _)| body)
    }
}

/// Compute spent on a search, milliseconds summed over all workers.
#[derive(Debug, Clone, Copy, Default)]
pub struct Spent {
    /// On finding candidates.
    pub acquire_ms: f64,
    /// On alignment and verification.
    pub align_ms: f64,
}

/// A frame at half size, copied when it is first needed.
#[derive(Default)]
struct HalfSize {
    picture: GrayImage,
    is_current: bool,
}

impl HalfSize {
    /// Begins a frame: the picture is that of an earlier one.
    fn begin_frame(&mut self) {
        self.is_current = false;
    }

    /// Copies the frame, unless that was done.
    fn fill(&mut self, levels: &mut FrameLevels) {
        if !std::mem::replace(&mut self.is_current, true) {
            levels.half_into(&mut self.picture);
        }
    }
}

/// Searches for bodies; keeps its buffers between frames.
pub struct BodySearch {
    camera: CameraModel,
    shutter: Shutter,
    readout_sigma_s: f64,
    mask: Option<GrayImage>,
    seed: u64,
    clock: ComputeClock,
    workers: Workers,
    features: FeatureSearch,
    unexplained: Unexplained,
    verify_buffers: VerifyBuffers,
    half: HalfSize,
    /// Rotates which missing body is tried first once the stage is known, so that each has its
    /// turn.
    turn: usize,
    /// Whether the stage is known, so that only what it leaves unexplained is searched.
    is_beside: bool,
    /// Attempts left in this frame.
    tries: usize,
    spent: Spent,
}

impl BodySearch {
    /// Creates the search. `features`: of all bodies' pictures.
    pub fn new(
        camera: CameraModel,
        shutter: Shutter,
        mask: Option<GrayImage>,
        features: FeatureSearch,
        settings: &TrackerSettings,
        clock: ComputeClock,
    ) -> Self {
        let workers = Workers::new(settings.threads).measured_with(clock);
        Self {
            camera,
            shutter,
            readout_sigma_s: 0.0,
            mask,
            seed: settings.seed,
            clock,
            workers,
            features,
            unexplained: Unexplained::default(),
            verify_buffers: VerifyBuffers::default(),
            half: HalfSize::default(),
            turn: 0,
            is_beside: false,
            tries: 0,
            spent: Spent::default(),
        }
    }

    /// Returns an upper bound of the readout time as far as it is known, seconds.
    fn longest_readout_s(&self) -> f64 {
        self.shutter.readout_s.abs().max(self.readout_sigma_s)
    }

    /// Sets the shutter; `readout_sigma_s`: one sigma of its readout time, seconds.
    pub fn set_shutter(&mut self, shutter: Shutter, readout_sigma_s: f64) {
        (self.shutter, self.readout_sigma_s) = (shutter, readout_sigma_s);
    }

    /// Searches for the missing bodies of a frame and records why each one that stays missing has
    /// no pose. Returns the compute spent.
    pub fn find_missing(&mut self, scene: &mut Scene) -> Spent {
        self.spent = Spent::default();
        self.half.begin_frame();
        if scene.is_complete() {
            return self.spent;
        }
        self.half.fill(scene.levels);
        if let [stage, objects @ ..] = &mut *scene.bodies {
            let missing = objects.iter_mut().zip(&scene.verified[1..]).filter(|(_, verified)| verified.is_none());
            missing.for_each(|(object, _)| object.aligner.take_camera(&stage.aligner));
        }
        if scene.verified[0].is_some() {
            self.find_beside_stage(scene);
        } else {
            self.find_anywhere(scene);
        }
        self.give_reasons(scene);
        self.spent
    }

    /// Returns the compute spent on the current frame so far.
    pub fn spent(&self) -> Spent {
        self.spent
    }

    /// Searches the whole frame: with the fewest features first, with more if those do not match
    /// enough, and with all if the stage is still missing.
    fn find_anywhere(&mut self, scene: &mut Scene) {
        (self.is_beside, self.tries) = (false, usize::MAX);
        self.timed(|search| {
            let Self { features, mask, workers, .. } = search;
            let (image, mask) = (&scene.frame.image, mask.as_ref());
            features.look(image, mask, Look::Glance, workers);
            // So plain a frame has no further features.
            let is_plain = features.features().len() < TUNING.min_glance_features;
            if !is_plain && !scene.missing().all(|body| features.is_enough(body.surfaces.clone())) {
                features.look_again(image, mask, Look::Quick, workers);
            }
        });
        self.find_each(scene, false);
        if self.ends_with_stage(scene) {
            return;
        }
        if self.features.features().len() < TUNING.min_glance_features {
            self.find_by_prediction(scene);
        } else {
            self.find_closely(scene);
        }
    }

    /// Returns whether the stage was found. If so, searches for the other missing bodies in what it
    /// leaves unexplained.
    fn ends_with_stage(&mut self, scene: &mut Scene) -> bool {
        let is_found = scene.verified[0].is_some();
        if is_found && !scene.is_complete() {
            self.find_beside_stage(scene);
        }
        is_found
    }

    /// Compares with all views, including tilted ones: first using the features already extracted,
    /// which suffice for most of these views, then using all features.
    fn find_closely(&mut self, scene: &mut Scene) {
        self.timed(|search| search.features.compare_with_all_views(&search.workers));
        self.find_each(scene, false);
        if self.ends_with_stage(scene) {
            return;
        }
        self.timed(|search| search.features.look_closer(&scene.frame.image, search.mask.as_ref(), &search.workers));
        self.find_each(scene, true);
    }

    /// Searches for the missing bodies only where the frame differs from what the found ones
    /// explain. If much is unexplained, each frame searches a part of it and makes few attempts, so
    /// that frames take about as long whether or not a body is missing.
    fn find_beside_stage(&mut self, scene: &mut Scene) {
        let in_vain = || scene.missing().filter(|body| body.attempt.followed_from.is_some());
        (self.is_beside, self.tries) = (true, TUNING.max_attempts_when_known.saturating_sub(in_vain().count()));
        let is_covered = in_vain().any(|body| body.track.is_continued() && body.has_motion());
        if is_covered {
            // Following a tracked body already cost this frame's time. It is probably at its
            // predicted pose but occluded, which patches can tell. (A body found only in the last
            // frame is excluded: its prediction assumes rest, so it may be elsewhere.)
            self.find_by_prediction(scene);
            return;
        }
        self.timed(|search| {
            let known =
                scene.bodies.iter().zip(&*scene.verified).filter_map(|(b, v)| v.as_ref().map(|v| (b.surfaces.start, &b.body, v.pose)));
            search.unexplained.look(known, scene.levels, scene.rays);
            let places = scene.missing().filter_map(|body| body.expected_place(scene.frame.timestamp, &search.camera));
            search.unexplained.search_first(places);
            let missing = scene.missing().flat_map(|body| body.surfaces.clone());
            search.features.look_beside(&scene.frame.image, search.mask.as_ref(), &mut search.unexplained, missing, &search.workers);
        });
        self.turn = self.turn.wrapping_add(1);
        self.find_each(scene, true);
    }

    /// Searches for each missing body among the extracted features. `is_last`: no closer look
    /// follows that might find a better candidate, so candidates with few matches are tried too,
    /// then patches.
    fn find_each(&mut self, scene: &mut Scene, is_last: bool) {
        let bodies = scene.bodies.len();
        // The stage first; the objects take turns.
        self.find_all_of(std::iter::once(0), scene, is_last);
        let turn = self.turn;
        self.find_all_of((1..bodies).map(move |k| 1 + (k + turn) % (bodies - 1)), scene, is_last);
    }

    /// Searches for some bodies, in the order of their candidates' support (ties: in the order
    /// passed). Bodies that were tried in vain in the last frame come last, so a look-alike cannot
    /// starve the others. Patches are registered once all candidates have been aligned.
    fn find_all_of(&mut self, order: impl Iterator<Item = usize>, scene: &mut Scene, is_last: bool) {
        let start = self.clock.start();
        let missing = order.filter(|&k| scene.verified[k].is_none());
        let mut found: Vec<(usize, Vec<Candidate>)> =
            missing.map(|k| (k, self.candidates(&mut scene.bodies[k], scene.frame.timestamp, is_last))).collect();
        found.sort_by_key(|(k, candidates)| {
            let support = candidates.iter().map(|candidate| candidate.inliers).max();
            (scene.bodies[*k].failed_last_time, std::cmp::Reverse(support))
        });
        self.spent.acquire_ms += start.elapsed_ms();
        let start = self.clock.start();
        for (k, candidates) in &mut found {
            candidates.truncate(TUNING.max_candidates_per_body.min(self.tries));
            scene.verified[*k] = self.align_best(*k, scene, candidates);
            // A body whose turn did not come was not tried in vain.
            scene.bodies[*k].failed_last_time = !candidates.is_empty() && scene.verified[*k].is_none();
        }
        self.spent.align_ms += start.elapsed_ms();
        for (k, candidates) in &found {
            if is_last && self.tries > 0 && scene.verified[*k].is_none() {
                scene.verified[*k] = self.find_by_patches(*k, scene, candidates);
            }
        }
    }

    /// Searches for the missing bodies at their predicted poses, by patches.
    fn find_by_prediction(&mut self, scene: &mut Scene) {
        for k in 0..scene.bodies.len() {
            if scene.verified[k].is_none() && self.tries > 0 {
                scene.verified[k] = self.find_by_patches(k, scene, &[]);
            }
        }
    }

    /// Runs a piece of acquisition and counts its time.
    fn timed(&mut self, work: impl FnOnce(&mut Self)) {
        let _span = debug_span!("detect").entered();
        let start = self.clock.start();
        work(self);
        self.spent.acquire_ms += start.elapsed_ms() + self.workers.take_extra_ms();
    }

    /// Returns the candidate poses that the frame's matches support.
    fn candidates(&self, tracked: &mut TrackedBody, timestamp: Timestamp, is_last: bool) -> Vec<Candidate> {
        let _span = debug_span!("acquire", body = %tracked.body.name).entered();
        let own = self.features.of_body(tracked.surfaces.clone(), &self.camera);
        // Once the stage is known, most searches are in vain and most bodies are seen small.
        // Drawing samples only from matches that agree locally, and none if not even a handful
        // agree, saves time.
        let agreeing = self.is_beside.then(|| agreeing_matches(&tracked.body, &own));
        let sampled = agreeing.as_ref().unwrap_or(&own);
        let (mut found, seen) = candidates(&tracked.body, &own, sampled, &self.camera, self.seed);
        // In a repetitive picture, a handful of wrong matches agree with each other.
        if is_last && !tracked.repeats() {
            if !sampled.is_empty() {
                add_candidates_of_few(&tracked.body, &own, &self.camera, &mut found);
            }
            if found.iter().all(|candidate| candidate.inliers < ACQUIRE_TUNING.well_supported_inliers) {
                let expected = expected_candidate(&tracked.body, &own, &self.camera, tracked.expected_poses(timestamp));
                expected.into_iter().for_each(|candidate| put_first(&mut found, candidate));
            }
        }
        if let Some(expected) = tracked.expected_poses(timestamp).last() {
            prefer_expected_tilt(&mut found, &expected);
        }
        tracked.recognition = seen;
        debug!(matches = own.len(), candidates = found.len(), inliers = found.first().map_or(0, |c| c.inliers));
        found
    }

    /// Returns the first candidate of a body that the picture confirms after alignment.
    fn align_best(&mut self, k: usize, scene: &mut Scene, candidates: &[Candidate]) -> Option<Verified> {
        // Once the stage is known, a body tried in vain in the last frame starts only from nearby
        // levels: starting further off takes more than half of the time, so the candidates take
        // turns at it.
        let is_retried = self.is_beside && scene.bodies[k].failed_last_time;
        let turn = self.turn;
        let has_turn =
            |number: usize| turn.is_multiple_of(2) && number % TUNING.max_attempts_when_known == turn / 2 % TUNING.max_attempts_when_known;
        scene.bodies[k].attempt.is_seen_in_part = false;
        let mut verified = None;
        for (number, candidate) in candidates.iter().enumerate() {
            verified = self.align_candidate(k, scene, candidate, is_retried && !has_turn(number));
            // The body is partly visible here; the other planar pose would not fit better.
            if verified.is_some() || scene.bodies[k].attempt.is_seen_in_part {
                break;
            }
        }
        verified
    }

    /// Aligns a candidate; `None` if the picture does not confirm the result or an alignment was
    /// already started there. `is_nearby_only`: see [`Start`].
    fn align_candidate(&mut self, k: usize, scene: &mut Scene, candidate: &Candidate, is_nearby_only: bool) -> Option<Verified> {
        let camera = scene.camera_motion(k);
        let tracked = &mut scene.bodies[k];
        let _span = debug_span!("align found", body = %tracked.body.name).entered();
        let start = candidate.pose.inverse();
        // A closer look repeats candidates that were already tried in vain.
        let is_new = !tracked.attempt.tried.iter().any(|tried| is_near(tried, &start));
        if !is_new || !candidate.off.iter().all(|sigma| sigma.is_finite()) {
            return None;
        }
        self.tries = self.tries.saturating_sub(1);
        tracked.attempt.tried.push(start);
        let off = first_off(self.longest_readout_s(), tracked.aligner.distance_m(&start), candidate.off);
        let expected = tracked.unseen(start, off, camera.as_ref());
        let start = Start { is_nearby_only, ..Start::found(&expected) };
        tracked.align_found(scene.frame, scene.levels, scene.rays, &start)
    }

    /// Returns the best pose that patches verify around the candidates, aligned if that succeeds.
    fn find_by_patches(&mut self, k: usize, scene: &mut Scene, found: &[Candidate]) -> Option<Verified> {
        let camera = scene.camera_motion(k);
        let tracked = &mut scene.bodies[k];
        let frame = scene.frame;
        let start = self.clock.start();
        let _span = debug_span!("align", body = %tracked.body.name).entered();
        let mut buffers = std::mem::take(&mut self.verify_buffers);
        let view = self.view(frame, tracked);
        // One check costs as much as following two more bodies, so once the stage is known only the
        // likeliest candidate is checked.
        let asked = match (self.is_beside, tracked.track.is_continued()) {
            (false, _) => found.len(),
            (true, false) => 1,
            (true, true) => 0,
        };
        let starts = found.iter().take(asked).map(|c| c.pose);
        let mut best = tracked.best_verified(starts, &view, &mut buffers);
        if best.is_none() && tracked.track.is_continued() {
            // Blur or a steep tilt leaves too few features; then the predicted pose is as good a
            // start.
            let predicted = tracked.predicted(frame.timestamp);
            best = tracked.best_verified(predicted.into_iter(), &view, &mut buffers);
        }
        // Once the stage is known there is no time to start twice from the same place.
        let is_new = |verified: &Verified| {
            !(self.is_beside
                && tracked.attempt.tried.iter().chain(&tracked.attempt.followed_from).any(|tried| is_near(tried, &verified.pose)))
        };
        let aligned = best.filter(is_new).and_then(|verified| {
            let distance = tracked.aligner.distance_m(&verified.pose);
            let first = tracked.unseen(verified.pose, first_off(self.longest_readout_s(), distance, [0.0; 2]), camera.as_ref());
            tracked.align(frame, scene.levels, scene.rays, &Start::found(&first))
        });
        self.verify_buffers = buffers;
        let has_asked = tracked.track.is_continued() || !found.is_empty();
        self.tries = self.tries.saturating_sub(usize::from(has_asked));
        self.spent.align_ms += start.elapsed_ms() + self.workers.take_extra_ms();
        // Patches of a repetitive picture also fit when displaced by one period.
        aligned.or(best.filter(|_| !tracked.repeats()))
    }

    /// Fills the half size of a frame.
    pub fn fill_half(&mut self, levels: &mut FrameLevels) {
        self.half.fill(levels);
    }

    /// Returns the frame as verification and study of a body need it, once its half size is filled.
    pub fn view<'a>(&'a self, frame: &'a Frame, tracked: &TrackedBody) -> View<'a> {
        View {
            full: self.full_view(frame, tracked),
            half: SearchPicture { image: &self.half.picture, scale: 2.0, mask: self.mask.as_ref() },
        }
    }

    /// Returns the frame at full size.
    fn full_view<'a>(&'a self, frame: &'a Frame, tracked: &TrackedBody) -> FullView<'a> {
        FullView {
            camera: &self.camera,
            picture: SearchPicture { image: &frame.image, scale: 1.0, mask: self.mask.as_ref() },
            row_motion: RowMotion {
                shutter: self.shutter,
                readout_sigma_s: self.readout_sigma_s,
                before: tracked.before_at(frame.timestamp),
            },
            workers: &self.workers,
        }
    }

    /// Returns the compute of the workers since the last call, milliseconds.
    pub fn take_extra_ms(&self) -> f64 {
        self.workers.take_extra_ms()
    }

    /// Searches a frame for a second copy of a body's picture: another pose that patches verify in
    /// the unexplained part of the frame. The copy may be seen smaller, and need not occlude the
    /// first.
    pub fn find_copy(&mut self, k: usize, scene: &mut Scene) -> Option<Verified> {
        let first = scene.verified[k]?;
        // In a repetitive picture one part looks like another.
        if scene.bodies[k].repeats() {
            return None;
        }
        let start = self.clock.start();
        let known = scene.bodies.iter().zip(&*scene.verified).filter_map(|(b, v)| v.as_ref().map(|v| (b.surfaces.start, &b.body, v.pose)));
        self.unexplained.look(known, scene.levels, scene.rays);
        if !self.unexplained.is_anything() {
            self.spent.acquire_ms += start.elapsed_ms();
            return None;
        }
        let image = &scene.frame.image;
        let open = self.unexplained.mask([image.width(), image.height()], self.mask.as_ref()).clone();
        self.features.look_for_copies(image, &open, &self.workers);
        let tracked = &scene.bodies[k];
        let own = self.features.of_body(tracked.surfaces.clone(), &self.camera);
        let (found, _) = candidates(&tracked.body, &own, &own, &self.camera, self.seed);
        self.spent.acquire_ms += start.elapsed_ms() + self.workers.take_extra_ms();
        let start = self.clock.start();
        self.half.fill(scene.levels);
        let mut buffers = std::mem::take(&mut self.verify_buffers);
        let view = self.view(scene.frame, tracked);
        let full = FullView {
            picture: SearchPicture { mask: Some(&open), ..view.full.picture },
            row_motion: RowMotion { before: None, ..view.full.row_motion },
            ..view.full
        };
        let view = View { full, half: SearchPicture { mask: Some(&open), ..view.half } };
        let copy = found.iter().take(TUNING.max_copy_candidates).find_map(|candidate| {
            let verified = verify(&tracked.body, &candidate.pose, &view, false, &mut buffers);
            debug!(body = %tracked.body.name, inliers = candidate.inliers, ?verified, "copy");
            verified.ok().filter(|_| tracked.is_elsewhere(&first, &buffers.anchors, &self.camera))
        });
        self.verify_buffers = buffers;
        self.spent.align_ms += start.elapsed_ms() + self.workers.take_extra_ms();
        copy
    }

    /// Aligns a body at a pose that patches verified, replacing the pose found first.
    pub fn align_copy(&mut self, k: usize, scene: &mut Scene, copy: &Verified) {
        let tracked = &mut scene.bodies[k];
        let distance_m = tracked.aligner.distance_m(&copy.pose);
        let expected = tracked.unseen(copy.pose, first_off(self.shutter.readout_s, distance_m, [0.0; 2]), None);
        scene.verified[k] = tracked.align_found(scene.frame, scene.levels, scene.rays, &Start::found(&expected));
    }

    /// Records for every body without a verified pose why it has none.
    fn give_reasons(&self, scene: &mut Scene) {
        let mut look = None;
        for (tracked, _) in scene.bodies.iter_mut().zip(&*scene.verified).filter(|(_, verified)| verified.is_none()) {
            let look = look.get_or_insert_with(|| FrameLook::at(&self.half.picture));
            let reason = Reason::of_failure(&tracked.recognition, tracked.attempt.refusal, look, self.camera.width());
            debug!(body = %tracked.body.name, ?reason, seen = ?tracked.recognition, refusal = ?tracked.attempt.refusal, ?look, "no pose");
            tracked.attempt.reason = Some(reason);
        }
    }

    /// Returns a body's surfaces that are recognised in a picture, without using any configured
    /// size.
    pub fn recognise(&mut self, image: &GrayImage, tracked: &TrackedBody) -> Vec<SurfaceView> {
        let own = self.matches_in(image, Look::Frontal, tracked);
        self.views(&own, tracked)
    }

    /// Returns the pose of a body estimated from features in a picture, and the matches that
    /// support it.
    pub fn recognised_pose(&mut self, image: &GrayImage, tracked: &TrackedBody) -> Option<(Pose<Body, Camera>, Vec<SurfaceMatch>)> {
        let own = self.matches_in(image, Look::Frontal, tracked);
        let pose = self.likeliest_pose(&own, tracked)?;
        Some((pose, self.views(&own, tracked).into_iter().flat_map(|view| view.matches).collect()))
    }

    /// Like [`recognised_pose`](Self::recognised_pose), but uses only the strongest features, in a
    /// fifth of the time. May return `None` where a closer look finds a pose.
    pub fn quickly_recognised_pose(&mut self, image: &GrayImage, tracked: &TrackedBody) -> Option<Pose<Body, Camera>> {
        let own = self.matches_in(image, Look::Quick, tracked);
        self.likeliest_pose(&own, tracked)
    }

    fn matches_in(&mut self, image: &GrayImage, look: Look, tracked: &TrackedBody) -> Vec<SurfaceMatch> {
        self.features.look(image, self.mask.as_ref(), look, &self.workers);
        self.features.of_body(tracked.surfaces.clone(), &self.camera)
    }

    fn likeliest_pose(&self, own: &[SurfaceMatch], tracked: &TrackedBody) -> Option<Pose<Body, Camera>> {
        let (found, _) = candidates(&tracked.body, own, own, &self.camera, self.seed);
        Some(found.first()?.pose.inverse())
    }

    fn views(&self, own: &[SurfaceMatch], tracked: &TrackedBody) -> Vec<SurfaceView> {
        (0..tracked.surfaces.len() as u32).filter_map(|k| surface_view(k, own, &self.camera, self.seed)).collect()
    }
}

/// Returns one sigma of a pose found by features: metres and radians. `noise`: the part due to the
/// matches' noise.
fn first_off(readout_s: f64, distance_m: f64, noise: [f64; 2]) -> [f64; 2] {
    let [shift, turn] = MotionEstimate::off_by_readout(readout_s, distance_m);
    [
        ACQUIRE_TUNING.feature_pose_shift_sigma * distance_m + shift + 2.0 * noise[0],
        ACQUIRE_TUNING.feature_pose_rotation_sigma + turn + 2.0 * noise[1],
    ]
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;

    fn levels(grey: u8) -> FrameLevels {
        let mut levels = FrameLevels::default();
        levels.update(&GrayImage::from_pixel(64, 48, Luma([grey])));
        levels
    }

    #[test]
    fn the_half_size_is_that_of_the_current_frame() {
        let mut half = HalfSize::default();
        half.begin_frame();
        half.fill(&mut levels(10));
        // Needed twice in a frame, it is copied once.
        half.fill(&mut levels(20));
        assert_eq!(half.picture, GrayImage::from_pixel(32, 24, Luma([10])));
        // A frame that does not need it leaves an old picture, which the next one replaces.
        half.begin_frame();
        half.begin_frame();
        half.fill(&mut levels(30));
        assert_eq!(half.picture, GrayImage::from_pixel(32, 24, Luma([30])));
    }
}
