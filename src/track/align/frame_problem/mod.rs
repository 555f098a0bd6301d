//! One frame of one body: from where the body is expected to where the frame shows it, coarse to fine.
//!
//! The pixels that the last frame was solved with are solved again where nothing moved; otherwise each level's pixels are selected, predicted and
//! solved for in turn, from the coarsest that the start's error asks for down to the finest. Nothing that is learnt slowly changes here.

mod blurred_body;
mod descent;
mod still_camera;

use nalgebra::{Vector2, Vector6};

use super::hypotheses::velocity_jump::{by_bend, by_start, is_unexpected, jumped};
use super::learned::clue::Clue;
use super::learned::exposure::{KnownPsfVariance, exposure_clue};
use super::learned::gradient_gain::ChangeSums;
use super::learned::light::RememberedLight;
use super::learned::slow_estimates::{Lessons, SlowEstimates};
use super::picture::surface::{AlignSurface, distance_m};
use super::pixels::level_spec::LevelSpec;
use super::pixels::level_spec::SHARP_FRAME_PX;
use super::pixels::selection::Selector;
use super::solve::jump_instant::{Expectation, RowBands};
use super::solve::level_problem::solution::Conclusion;
use super::solve::level_problem::{Corrected, Expected, LevelProblem};
use super::solve::shutter_clue::{ReadoutQuestion, ShutterClue};
use super::solve::system::schur_complement::SchurComplement;
use super::solve::verdict::{Alignment, squared_mahalanobis};
use crate::motion::{Continuation, Motion, MotionEstimate, MotionMatrix, UniformMotion};
use crate::track::frame::frame_levels::{FINEST, FrameLevels, LEVELS};
use crate::track::frame::rays::CameraRays;

