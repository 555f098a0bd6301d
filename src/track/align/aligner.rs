//! Coarse to fine: from where a body is expected to where the frame shows it.

use nalgebra::{Matrix2, Vector2, Vector6};

use super::evidence::RunEvidence;
use super::exposure::{KnownPsfVariance, USUAL_EXPOSURE_S, UnknownExposure, exposure_clue};
use super::frame_levels::{FrameLevels, LEVELS};
use super::gradient_gain::{ChangeSums, GradientGain};
use super::jump_instant::{Expectation, RowBands};
use super::level_problem::used_pixels::UsedPixel;
use super::level_problem::{Corrected, Expected, LevelProblem};
use super::level_spec::{LevelSpec, SlowStates};
use super::light::RememberedLight;
use super::motion::{Motion, MotionEstimate, MotionMatrix};
use super::noise::{CameraNoise, NoiseSums};
use super::selection::{Chosen, Selector};
use super::shutter_clue::{ClueKeeper, ShutterClue};
use super::system::schur_complement::Clue;
use super::tile_grid::MOST_TILES;
use super::uniform_motion::UniformMotion;
use super::velocity_jump::{by_bend, by_start, is_unexpected, jumped};
use super::verdict::{Alignment, agreement, squared_mahalanobis};
use super::{AlignSurface, CameraRays, Sensor};
use crate::geometry::{Body, Camera, Pose};
use crate::track::reference::PreparedBody;

/// A patch of the reference and where the frame shows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// Surface index in the body.
    pub surface: u32,
    /// Its middle on the surface, metres from the centre (x right, y up).
    pub on_surface_m: Vector2<f64>,
    /// How far from where the pose puts it the frame shows it, pixels of the frame.
    pub shift_px: Vector2<f64>,
    /// Information of the shift, pixels^-2.
    pub information: Matrix2<f64>,
    /// Tile, for grouping.
    pub tile: u32,
}

/// Pixels asked at each level, from full size down, of a frame 1280 pixels wide; wider ones are asked more.
const PIXELS: [usize; LEVELS] = [10_000, 10_000, 4000, 1500, 500];
const USUAL_WIDTH_PX: f64 = 1280.0;
/// Samples across a pixel of the levels above the finest, and of that.
const COARSE_SIDE: usize = 3;
const SIDE: usize = 5;
/// Pixels asked while nothing moves: their prediction is kept from frame to frame.
const STILL_PIXELS: usize = 130_000;
/// The point spread is one slow state, learnt from frames with less motion blur than this (pixels of the frame), by this share of
/// what each says; one sigma about it in such frames, and in others, where it must not pass for motion. In the kernel's unit.
const SHARP_FRAME_PX: f64 = 1.0;
const PSF_VARIANCE_SHARE: f64 = 0.2;
const PSF_VARIANCE_SIGMA: f64 = 0.5;
const BLURRED_PSF_VARIANCE_SIGMA: f64 = 0.05;
/// Linearisations of a level at most: of the levels above the finest, and of that.
const COARSE_ROUNDS: usize = 8;
const FINE_ROUNDS: usize = 16;
/// A level is left when a step moved no tile by more, pixels of the level.
const COARSE_STEP_PX: f64 = 0.1;
const FINE_STEP_PX: f64 = 0.045;
/// A pose that still moves by more than this at the end is none, pixels of the level.
const LARGEST_LAST_STEP_PX: f64 = 0.15;
/// The part of a frame's last step that may still be missing from its pose, one sigma: steps are too short where slopes are too steep, and the
/// pictures of the tiles were predicted before the step. Raised, covariances are wider than errors; with 0, twice as many frames
/// of a moving camera are further off than six sigmas.
const MISSING_SHARE: f64 = 0.2;
/// Patches are sampled again, shifted, while their mean shift exceeds this, pixels of the level; and how often at most.
const SMALL_SHIFT_PX: f64 = 0.05;
const PATCH_ROUNDS: usize = 3;
/// Fewest fitting pixels of a patch.
const LEAST_PATCH_PIXELS: f64 = 12.0;
/// The level that alignment ends at.
const FINEST: usize = 1;
/// A level converges from this many of its pixels off.
const BASIN_PX: f64 = 2.5;
/// The finest level's pixels are chosen with the pose known to this, pixels of the level: seen from a pose that is off they lie beside
/// their edges, all on one side, where every error of the point spread pulls the same way.
const CHOSEN_PX: f64 = 0.25;
/// Search radius = `LATELY_OFF` x a decaying maximum of the start error, px. The maximum keeps this share a frame: raised, the search stays wide
/// longer after a jump, and costs a level more.
const LATELY_OFF: f64 = 2.0;
const OFF_FADES: f64 = 0.8;
/// The decaying maximum of the start error at first, pixels of the frame.
const FIRST_OFF_PX: f64 = 40.0;
/// A body that was aligned from nearby is looked for from further off where its residuals are larger than this, sigmas, or fewer of its
/// tiles take part than this share of what did in the last frame. With residuals as large, its velocity may also have jumped.
const CLOSE_SCALE: f64 = 2.0;
const CLOSE_SHARE: f64 = 0.8;
/// Frames between trials of how the picture was enlarged, and before the first; the other way is taken where it leaves less than this share
/// of the misfit.
const TRIAL_FRAMES: u32 = 32;
const FIRST_TRIAL: u32 = 3;
const BETTER: f64 = 0.97;
/// Steps of a frame in which the velocity jumped, at most: what was found first may be pixels off. With 2, a start at 1 m/s was left a
/// millimetre from where the picture shows it.
const JUMP_ROUNDS: usize = 8;
/// How likely a camera that left the line it went on was shaken rather than started or stopped, where rows tell the two apart.
const JERK_LIKELIHOOD: f64 = 0.01;
/// A prediction is kept for the next frame while nothing moved by more, pixels of the level.
const KEPT_PX: f64 = 0.05;