/// One sigma about the slow estimate of the point spread's variance in such frames, and in others, where it must not pass for motion; in
/// the kernel's unit. The first is 0.04 pixels²: sharp clips had -0.03 to -0.01 in a prototype. Raised, the second lets motion pass for
/// point spread; lowered, the first takes up a change of focus more slowly.
const PSF_VARIANCE_SIGMA: f64 = 0.5;
const BLURRED_PSF_VARIANCE_SIGMA: f64 = 0.05;
/// Linearisations at most: of a level above the finest, and of that. Of 1390 alignments that succeeded, nine clips long, all but four needed three at most at the
/// finest, and one eight. Raised, frames that do not converge cost more; lowered, starts that are far off are given up.
const COARSE_ROUNDS: usize = 8;
const FINE_ROUNDS: usize = 10;
/// A level above the finest is left, and the finest, when a step moved no tile by more, pixels of the level. With 0.015 at the finest,
/// about as few frames are further off than six sigmas as with `MISSING_SHARE`. Raised, more of the last step is missing; lowered, frames
/// cost more rounds.
const COARSE_STEP_PX: f64 = 0.1;
const FINE_STEP_PX: f64 = 0.045;
/// A pose that still moves by more than this at the end is none, pixels of the level. Chosen well above `FINE_STEP_PX`. Raised, solutions
/// that creep along outside of their basin are given; lowered, good ones that settle slowly are not.
const MAX_LAST_STEP_PX: f64 = 0.15;
/// A level's steps are no longer than this once it had its first rounds, pixels of the level, or the pose wanders about and is none: of 1936 alignments that
/// succeeded two had a longer one there, of 475 that failed half. Raised, frames in which a start leads nowhere cost more; lowered, ones that settle slowly are
/// given up.
const MAX_SETTLED_STEP_PX: f64 = 1.0;
/// The same where the residuals are beyond `WANDERING_SCALE`, sigmas of noise: the picture shows something else there. Of 1118 alignments that succeeded none had
/// such a step, of 31 that failed 18. The same at the finest where little more than the half of a body fits that always takes part: 2 of 683 candidates had such a step there, neither led to a pose, and
/// one of them cost 10 ms. Raised, a start that leads nowhere costs two or three followed frames; lowered, see above.
const WANDERING_STEP_PX: f64 = 0.3;
const WANDERING_SCALE: f64 = 10.0;
/// After `HOPELESS_ROUNDS` at the finest, residuals larger than `HOPELESS_SCALE`, sigmas of noise, where no more than `HOPELESS_SHARE` of the tiles take part (half
/// always do, unless fewer fit well): the picture shows something else. Of 3091 alignments that led to a pose none had residuals above 2.9, of 175 that did not 43 had more than 6. The level above
/// the finest cannot tell: there, a followed stage with four fifths covered had 11.5, and at the finest 1.5. A body that was given before may be blurred instead, which leaves 6 to 9: it is asked for that
/// first. Raised, a start that leads nowhere costs as much as several followed frames;
/// `HOPELESS_SCALE` lowered, bodies that are half covered are lost.
const HOPELESS_ROUNDS: usize = 2;
const HOPELESS_SCALE: f64 = 6.0;
const HOPELESS_SHARE: f64 = 0.6;
/// The first rounds of a level, counted anew where its blur turns out to be longer. See above.
const SETTLING_ROUNDS: usize = 4;
/// Rounds at the finest level, at most, of a body that was just found, of which little more than the half fits that always takes part, and not well: of 108 alignments of objects that succeeded, seven clips long, three
/// took more, all of bodies that were less than half in view, and one of them as long as seven followed bodies. Raised, frames of covered bodies cost more; lowered, these are found later.
const POOR_ROUNDS: usize = 6;
/// The part of a frame's last step that may still be missing from its pose, one sigma: steps are too short where slopes are too steep, and the
/// pictures of the tiles were predicted before the step. Raised, covariances are wider than errors; with 0, twice as many frames
/// of a moving camera are further off than six sigmas.
const MISSING_SHARE: f64 = 0.2;
/// A level converges from this many of its pixels off: 2.5 to 5 in a prototype. Raised, starts are left to levels that are too fine for
/// them, and solved twice or lost; lowered, a level more is solved than the start needs.
const BASIN_PX: f64 = 2.5;
/// The finest level's pixels are chosen with the pose known to this, pixels of the level: seen from a pose that is off they lie beside
/// their edges, all on one side, where every error of the point spread pulls the same way. Lowered, they are chosen anew more often.
const CHOSEN_PX: f64 = 0.25;
/// A body is looked for from further off where its residuals are larger than this, sigmas, or the share of its tiles that take part is less
/// than `CLOSE_SHARE` of the last frame's. With residuals as large, its velocity may also have jumped. Chosen, not tuned. `CLOSE_SCALE`
/// lowered or `CLOSE_SHARE` raised, more frames are solved twice; the other way, minima nearby are taken for the pose.
const CLOSE_SCALE: f64 = 2.0;
const CLOSE_SHARE: f64 = 0.8;
/// Another way of enlarging the pictures is taken where it leaves less than this share of the misfit. Raised to 1, the way changes by chance; lowered,
/// the wrong way is kept where pictures have little fine detail.
const BETTER: f64 = 0.97;
/// Pixels of a trial of either way. Both see the same noise: where the one leaves 3 % less, the difference of their mean squares scatters by 0.6 % over so
/// many. Raised, the frame of a trial takes longer; lowered, the way changes by chance.
const TRIAL_PIXELS: usize = 3000;
/// Steps of a frame in which the velocity jumped, or is found by its blur, at most: what was found first may be pixels off. With 2, a start at 1 m/s was left a
/// millimetre from where the picture shows it. Raised, only frames that do not come to rest cost more.
const SETTLING_STEPS: usize = 8;
/// How likely a camera that left the line it went on was shaken rather than started or stopped, where rows tell the two apart. Chosen, not
/// tuned. Raised, starts and stops are explained by jerk more often, whose expectation is the wider one.
const JERK_LIKELIHOOD: f64 = 0.01;

/// Buffers of the hot path, kept from frame to frame.
#[derive(Debug, Default)]
pub struct Buffers {
    pub selector: Selector,
    pub coarse: LevelProblem,
    pub fine: LevelProblem,
    /// Whether the finest level holds the pixels of a still camera.
    pub has_kept: bool,
    /// Frames in a row in which nothing was expected to have moved.
    still_frames: u32,
    /// The light of the frame, and of a trial beside it.
    pub light: RememberedLight,
    trial_light: RememberedLight,
    readout_column: SchurComplement,
    /// How far off each tile of the finest level is shown, pixels of the level.
    pub shifts: Vec<Vector2<f64>>,
}

impl Buffers {
    /// With room for all that may be selected of the surfaces.
    pub fn with_room_for(surfaces: &[AlignSurface]) -> Self {
        Self { selector: Selector::with_room_for(surfaces), ..Self::default() }
    }

    /// The problem of a level, and what else is needed to work on it.
    fn at_level(&mut self, level: usize) -> (&mut LevelProblem, &mut Selector, &mut RememberedLight) {
        (if level == FINEST { &mut self.fine } else { &mut self.coarse }, &mut self.selector, &mut self.light)
    }
}

/// A frame at work.
pub struct FrameProblem<'a> {
    surfaces: &'a [AlignSurface],
    slow: &'a SlowEstimates,
    buffers: &'a mut Buffers,
    levels: &'a mut FrameLevels,
    rays: &'a CameraRays,
    expected: &'a MotionEstimate,
    known: Expected<'a>,
    /// Whether the body was seen just now.
    is_followed: bool,
    /// Whether its pose was given before: what differs from it is in front of it, wherever it is found.
    is_trusted: bool,
    /// See [`Aligner::begin_nearby`](super::aligner::Aligner::begin_nearby).
    pub begins_nearby: bool,
    /// What the tiles say by the time of their rows.
    bands: RowBands,
    /// The pose's part of the last step, from where the pictures of the tiles were predicted.
    last_step: Vector6<f64>,
    /// By how much the finest level's last step moved a tile at most, pixels of the level.
    last_moved_px: f64,
    /// The fit of the level above the finest; none where it was not solved.
    above: LevelFit,
    /// Whether the finest level's pose wandered about where little of the body fits: no way from further up finds it there.
    wanders: bool,
    /// See [`Alignment::has_opposite`].
    has_opposite: bool,
    lessons: Lessons,
}

/// How well a level fits.
#[derive(Clone, Copy)]
struct LevelFit {
    /// Residuals, sigmas of noise.
    scale: f64,
    /// Share of the tiles that take part.
    open_share: f64,
}

impl LevelFit {
    /// Of a level that was not solved.
    const NONE: Self = Self { scale: f64::INFINITY, open_share: 0.0 };
}

/// Where a level's last linearisation led.
struct Iterated {
    motion: Motion,
    /// `None` where it still moved.
    converged: Option<Corrected>,
}

impl<'a> FrameProblem<'a> {
    /// A frame as it is expected. `information`: inverse of the expectation's covariance.
    pub fn new(
        surfaces: &'a [AlignSurface],
        slow: &'a SlowEstimates,
        buffers: &'a mut Buffers,
        levels: &'a mut FrameLevels,
        rays: &'a CameraRays,
        expected: &'a MotionEstimate,
        information: &'a MotionMatrix,
    ) -> Self {
        buffers.light.clone_from(&slow.light);
        let (motion, psf_variance) = (&expected.motion, slow.psf_variance);
        let known = Expected { motion, information, psf_variance, psf_variance_sigma: PSF_VARIANCE_SIGMA, is_sure: false };
        let (bands, lessons) = (RowBands::new(slow.shutter), Lessons::none(slow));
        let mut frame = Self {
            surfaces,
            slow,
            buffers,
            levels,
            rays,
            expected,
            known,
            is_followed: false,
            is_trusted: false,
            begins_nearby: false,
            bands,
            last_step: Vector6::zeros(),
            last_moved_px: 0.0,
            above: LevelFit::NONE,
            wanders: false,
            has_opposite: false,
            lessons,
        };
        let spec = frame.spec(FINEST, motion);
        if spec.frame_px() * spec.blur_px > SHARP_FRAME_PX {
            frame.known.psf_variance_sigma = BLURRED_PSF_VARIANCE_SIGMA;
        }
        frame
    }

    /// Of a body that was seen just now, or not, and whether it is trusted (see [`Aligner::trust`](super::aligner::Aligner::trust)).
    pub fn follows(&mut self, is_followed: bool, is_trusted: bool) {
        (self.is_followed, self.known.is_sure, self.is_trusted) = (is_followed, is_followed, is_trusted);
    }