/// What a frame would teach the slow estimates. They learn it when its pose is accepted ([`Aligner::learn`]): a frame that shows something
/// else says nothing of the camera or the light.
#[derive(Debug, Default)]
struct Lessons {
    /// What the last descent's steps changed in the prediction, and what they should have changed.
    changes: ChangeSums,
    /// Variance of the point spread function; `None` where the frame is blurred.
    psf_variance: Option<f64>,
    /// What the blur says of an unknown exposure, and its length in pixels of the frame.
    exposure: Option<(Clue, f64)>,
    /// Squared residuals, where the frame is sharp and leaves no doubt.
    noise: Option<NoiseSums>,
    /// How far off the start was, pixels of the frame, and the share of the tiles that took part; `None` where nothing moved.
    start: Option<(f64, f64)>,
    /// The line of the last poses, with this one.
    line: Option<UniformMotion>,
    /// Whether it was tried how the pictures were enlarged.
    has_tried: bool,
}

/// Aligns one body; owns all buffers of its hot path and the slow states (light, point spread, and those of [`SlowStates`]).
#[derive(Debug)]
pub struct Aligner {
    surfaces: Vec<AlignSurface>,
    slow: SlowStates,
    /// Follows an unknown exposure; `None` where it is known.
    exposure: Option<UnknownExposure>,
    light: RememberedLight,
    /// What it was before an attempt that may be given up, and after the last accepted frame.
    light_before: RememberedLight,
    accepted_light: RememberedLight,
    /// What the last frame would teach.
    lessons: Lessons,
    /// Slow average of the point spread.
    psf_variance: f64,
    selector: Selector,
    chosen: Vec<Chosen>,
    coarse: LevelProblem,
    fine: LevelProblem,
    /// Whether the finest level holds the pixels of a still camera.
    has_kept: bool,
    /// The line that the last accepted poses lie on.
    line: Option<UniformMotion>,
    /// Of the pose, since the frame was last predicted; zero where the prediction of the frame before was kept.
    last_step: Vector6<f64>,
    /// Decaying maximum of the start error, pixels of the frame.
    off_px: f64,
    /// Share of the tiles that took part in the last frame.
    open_share: f64,
    /// Whether the enlarged copies of the pictures are used, after the last accepted frame.
    is_enlarged: bool,
    /// How many accepted frames ago it was tried whether the enlarged copies of the pictures are what the frame shows.
    untried: u32,
    /// How far off each run of the finest level is shown, pixels of the level.
    shifts: Vec<Vector2<f64>>,
    /// Where the shutter is asked about.
    clues: Option<ClueKeeper>,
}

impl Aligner {
    /// Prepares a body's pictures.
    pub fn new(body: &PreparedBody, sensor: Sensor) -> Self {
        let is_known = sensor.exposure_s > 0.0;
        let sensor = Sensor { exposure_s: if is_known { sensor.exposure_s } else { USUAL_EXPOSURE_S }, ..sensor };
        let surfaces: Vec<AlignSurface> = body.surfaces.iter().map(|s| AlignSurface::new(&s.spec)).collect();
        Self {
            exposure: (!is_known).then(UnknownExposure::default),
            selector: Selector::with_room_for(&surfaces),
            surfaces,
            slow: SlowStates { sensor, noise: CameraNoise::usual(FINEST), is_enlarged: true, gradient_gain: GradientGain::default() },
            light: RememberedLight::default(),
            light_before: RememberedLight::default(),
            accepted_light: RememberedLight::default(),
            lessons: Lessons::default(),
            psf_variance: 0.0,
            chosen: Vec::new(),
            coarse: LevelProblem::default(),
            fine: LevelProblem::default(),
            has_kept: false,
            line: None,
            last_step: Vector6::zeros(),
            off_px: FIRST_OFF_PX,
            open_share: 0.0,
            is_enlarged: true,
            untried: TRIAL_FRAMES - FIRST_TRIAL,
            shifts: Vec::new(),
            clues: None,
        }
    }

    /// Most patches that a frame can show: one a tile of each surface.
    pub fn most_patches(&self) -> usize {
        self.surfaces.len() * MOST_TILES[0] * MOST_TILES[1]
    }

    /// From now on every frame is asked what it says of the shutter, which is taken as given here.
    pub fn ask_shutter(&mut self, sensor: Sensor) {
        self.exposure = None;
        self.slow.sensor = sensor;
        self.clues = Some(ClueKeeper::default());
    }

    /// What the last frame said of the shutter; `None` where it is not asked, or was not aligned.
    pub fn shutter_clue(&self) -> Option<ShutterClue> {
        self.clues.as_ref()?.clue
    }

    /// Adds the pixels that the last frame's pose rests on. Before [`Aligner::patches`], which looks elsewhere.
    pub fn used_pixels(&self, rays: &CameraRays, out: &mut Vec<UsedPixel>) {
        let Some(solved) = self.fine.solved() else { return };
        let spec = spec(&self.surfaces, &self.slow, rays, FINEST, &solved.motion);
        self.fine.used_pixels(&spec, out);
    }