    fn spec(&self, level: usize, motion: &Motion) -> LevelSpec<'a> {
        let spec = LevelSpec::new(self.surfaces, self.slow, self.rays, self.lessons.is_enlarged, level, motion);
        // A start that features found may lead nowhere, and then as many pixels as these would be asked in vain, for as long as several frames take.
        LevelSpec { fills_up: level == FINEST && self.is_followed, ..spec }
    }

    /// Whether the body was given before, and was not seen just now.
    fn is_found_again(&self) -> bool {
        self.is_trusted && !self.is_followed
    }

    /// Finds the motion that the frame shows; `None` where too little of the body is in view or nothing converges.
    pub fn solve(&mut self) -> Option<Corrected> {
        self.same_again().or_else(|| self.coarse_to_fine())
    }

    /// Selects the pixels of a level; false where there are too few.
    fn lay_out(&mut self, spec: &LevelSpec, motion: &Motion) -> bool {
        let (problem, selector, light) = self.buffers.at_level(spec.level);
        problem.lay_out(spec, self.levels, motion, selector, light)
    }

    /// The finest level is left when a step moved no tile by more, pixels of the level. Where its blur is asked next, the pose settles after that.
    fn fine_step_px(&self) -> f64 {
        if self.may_ask_blur() { MAX_LAST_STEP_PX } else { FINE_STEP_PX }
    }

    /// Predicts and solves a level's pixels until a step is small. The finest level's are selected anew where the pose moved much.
    fn iterate(&mut self, spec: &LevelSpec, start: Motion, is_first: bool) -> Option<Iterated> {
        let is_finest = spec.level == FINEST;
        let (rounds, small_px) = if is_finest { (FINE_ROUNDS, self.fine_step_px()) } else { (COARSE_ROUNDS, COARSE_STEP_PX) };
        let (mut motion, mut chosen_at) = (start, start);
        let mut converged = None;
        // Whether these pixels were predicted before.
        let mut is_same = false;
        let mut changes = ChangeSums::default();
        let (mut blurred, mut settles_from) = (*spec, SETTLING_ROUNDS);
        for round in 0..rounds {
            let is_first = is_first && round == 0;
            // Rows tell how a body moves that was just found; until then its prediction has no blur.
            if !is_finest && self.may_ask_blur() {
                let longer = blurred.blurred_by(&motion);
                settles_from = if longer.places > blurred.places { round + SETTLING_ROUNDS } else { settles_from };
                blurred = longer;
            }
            let spec = &blurred;
            if is_finest && self.buffers.fine.moved_px(spec, &chosen_at, &motion) > CHOSEN_PX {
                (chosen_at, is_same) = (motion, false);
                if !self.lay_out(spec, &motion) {
                    return None;
                }
            }
            let (problem, _, light) = self.buffers.at_level(spec.level);
            if is_same && is_finest {
                changes.add(&problem.predict_again(spec, &motion));
            } else {
                problem.predict(spec, &motion);
            }
            is_same = true;
            if is_first {
                problem.guess_light(spec, self.slow.psf_variance);
            }
            let solved = problem.solve(spec, &self.known, light, is_first, if is_first { 3 } else { 2 })?;
            let moved = problem.moved_px(spec, &motion, &solved.motion);
            let open_share = problem.open_share();
            tracing::trace!(level = spec.level, moved, pixels = problem.pixels().len(), scale = solved.scale, open_share);
            (self.last_step, self.last_moved_px) = (motion.pose_error_to(&solved.motion), moved);
            motion = solved.motion;
            converged = Some(solved).filter(|_| moved < MAX_LAST_STEP_PX);
            let is_half_open = is_finest && open_share < HOPELESS_SHARE;
            // Where little more than the half fits that always takes part, and not well, it need not come to rest: tiles enter and leave by turns.
            let is_poor = is_half_open && !self.is_followed && round >= SETTLING_ROUNDS && solved.scale > CLOSE_SCALE;
            // A body that is covered settles once it is known what fits, and one that is blurred fits once its velocity is known.
            let is_covered = is_half_open && self.is_found_again() && solved.scale < CLOSE_SCALE;
            let is_hopeless = is_half_open && round + 1 >= HOPELESS_ROUNDS && solved.scale > HOPELESS_SCALE;
            let is_blurred = is_hopeless && solved.scale < WANDERING_SCALE && self.is_clearly_blurred(solved.scale);
            if moved < if is_poor || is_covered || is_blurred { MAX_LAST_STEP_PX } else { small_px } {
                break;
            }
            let longest_px = if is_poor || solved.scale > WANDERING_SCALE { WANDERING_STEP_PX } else { MAX_SETTLED_STEP_PX };
            if round >= settles_from && moved > longest_px || is_poor && round + 1 >= POOR_ROUNDS {
                self.wanders = is_poor;
                return None;
            }
            if is_hopeless && !is_blurred {
                return None;
            }
        }
        if is_finest {
            self.lessons.changes = changes;
        }
        Some(Iterated { motion, converged })
    }

    /// Between its pixels the picture may be as smooth as their enlargement has it, or as a straight line (a projector or a wall of LEDs
    /// that scales it, a print of just these pixels): the frame tells. From time to time both are tried, beside the solution, which stays
    /// as it is unless the other is clearly better.
    fn try_enlargement(&mut self, found: Corrected) -> Option<Corrected> {
        let has_copies = self.surfaces.iter().any(|s| s.texture.own_level() > 0);
        if !self.slow.is_trial_due() || !has_copies {
            return Some(found);
        }
        self.lessons.has_tried = true;
        let was = self.lessons.is_enlarged;
        let [misfit, other] = [was, !was].map(|is_enlarged| self.misfit_of_trial(is_enlarged, &found));
        self.lessons.is_enlarged = was;
        tracing::debug!(was, misfit, other, "enlargement");
        if other >= BETTER * misfit {
            return Some(found);
        }
        self.buffers.trial_light.clone_from(&self.buffers.light);
        self.lessons.is_enlarged = !was;
        self.solve_again(&found).or_else(|| {
            self.lessons.is_enlarged = was;
            self.buffers.light.clone_from(&self.buffers.trial_light);
            self.solve_again(&found)
        })
    }

    /// The misfit that the finest level leaves with the enlarged copies or without, solved aside; infinite where it cannot be solved.
    fn misfit_of_trial(&mut self, is_enlarged: bool, found: &Corrected) -> f64 {
        self.lessons.is_enlarged = is_enlarged;
        let spec = LevelSpec { count: TRIAL_PIXELS, ..self.spec(FINEST, &found.motion) };
        // The coarse levels are done with: their buffers are free.
        let Buffers { coarse: aside, selector, light, trial_light, .. } = &mut *self.buffers;
        trial_light.clone_from(light);
        if !aside.lay_out(&spec, self.levels, &found.motion, selector, trial_light) {
            return f64::INFINITY;
        }
        aside.predict(&spec, &found.motion);
        aside.solve(&spec, &self.known, trial_light, false, 2).and_then(|_| aside.solution()).map_or(f64::INFINITY, |mut s| s.misfit())
    }

    /// The finest level solved once more from where it was found.
    fn solve_again(&mut self, found: &Corrected) -> Option<Corrected> {
        let spec = self.spec(FINEST, &found.motion);
        let (fine, _, light) = self.buffers.at_level(FINEST);
        fine.recall_light(light);
        fine.predict(&spec, &found.motion);
        fine.solve(&spec, &self.known, light, false, 2)
    }

    /// Whether the velocity may have jumped. A small picture has few pixels: where they contradict the expectation, their residuals are large,
    /// and large residuals weigh little beside it: the pose stays where it was expected, and only the residuals tell.
    pub fn is_surprising(&self, found: &Corrected) -> bool {
        found.scale > CLOSE_SCALE || is_unexpected(squared_mahalanobis(self.expected, &found.motion))
    }

    /// Solves the finest level once more from where it was found, with a velocity that may have jumped since the last frame, `since_s` ago.
    pub fn solve_with_jump(&mut self, found: &Corrected, since_s: f64) -> Option<()> {
        let with_jump = jumped(self.expected, since_s, &self.slow.shutter, distance_m(self.surfaces, &self.expected.motion.pose));
        let information = with_jump.covariance.cholesky()?.inverse();
        let known = Expected { information: &information, ..self.known };
        self.settle(found.motion, &known)
    }

    /// Solves the finest level's pixels from a motion until a step is small.
    fn settle(&mut self, mut motion: Motion, known: &Expected) -> Option<()> {
        self.buffers.has_kept = false;
        for _ in 0..SETTLING_STEPS {
            let spec = self.spec(FINEST, &motion);
            let (fine, _, light) = self.buffers.at_level(FINEST);
            fine.predict(&spec, &motion);
            let solved = fine.solve(&spec, known, light, false, 2)?.motion;
            let moved = fine.moved_px(&spec, &motion, &solved);
            (self.last_step, self.last_moved_px) = (motion.pose_error_to(&solved), moved);
            motion = solved;
            if moved < FINE_STEP_PX {
                break;
            }
        }
        Some(())
    }

    /// Settles what [`Self::solve`] left unsettled for [`Self::solve_with_blur`], where that is not asked or shows no velocity. `None` where there is no solution any more.
    pub fn settle_rest(&mut self) -> Option<()> {
        if !self.may_ask_blur() || self.last_moved_px < FINE_STEP_PX {
            return Some(());
        }
        self.settle_found()
    }

    /// Settles the solution with what is known.
    fn settle_found(&mut self) -> Option<()> {
        let found = self.buffers.fine.solution()?.found.motion;
        let known = self.known;
        self.settle(found, &known)
    }

    /// Settles once more where much of a body is seen that was just found, but less than half of it: so far the better half of its tiles took part, and some of those show what
    /// covers it. `None` where it does not come to rest.
    pub fn settle_by_what_fits(&mut self) -> Option<Corrected> {
        self.known.is_sure = true;
        self.settle_found()?;
        self.buffers.fine.solution().map(|solution| solution.found).filter(|_| self.last_moved_px < MAX_LAST_STEP_PX)
    }

    /// Settles what [`Self::solve`] left unsettled of a body that seemed to be covered and is not; whether there was anything. `None` where there is no solution any more.
    pub fn settle_uncovered(&mut self) -> Option<bool> {
        let is_unsettled = self.is_found_again() && !self.may_ask_blur() && self.last_moved_px >= FINE_STEP_PX;
        if is_unsettled {
            self.settle_found()?;
        }
        Some(is_unsettled)
    }

    /// Whether what does not fit takes no part.
    pub fn is_by_what_fits(&self) -> bool {
        self.known.is_sure
    }

    /// Verifies the solution: how well its tiles agree, and what they leave open. With what the frame says of the exposure.
    pub fn verify(&mut self) -> Option<(Alignment, Option<Clue>)> {
        self.bands = RowBands::new(self.slow.shutter);
        let Corrected { motion, scale } = self.buffers.fine.solution()?.found;
        let spec = self.spec(FINEST, &motion);
        let mut solution = self.buffers.fine.solution()?;
        let blur_px = spec.blur_px * spec.frame_px();
        let Conclusion { estimate, covariance, inliers, squared_px, tiles, agreeing, blur } = solution.conclude(&spec, &mut self.bands)?;
        let gradients = solution.gradient_agreement(self.levels.level(FINEST));
        let found = Alignment {
            estimate,
            pose: motion.pose,
            covariance: covariance + self.last_step * self.last_step.transpose() * MISSING_SHARE.powi(2),
            scale,
            inliers,
            rms_px: (squared_px / inliers.max(1.0)).sqrt() * spec.frame_px(),
            tiles,
            agreeing,
            gradients,
            squared_mahalanobis: squared_mahalanobis(self.expected, &motion),
            has_opposite: self.has_opposite,
        };
        let psf_variance = self.buffers.light.psf_variance();
        if blur_px < SHARP_FRAME_PX {
            self.lessons.psf_variance = Some(psf_variance);
            self.lessons.noise = found.is_conclusive().then(|| solution.noise_sums());
        }
        let known = KnownPsfVariance { error: self.slow.psf_variance - psf_variance, sigma: BLURRED_PSF_VARIANCE_SIGMA };
        let exposure = exposure_clue(&blur, known, blur_px);
        self.lessons.exposure = exposure.map(|clue| (clue, blur_px));
        Some((found, exposure))
    }

    /// Adds what the solution leaves open where the velocity may have jumped since the last frame, `since_s` ago, or within this one; corrects pose
    /// and motion by the jumps that the rows show. `has_jumped`: whether it was solved with a wider expectation.
    pub fn allow_for_jumps(&mut self, found: &mut Alignment, since_s: Option<f64>, has_jumped: bool) {
        let shutter = &self.slow.shutter;
        let Some(since_s) = since_s else {
            self.lessons.line = Some(UniformMotion::new(found.pose));
            found.covariance += by_start(&found.estimate, shutter);
            return;
        };
        let Alignment { estimate, pose, covariance, .. } = found;
        let distance_m = distance_m(self.surfaces, pose);
        let mut line = self.slow.line;
        let led = line.as_mut().filter(|_| since_s > 0.0).and_then(|line| line.add(pose, covariance, since_s, distance_m));
        self.lessons.line = Some(line.unwrap_or(UniformMotion::new(*pose)));
        *covariance += by_bend(self.expected, estimate, led.as_ref(), shutter, distance_m);
        let with_jerk = Expectation {
            information: *self.known.information,
            error: estimate.motion.error_to(self.known.motion),
            likelihood: JERK_LIKELIHOOD,
            // Solved with a wider expectation, the motion is less sure than with this one.
            covariance: (!has_jumped).then_some(estimate.covariance),
        };
        let on_line = led.filter(|led| led.has_left && !shutter.is_global()).and_then(|Continuation { expected, .. }| {
            Some(Expectation {
                information: expected.covariance.cholesky()?.inverse(),
                error: estimate.motion.error_to(&expected.motion),
                likelihood: 1.0 - JERK_LIKELIHOOD,
                covariance: None,
            })
        });
        if let Some(mixture) = self.bands.mixture([Some(with_jerk), on_line], since_s, distance_m) {
            *pose = estimate.motion.with_pose_corrected(&mixture.pose);
            *covariance += mixture.pose_covariance;
            *estimate = MotionEstimate { motion: estimate.motion.corrected(&mixture.motion), covariance: mixture.motion_covariance };
        }
    }

    /// What the frame says of the shutter, beside what it says of the exposure.
    pub fn shutter_clue(&mut self, question: &ReadoutQuestion, exposure: Option<Clue>) -> Option<ShutterClue> {
        let motion = self.buffers.fine.solution()?.found.motion;
        let spec = self.spec(FINEST, &motion);
        let Buffers { fine, readout_column, .. } = &mut *self.buffers;
        let speed_px_s = spec.speed_px_s(&motion);
        if speed_px_s < question.min_speed_px_s {
            return None;
        }
        let pull = self.known.information * question.expected_by_readout;
        let readout = fine.solution()?.readout_clue(&spec, &pull, readout_column);
        Some(ShutterClue { readout, speed_px_s, exposure, is_open: question.is_open, may_teach: self.is_followed && question.may_teach })
    }

    /// What the frame would teach.
    pub fn into_lessons(self) -> Lessons {
        self.lessons
    }

    /// How far off the start may be in the frame, two sigmas, pixels.
    fn uncertain_px(&self) -> f64 {
        let focal = self.rays.camera().intrinsics().fx;
        let c = &self.expected.covariance;
        let sigma = |k: usize| (c[(k, k)] + c[(k + 1, k + 1)] + c[(k + 2, k + 2)]).max(0.0).sqrt();
        2.0 * focal * (sigma(3).min(1.0) + sigma(0) / distance_m(self.surfaces, &self.expected.motion.pose))
    }
}

/// The finest level whose basin holds a start this many pixels of the frame off; the coarsest if none does.
fn level_for(off_px: f64) -> usize {
    if off_px < CHOSEN_PX * f64::from(1u32 << FINEST) {
        return FINEST;
    }
    (FINEST + 1..LEVELS).find(|l| BASIN_PX * f64::from(1u32 << l) > off_px).unwrap_or(LEVELS - 1)
}