    /// Aligns a frame from an expected motion; `None` where too little of the body is in view or nothing converges. Who accepts the pose says
    /// so with [`Aligner::learn`]; otherwise the next frame finds all slow estimates as they were.
    ///
    /// `since_s`: seconds since the last frame, if the body is followed; its velocity may have jumped meanwhile.
    pub fn align(
        &mut self,
        frame: &mut FrameLevels,
        rays: &CameraRays,
        expected: &MotionEstimate,
        since_s: Option<f64>,
    ) -> Option<Alignment> {
        if let Some(clues) = &mut self.clues {
            clues.clue = None;
        }
        // A velocity that may jump within the frame explains what a wrong readout leaves, and the shutter would be found there.
        let since_s = since_s.filter(|_| self.clues.is_none());
        let line = self.line.filter(|_| since_s.is_some());
        self.light.clone_from(&self.accepted_light);
        self.slow.is_enlarged = self.is_enlarged;
        self.lessons = Lessons::default();
        let information = expected.covariance.cholesky()?.inverse();
        let blur_px = f64::from(1u32 << FINEST) * spec(&self.surfaces, &self.slow, rays, FINEST, &expected.motion).blur_px;
        let psf_variance_sigma = if blur_px > SHARP_FRAME_PX { BLURRED_PSF_VARIANCE_SIGMA } else { PSF_VARIANCE_SIGMA };
        let known = Expected { motion: &expected.motion, information: &information, psf_variance: self.psf_variance, psf_variance_sigma };
        self.last_step = Vector6::zeros();
        let found = match self.same_again(frame, rays, &known) {
            Some(found) => found,
            None => self.settle(frame, rays, &known, expected)?,
        };
        // A small picture has few pixels. Where they contradict the expectation, their residuals are large, and large residuals weigh little
        // beside it: the pose stays where it was expected, and only the residuals tell.
        let is_held_back = found.scale > CLOSE_SCALE;
        let jumped_since_s = since_s.filter(|_| is_held_back || is_unexpected(squared_mahalanobis(expected, &found.motion)));
        if let Some(since_s) = jumped_since_s {
            let with_jump = jumped(expected, since_s, &self.slow.sensor, self.distance(&expected.motion.pose));
            self.solve_with_jump(rays, &known, &with_jump, &found)?;
        }
        self.conclude(rays, expected, &information, since_s, jumped_since_s.is_some(), line)
    }

    /// Solves the finest level once more from where it was found, with a velocity that may have jumped.
    fn solve_with_jump(&mut self, rays: &CameraRays, known: &Expected, with_jump: &MotionEstimate, found: &Corrected) -> Option<()> {
        let information = with_jump.covariance.cholesky()?.inverse();
        let known = Expected { information: &information, ..*known };
        self.has_kept = false;
        let mut motion = found.motion;
        for _ in 0..JUMP_ROUNDS {
            let spec = spec(&self.surfaces, &self.slow, rays, FINEST, &motion);
            self.fine.predict(&spec, &motion);
            let solved = self.fine.solve(&spec, &known, &mut self.light, false, 2)?.motion;
            let moved = self.fine.moved_px(&spec, &motion, &solved);
            self.last_step = motion.pose_error_to(&solved);
            motion = solved;
            if moved < FINE_STEP_PX {
                break;
            }
        }
        Some(())
    }

    /// The frame may show what the last one did: then the prediction still holds, and it pays to ask more pixels.
    fn same_again(&mut self, frame: &mut FrameLevels, rays: &CameraRays, known: &Expected) -> Option<Corrected> {
        let noise = self.slow.noise.of_still();
        let spec = LevelSpec { count: STILL_PIXELS, is_dense: true, noise, ..spec(&self.surfaces, &self.slow, rays, FINEST, known.motion) };
        if self.fine.moved_since(&spec, known.motion) > KEPT_PX {
            self.has_kept = false;
            return None;
        }
        if self.has_kept {
            self.fine.renew(&spec, frame);
            // Not that of a frame whose pose was not accepted.
            self.fine.recall_light(&self.light);
        } else if self.fine.lay_out(&spec, frame, known.motion, &mut self.selector, &mut self.chosen, &self.light) {
            self.fine.predict(&spec, known.motion);
            self.has_kept = true;
        } else {
            return None;
        }
        let solved = self.fine.solve(&spec, known, &mut self.light, false, 2)?;
        (self.fine.moved_px(&spec, known.motion, &solved.motion) < 2.0 * KEPT_PX).then_some(solved)
    }

    /// The patches of the last frame that fit, one a tile: where each is on its surface, and how far off the frame shows it.
    pub fn patches(&mut self, rays: &CameraRays, motion: &Motion, patches: &mut Vec<Patch>) {
        let spec = spec(&self.surfaces, &self.slow, rays, FINEST, motion);
        self.shifts.clear();
        self.shifts.extend(self.fine.runs().iter().map(|r| patch_shift(&r.evidence).map_or(Vector2::zeros(), |(shift, _)| shift)));
        // One linear step is right for small shifts. Where the calibration or the survey is off, patches must be followed.
        for _ in 0..PATCH_ROUNDS {
            let mean = self.shifts.iter().map(|s| s.norm()).sum::<f64>() / self.shifts.len().max(1) as f64;
            if mean < SMALL_SHIFT_PX {
                break;
            }
            self.has_kept = false;
            self.fine.sample_shifted(&spec, motion, &self.shifts);
            for (shift, r) in self.shifts.iter_mut().zip(self.fine.runs()) {
                let more = patch_shift(&r.evidence).map_or(Vector2::zeros(), |(more, _)| more);
                *shift += more * (1.0 / more.norm().max(1.0));
            }
        }
        patches.clear();
        let scale = f64::from(1u32 << FINEST);
        for (r, shift) in self.fine.runs().iter().zip(&self.shifts) {
            let Some((_, structure)) = patch_shift(&r.evidence) else { continue };
            let surface = &self.surfaces[r.run.surface as usize];
            let Some(on_surface_m) = self.fine.middle_on_surface(r, surface, motion) else { continue };
            patches.push(Patch {
                surface: r.run.surface,
                on_surface_m,
                shift_px: shift * scale,
                information: structure / (scale * scale),
                tile: r.run.tile,
            });
        }
    }

    /// Aligns from the level whose basin holds what starts were off by lately; where that is not clearly right, from the one that holds
    /// all that is uncertain.
    fn settle(&mut self, frame: &mut FrameLevels, rays: &CameraRays, known: &Expected, expected: &MotionEstimate) -> Option<Corrected> {
        let far = level_for(self.uncertain_px(rays, expected)).max(FINEST + 1);
        let near = level_for(LATELY_OFF * self.off_px).min(far);
        self.light_before.clone_from(&self.light);
        let found = self.descend(frame, rays, known, near);
        let is_close = found.is_some_and(|f| f.scale < CLOSE_SCALE) && self.fine.open_share() > CLOSE_SHARE * self.open_share;
        let found = if is_close || near == far {
            found
        } else {
            self.light.clone_from(&self.light_before);
            self.descend(frame, rays, known, far)
        }?;
        let spec = spec(&self.surfaces, &self.slow, rays, FINEST, &found.motion);
        let off_px = spec.moved_px(known.motion, &found.motion) * f64::from(1u32 << FINEST);
        self.lessons.start = Some((off_px, self.fine.open_share()));
        self.tried(frame, rays, known, found)
    }

    /// Between its pixels the picture may be as smooth as their enlargement has it, or as a straight line (a projector or a wall of LEDs
    /// that scales it, a print of just these pixels): the frame tells. From time to time both are tried, beside the solution, which stays
    /// as it is unless the other is clearly better.
    fn tried(&mut self, frame: &mut FrameLevels, rays: &CameraRays, known: &Expected, found: Corrected) -> Option<Corrected> {
        let has_copies = self.surfaces.iter().any(|s| s.texture.own_level() > 0);
        if self.untried + 1 < TRIAL_FRAMES || !has_copies {
            return Some(found);
        }
        self.lessons.has_tried = true;
        self.light_before.clone_from(&self.light);
        let was = self.slow.is_enlarged;
        let [misfit, other] = [was, !was].map(|is_enlarged| self.misfit_of_trial(is_enlarged, frame, rays, known, &found));
        self.slow.is_enlarged = was;
        self.light.clone_from(&self.light_before);
        tracing::debug!(was, misfit, other, "enlargement");
        if other >= BETTER * misfit {
            return Some(found);
        }
        self.slow.is_enlarged = !was;
        self.solved_again(rays, known, &found).or_else(|| {
            self.slow.is_enlarged = was;
            self.light.clone_from(&self.light_before);
            self.solved_again(rays, known, &found)
        })
    }

    /// The misfit that the finest level leaves with the enlarged copies or without, solved aside; infinite where it cannot be solved.
    fn misfit_of_trial(
        &mut self,
        is_enlarged: bool,
        frame: &mut FrameLevels,
        rays: &CameraRays,
        known: &Expected,
        found: &Corrected,
    ) -> f64 {
        self.slow.is_enlarged = is_enlarged;
        self.light.clone_from(&self.light_before);
        let spec = spec(&self.surfaces, &self.slow, rays, FINEST, &found.motion);
        // The coarse levels are done with: their buffers are free.
        let aside = &mut self.coarse;
        if !aside.lay_out(&spec, frame, &found.motion, &mut self.selector, &mut self.chosen, &self.light) {
            return f64::INFINITY;
        }
        aside.predict(&spec, &found.motion);
        aside.solve(&spec, known, &mut self.light, false, 2).map_or(f64::INFINITY, |_| aside.misfit())
    }

    /// The finest level solved once more from where it was found.
    fn solved_again(&mut self, rays: &CameraRays, known: &Expected, found: &Corrected) -> Option<Corrected> {
        let spec = spec(&self.surfaces, &self.slow, rays, FINEST, &found.motion);
        self.fine.recall_light(&self.light);
        self.fine.predict(&spec, &found.motion);
        self.fine.solve(&spec, known, &mut self.light, false, 2)
    }

    /// From coarse to fine.
    fn descend(&mut self, frame: &mut FrameLevels, rays: &CameraRays, known: &Expected, from: usize) -> Option<Corrected> {
        self.has_kept = false;
        let mut motion = *known.motion;
        let mut is_first = true;
        for l in (FINEST..=from).rev() {
            let is_finest = l == FINEST;
            let spec = spec(&self.surfaces, &self.slow, rays, l, &motion);
            let work = if is_finest { &mut self.fine } else { &mut self.coarse };
            if !work.lay_out(&spec, frame, &motion, &mut self.selector, &mut self.chosen, &self.light) {
                continue;
            }
            let (rounds, small_px) = if is_finest { (FINE_ROUNDS, FINE_STEP_PX) } else { (COARSE_ROUNDS, COARSE_STEP_PX) };
            let mut last = None;
            let mut chosen_at = motion;
            let mut is_same = false;
            let mut shown = ChangeSums::default();
            for _ in 0..rounds {
                if is_finest && work.moved_px(&spec, &chosen_at, &motion) > CHOSEN_PX {
                    chosen_at = motion;
                    is_same = false;
                    if !work.lay_out(&spec, frame, &motion, &mut self.selector, &mut self.chosen, &self.light) {
                        return None;
                    }
                }
                if is_same && is_finest {
                    shown.add(&work.predict_again(&spec, &motion));
                } else {
                    work.predict(&spec, &motion);
                }
                is_same = true;
                if is_first {
                    work.guess_light(&spec, self.psf_variance);
                }
                let passes = if is_first { 3 } else { 2 };
                let solved = work.solve(&spec, known, &mut self.light, is_first, passes)?;
                is_first = false;
                let moved = work.moved_px(&spec, &motion, &solved.motion);
                self.last_step = motion.pose_error_to(&solved.motion);
                tracing::trace!(level = l, moved, pixels = work.pixels().len(), scale = solved.scale, open = work.open_share());
                motion = solved.motion;
                last = Some(solved).filter(|_| moved < LARGEST_LAST_STEP_PX);
                if moved < small_px {
                    break;
                }
            }
            if is_finest {
                self.lessons.changes = shown;
                return last;
            }
        }
        None
    }

    /// How far off the start may be in the frame, two sigmas, pixels.
    fn uncertain_px(&self, rays: &CameraRays, expected: &MotionEstimate) -> f64 {
        let focal = rays.camera.intrinsics().fx;
        let distance = self.distance(&expected.motion.pose);
        let c = &expected.covariance;
        let sigma = |k: usize| (c[(k, k)] + c[(k + 1, k + 1)] + c[(k + 2, k + 2)]).max(0.0).sqrt();
        2.0 * focal * (sigma(3).min(1.0) + sigma(0) / distance)
    }

    /// Distance to the nearest surface's centre, metres.
    pub fn distance(&self, pose: &Pose<Body, Camera>) -> f64 {
        self.surfaces.iter().map(|s| (s.centre - pose.translation).norm()).fold(f64::INFINITY, f64::min).max(1e-3)
    }

    /// Covariance and evidence at the solution. `information`: of what was expected; `has_jumped`: whether it was solved with a wider
    /// expectation; `line`: that the poses before it lie on.
    fn conclude(
        &mut self,
        rays: &CameraRays,
        expected: &MotionEstimate,
        information: &MotionMatrix,
        since_s: Option<f64>,
        has_jumped: bool,
        mut line: Option<UniformMotion>,
    ) -> Option<Alignment> {
        let solved = self.fine.solved()?;
        let spec = spec(&self.surfaces, &self.slow, rays, FINEST, &solved.motion);
        let blur_px = spec.blur_px * f64::from(1u32 << FINEST);
        let mut bands = RowBands::new(self.slow.sensor);
        let (mut estimate, mut covariance) = self.fine.conclude(&spec, &mut bands)?;
        covariance += self.last_step * self.last_step.transpose() * MISSING_SHARE.powi(2);
        let (sensor, distance_m) = (&self.slow.sensor, self.distance(&solved.motion.pose));
        let mut pose = estimate.motion.pose;
        let left = since_s.filter(|dt_s| *dt_s > 0.0).and_then(|dt_s| line.as_mut()?.add(&pose, &covariance, dt_s, distance_m));
        self.lessons.line = Some(line.unwrap_or(UniformMotion::new(pose)));
        if let Some(since_s) = since_s {
            covariance += by_bend(expected, &estimate, left.as_ref(), sensor, distance_m);
            let expectations = [
                Some(Expectation {
                    information: *information,
                    error: estimate.motion.error_to(&expected.motion),
                    likelihood: JERK_LIKELIHOOD,
                    // Solved with a wider expectation, the motion is less sure than with this one.
                    covariance: (!has_jumped).then_some(estimate.covariance),
                }),
                left.filter(|_| sensor.readout_s != 0.0).and_then(|left| {
                    Some(Expectation {
                        information: left.covariance.cholesky()?.inverse(),
                        error: estimate.motion.error_to(&left.motion),
                        likelihood: 1.0 - JERK_LIKELIHOOD,
                        covariance: None,
                    })
                }),
            ];
            if let Some(mixture) = bands.mixture(expectations, since_s, distance_m) {
                pose = estimate.motion.with_pose_corrected(&mixture.pose);
                covariance += mixture.pose_covariance;
                estimate.motion = estimate.motion.corrected(&mixture.motion);
                estimate.covariance = mixture.motion_covariance;
            }
        } else {
            covariance += by_start(&estimate, sensor);
        }
        if blur_px < SHARP_FRAME_PX {
            self.lessons.psf_variance = Some(self.light.psf_variance());
        }
        let psf_variance = KnownPsfVariance { error: self.psf_variance - self.light.psf_variance(), sigma: BLURRED_PSF_VARIANCE_SIGMA };
        let exposure = exposure_clue(self.fine.runs().iter().map(|r| &r.evidence), psf_variance, blur_px);
        if let Some(clues) = &mut self.clues {
            let readout = self.fine.readout_clue(&spec, &mut clues.column);
            clues.clue = readout.map(|readout| ShutterClue { readout, exposure });
        }
        self.lessons.exposure = exposure.map(|clue| (clue, blur_px));
        let sum = |f: fn(&RunEvidence) -> f64| self.fine.runs().iter().map(|r| f(&r.evidence)).sum::<f64>();
        let inliers = sum(|e| e.inliers);
        let verdicts = self.fine.runs().iter().filter_map(|r| agreement(&r.evidence));
        let found = Alignment {
            estimate,
            pose,
            covariance,
            scale: solved.scale,
            inliers,
            rms_px: (sum(|e| e.squared_px) / inliers.max(1.0)).sqrt() * f64::from(1u32 << FINEST),
            tiles: verdicts.clone().count(),
            agreeing: verdicts.filter(|v| *v).count(),
            squared_mahalanobis: squared_mahalanobis(expected, &solved.motion),
        };
        if blur_px < SHARP_FRAME_PX && found.is_conclusive() {
            self.lessons.noise = Some(self.fine.noise_sums(found.scale));
        }
        Some(found)
    }

    /// The last frame's pose was accepted: the slow estimates learn what it taught, once.
    pub fn learn(&mut self) {
        let Lessons { changes, psf_variance, exposure, noise, start, line, has_tried } = std::mem::take(&mut self.lessons);
        self.accepted_light.clone_from(&self.light);
        self.line = line;
        self.is_enlarged = self.slow.is_enlarged;
        self.slow.gradient_gain.learn(&changes);
        if let Some(shown) = psf_variance {
            self.psf_variance += PSF_VARIANCE_SHARE * (shown - self.psf_variance);
        }
        if let (Some(unknown), Some((clue, blur_px))) = (&mut self.exposure, exposure) {
            unknown.learn(&mut self.slow.sensor, clue, blur_px);
        }
        if let Some(sums) = noise {
            self.slow.noise.learn(&sums);
        }
        if let Some((off_px, open_share)) = start {
            (self.off_px, self.open_share) = (off_px.max(OFF_FADES * self.off_px), open_share);
            self.untried = if has_tried { 0 } else { self.untried + 1 };
        }
    }
}

/// The finest level whose basin holds a start this many pixels of the frame off; the coarsest if none does.
fn level_for(off_px: f64) -> usize {
    if off_px < CHOSEN_PX * f64::from(1u32 << FINEST) {
        return FINEST;
    }
    (FINEST + 1..LEVELS).find(|l| BASIN_PX * f64::from(1u32 << l) > off_px).unwrap_or(LEVELS - 1)
}

/// What a level has to do at a motion.
fn spec<'a>(surfaces: &'a [AlignSurface], slow: &'a SlowStates, rays: &'a CameraRays, level: usize, motion: &Motion) -> LevelSpec<'a> {
    let SlowStates { sensor, noise, is_enlarged, gradient_gain } = slow;
    let wider = (f64::from(rays.camera.width()) / USUAL_WIDTH_PX).max(1.0);
    let count = (PIXELS[level] as f64 * wider) as usize;
    let side = if level == FINEST { SIDE } else { COARSE_SIDE };
    let noise = noise.at(level);
    let gradient_gain = gradient_gain.get() as f32;
    let mut spec = LevelSpec {
        surfaces,
        rays,
        sensor,
        level,
        noise,
        count,
        is_dense: false,
        blur_px: 0.0,
        side,
        is_enlarged: *is_enlarged,
        gradient_gain,
    };
    let half = 0.5 * sensor.exposure_s;
    spec.blur_px = spec.moved_px(&motion.after(-half), &motion.after(half));
    spec
}

/// How far off the frame shows a tile (pixels of the level), and the information of that; `None` where too little of it fits or its
/// detail runs one way only.
fn patch_shift(e: &RunEvidence) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let [aa, ab, bb, ra, rb] = e.shift;
    if e.inliers < LEAST_PATCH_PIXELS || 2.0 * e.inliers < e.count || aa * bb - ab * ab < 0.02 * (aa + bb).powi(2) {
        return None;
    }
    let structure = Matrix2::new(aa, ab, ab, bb);
    // Predicted grey at u shows what the frame has at u + shift: the residual is -gradient times shift.
    Some((-(structure.try_inverse()? * Vector2::new(ra, rb)), structure))
}

#[cfg(test)]
#[path = "aligner_tests.rs"]
mod tests;
