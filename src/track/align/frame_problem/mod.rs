//! Solves one frame for one body: from the predicted motion to the motion that the frame shows,
//! coarse to fine.
//!
//! If nothing moved, the pixels of the last frame are solved again (`still_camera`). Otherwise each
//! level's pixels are selected, predicted and solved for in turn (`descent`), from the coarsest
//! level that the start error requires down to the finest. [`FrameProblem::solve`] runs first. Then
//! velocity jumps and motion blur are tried where the result calls for them (`blurred_body` for
//! bodies that were just found), and [`FrameProblem::verify`] judges the result. The slow estimates
//! do not change here; what a frame would teach them is in its `Updates`.

mod blurred_body;
mod descent;
mod level_minimisation;
mod still_camera;

use crate::track::align::tuning::TUNING;
use nalgebra::{Vector2, Vector6};

use super::hypotheses::velocity_jump::{by_bend, by_start, is_unexpected, jumped};
use super::learned::camera_curve::LearntCurve;
use super::learned::clue::Clue;
use super::learned::exposure::{KnownPsfVariance, exposure_clue};
use super::learned::light::RememberedLight;
use super::learned::online_calibration::{OnlineCalibration, Updates};
use super::picture::surface::{AlignSurface, distance_m};
use super::pixels::level_spec::LevelSpec;
use super::pixels::selection::Selector;
use super::request::{AlignRequest, Start};
use super::solve::jump_instant::{MotionPrior, RowBands};
use super::solve::level_problem::solution::Conclusion;
use super::solve::level_problem::{Corrected, LevelPrior, LevelProblem};
use super::solve::minimiser::{End, Minimum, minimise};
use super::solve::shutter_clue::{ReadoutQuestion, ShutterClue};
use super::solve::system::schur_complement::SchurComplement;
use super::solve::verdict::{Alignment, squared_mahalanobis};
use crate::motion::{Continuation, Motion, MotionEstimate, MotionMatrix, UniformMotion};
use crate::track::frame::frame_levels::{FINEST, FrameLevels, LEVELS};
use crate::track::frame::rays::CameraRays;
use level_minimisation::{LevelMinimisation, Use};

/// Buffers of the hot path, kept from frame to frame.
#[derive(Debug, Default)]
pub struct Buffers {
    /// Selects the pixels of a level.
    pub selector: Selector,
    /// The levels above the finest, one after the other.
    pub coarse: LevelProblem,
    /// The finest level.
    pub fine: LevelProblem,
    /// Whether the finest level holds the pixels of a still camera.
    pub has_kept: bool,
    /// Consecutive frames in which no motion was predicted.
    still_frames: u32,
    /// The light of the frame, and of a trial beside it.
    pub light: RememberedLight,
    trial_light: RememberedLight,
    readout_column: SchurComplement,
    /// Displacement of each tile at the finest level, pixels of the level.
    pub shifts: Vec<Vector2<f64>>,
}

impl Buffers {
    /// Allocates room for all pixels that may be selected on the surfaces.
    pub fn with_room_for(surfaces: &[AlignSurface]) -> Self {
        Self { selector: Selector::with_room_for(surfaces), ..Self::default() }
    }

    /// Returns a level's problem, with the selector and the light needed to work on it.
    fn at_level(&mut self, level: usize) -> (&mut LevelProblem, &mut Selector, &mut RememberedLight) {
        (if level == FINEST { &mut self.fine } else { &mut self.coarse }, &mut self.selector, &mut self.light)
    }
}

/// A frame being solved for one body.
pub struct FrameProblem<'a> {
    surfaces: &'a [AlignSurface],
    slow: &'a OnlineCalibration,
    buffers: &'a mut Buffers,
    levels: &'a mut FrameLevels,
    rays: &'a CameraRays,
    expected: &'a MotionEstimate,
    known: LevelPrior<'a>,
    /// Whether the body was seen in the frame before.
    is_followed: bool,
    /// Whether a pose of it was reported before. Then whatever differs from the body is in front of
    /// it, wherever it is found.
    was_reported: bool,
    /// See [`Start::is_nearby_only`].
    is_nearby_only: bool,
    /// The tiles' equations, gathered by the exposure times of their rows.
    bands: RowBands,
    progress: Progress,
    /// Whether the finest level's pose wandered where little of the body fits; then a coarser start
    /// does not find it either.
    wanders: bool,
    /// See [`Alignment::has_opposite`].
    has_opposite: bool,
    /// The expected motion, with its information, once blur has shown a velocity.
    by_blur: Option<(Motion, MotionMatrix)>,
    updates: Updates,
}

/// How far the solution has come. A descent that leads to the same solution as an earlier one
/// restores the earlier one's.
#[derive(Clone, Copy)]
struct Progress {
    /// The pose part of the last step, from where the tiles were predicted.
    last_step: Vector6<f64>,
    /// The maximum movement of a tile in the finest level's last step, pixels of the level.
    last_moved_px: f64,
    /// The fit of the level above the finest, where it was solved.
    above: Option<LevelFit>,
}

/// How well a level fits.
#[derive(Clone, Copy)]
struct LevelFit {
    /// Robust standard deviation of the residuals, sigmas of noise.
    residual_sigma: f64,
    /// Ratio of tiles that take part.
    inlier_tile_ratio: f64,
}

/// Result of a level's last linearisation.
struct Iterated {
    motion: Motion,
    /// The solution; `None` if the last step was still long.
    converged: Option<Corrected>,
}

impl<'a> FrameProblem<'a> {
    /// Prepares a frame for solving. `information`: inverse covariance of the predicted motion.
    pub fn new(
        surfaces: &'a [AlignSurface],
        slow: &'a OnlineCalibration,
        buffers: &'a mut Buffers,
        levels: &'a mut FrameLevels,
        rays: &'a CameraRays,
        request: &AlignRequest<'a>,
        information: &'a MotionMatrix,
    ) -> Self {
        buffers.light.clone_from(&slow.light);
        let AlignRequest { start: Start { expected, since_s, is_nearby_only }, was_reported, .. } = *request;
        let (motion, psf_variance, is_followed) = (&expected.motion, slow.psf_variance, since_s.is_some());
        let known = LevelPrior { motion, information, psf_variance, psf_variance_sigma: TUNING.psf_variance_sigma, is_sure: is_followed };
        let (bands, updates) = (RowBands::new(slow.shutter), Updates::none(slow));
        let mut frame = Self {
            surfaces,
            slow,
            buffers,
            levels,
            rays,
            expected,
            known,
            is_followed,
            was_reported,
            is_nearby_only,
            bands,
            progress: Progress { last_step: Vector6::zeros(), last_moved_px: 0.0, above: None },
            wanders: false,
            has_opposite: false,
            by_blur: None,
            updates,
        };
        let spec = frame.spec(FINEST, motion);
        if spec.frame_px() * spec.blur_px > TUNING.max_sharp_blur_px {
            frame.known.psf_variance_sigma = TUNING.blurred_psf_variance_sigma;
        }
        frame
    }

    fn spec(&self, level: usize, motion: &Motion) -> LevelSpec<'a> {
        let spec = LevelSpec::new(self.surfaces, self.slow, self.rays, self.updates.is_enlarged, level, motion);
        // A start found by features may lead nowhere. Filling up the pixels would then take as long
        // as several frames, in vain.
        LevelSpec { fills_up: level == FINEST && self.is_followed, ..spec }
    }

    /// Whether the body was reported before but not seen in the frame before.
    fn is_found_again(&self) -> bool {
        self.was_reported && !self.is_followed
    }

    /// Finds the motion that the frame shows. `None` where too little of the body is in view or
    /// nothing converges.
    pub fn solve(&mut self) -> Option<Corrected> {
        self.same_again().or_else(|| self.coarse_to_fine())
    }

    /// Selects the pixels of a level; false if there are too few.
    fn lay_out(&mut self, spec: &LevelSpec, motion: &Motion) -> bool {
        let (problem, selector, light) = self.buffers.at_level(spec.level);
        problem.lay_out(spec, self.levels, motion, selector, light)
    }

    /// Returns the step below which the finest level has converged, pixels of the level. It is
    /// larger where the blur is estimated next, as the pose settles after that.
    fn fine_step_px(&self) -> f64 {
        if self.may_ask_blur() { TUNING.max_last_step_px } else { TUNING.fine_converged_px }
    }

    /// Predicts and solves a level's pixels until a step is small. At the finest level it selects
    /// them anew where the pose moved much. `None` where there are too few pixels, the system is
    /// singular, or the level is given up.
    fn iterate(&mut self, spec: &LevelSpec<'a>, start: Motion, is_first: bool) -> Option<Iterated> {
        let max_rounds = if spec.level == FINEST { TUNING.max_fine_rounds } else { TUNING.max_coarse_rounds };
        let prior = self.known;
        let mut level = LevelMinimisation::new(self, *spec, prior, Use::Descent, start, is_first);
        let Minimum { state: motion, end } = minimise(&mut level, start, max_rounds);
        let converged = level.finish_descent();
        matches!(end, End::Converged | End::OutOfRounds).then_some(Iterated { motion, converged })
    }

    /// Between its pixels the picture may be smooth, as the enlarged copies have it, or linear (a
    /// projector or LED wall that scales it, a print of exactly these pixels). The frame shows
    /// which. From time to time both are tried beside the solution, which is kept unless the other
    /// is clearly better.
    fn try_enlargement(&mut self, found: Corrected) -> Option<Corrected> {
        let has_copies = self.surfaces.iter().any(|s| s.texture.own_level() > 0);
        if !self.slow.is_trial_due() || !has_copies {
            return Some(found);
        }
        self.updates.has_tried = true;
        let was = self.updates.is_enlarged;
        let [misfit, other] = [was, !was].map(|is_enlarged| self.misfit_of_trial(is_enlarged, &found));
        self.updates.is_enlarged = was;
        tracing::debug!(was, misfit, other, "enlargement");
        if other >= TUNING.max_enlargement_misfit_ratio * misfit {
            return Some(found);
        }
        self.buffers.trial_light.clone_from(&self.buffers.light);
        self.updates.is_enlarged = !was;
        self.solve_again(&found).or_else(|| {
            self.updates.is_enlarged = was;
            self.buffers.light.clone_from(&self.buffers.trial_light);
            self.solve_again(&found)
        })
    }

    /// Returns the finest level's misfit with or without the enlarged copies, solved in separate
    /// buffers; infinite where it cannot be solved.
    fn misfit_of_trial(&mut self, is_enlarged: bool, found: &Corrected) -> f64 {
        self.updates.is_enlarged = is_enlarged;
        let spec = LevelSpec { count: TUNING.enlargement_trial_pixels, ..self.spec(FINEST, &found.motion) };
        // The coarse levels are finished, so their buffers are free.
        let Buffers { coarse: aside, selector, light, trial_light, .. } = &mut *self.buffers;
        trial_light.clone_from(light);
        if !aside.lay_out(&spec, self.levels, &found.motion, selector, trial_light) {
            return f64::INFINITY;
        }
        aside.predict(&spec, &found.motion);
        aside.solve(&spec, &self.known, trial_light, false, 2).and_then(|_| aside.solution()).map_or(f64::INFINITY, |mut s| s.misfit())
    }

    /// Solves the finest level once more from the solution.
    fn solve_again(&mut self, found: &Corrected) -> Option<Corrected> {
        let spec = self.spec(FINEST, &found.motion);
        let (fine, _, light) = self.buffers.at_level(FINEST);
        fine.recall_light(light);
        fine.predict(&spec, &found.motion);
        fine.solve(&spec, &self.known, light, false, 2)
    }

    /// Whether the velocity may have jumped. A small picture has few pixels. Where they contradict
    /// the prediction, their residuals are large and weigh little beside the prior: the pose stays
    /// where it was predicted, and only the residuals show the jump.
    pub fn is_surprising(&self, found: &Corrected) -> bool {
        found.residual_sigma > TUNING.clear_fit_sigma || is_unexpected(squared_mahalanobis(self.expected, &found.motion))
    }

    /// Solves the finest level once more from the solution, with a prior whose velocity may have
    /// jumped since the last frame, `since_s` seconds ago. `None` if that fails.
    pub fn solve_with_jump(&mut self, found: &Corrected, since_s: f64) -> Option<()> {
        let with_jump = jumped(self.expected, since_s, &self.slow.shutter, distance_m(self.surfaces, &self.expected.motion.pose));
        let information = with_jump.covariance.cholesky()?.inverse();
        let known = LevelPrior { information: &information, ..self.known };
        self.settle(found.motion, &known)
    }

    /// Solves the finest level's pixels from a motion until a step is small.
    fn settle(&mut self, motion: Motion, known: &LevelPrior) -> Option<()> {
        self.buffers.has_kept = false;
        let spec = self.spec(FINEST, &motion);
        let mut level = LevelMinimisation::new(self, spec, *known, Use::Settling, motion, false);
        let Minimum { end, .. } = minimise(&mut level, motion, TUNING.max_settling_steps);
        matches!(end, End::Converged | End::OutOfRounds).then_some(())
    }

    /// Finishes the iterations that [`Self::solve`] left to [`Self::solve_with_blur`], where that
    /// was not tried or showed no velocity. `None` if no solution remains.
    pub fn settle_rest(&mut self) -> Option<()> {
        if !self.may_ask_blur() || self.progress.last_moved_px < TUNING.fine_converged_px {
            return Some(());
        }
        self.settle_found()
    }

    /// Continues from the solution to convergence, with the usual prior.
    fn settle_found(&mut self) -> Option<()> {
        let found = self.buffers.fine.solution()?.found.motion;
        let known = self.known;
        self.settle(found, &known)
    }

    /// Solves again with only the tiles that fit, for a newly found body of which much is visible,
    /// but less than half. Until then the better half of its tiles took part, and some of those
    /// show what occludes it. `None` if it does not converge.
    pub fn settle_by_what_fits(&mut self) -> Option<Corrected> {
        self.known.is_sure = true;
        self.settle_found()?;
        self.buffers.fine.solution().map(|solution| solution.found).filter(|_| self.progress.last_moved_px < TUNING.max_last_step_px)
    }

    /// Finishes the iterations that [`Self::solve`] skipped because the body looked occluded;
    /// returns whether any ran. `None` if no solution remains.
    pub fn settle_uncovered(&mut self) -> Option<bool> {
        let is_unsettled = self.is_found_again() && !self.may_ask_blur() && self.progress.last_moved_px >= TUNING.fine_converged_px;
        if is_unsettled {
            self.settle_found()?;
        }
        Some(is_unsettled)
    }

    /// Whether tiles that do not fit are excluded even where they are the majority.
    pub fn is_by_what_fits(&self) -> bool {
        self.known.is_sure
    }

    /// Verifies the solution: how well its tiles agree, and its covariance. Returns it with the
    /// frame's clue on the exposure. `None` where there is no solution or the covariance is
    /// singular.
    pub fn verify(&mut self) -> Option<(Alignment, Option<Clue>)> {
        self.bands = RowBands::new(self.slow.shutter);
        let Corrected { motion, residual_sigma, .. } = self.buffers.fine.solution()?.found;
        let spec = self.spec(FINEST, &motion);
        let mut solution = self.buffers.fine.solution()?;
        let blur_px = spec.blur_px * spec.frame_px();
        let Conclusion { estimate, covariance, inliers, squared_px, tiles, agreeing, blur } = solution.conclude(&spec, &mut self.bands)?;
        let gradients = solution.gradient_agreement(self.levels.light(FINEST));
        let found = Alignment {
            estimate,
            pose: motion.pose,
            covariance: covariance + self.progress.last_step * self.progress.last_step.transpose() * TUNING.missing_step_ratio.powi(2),
            residual_sigma,
            inliers,
            rms_px: (squared_px / inliers.max(1.0)).sqrt() * spec.frame_px(),
            tiles,
            agreeing,
            gradients,
            squared_mahalanobis: squared_mahalanobis(self.expected, &motion),
            has_opposite: self.has_opposite,
        };
        let psf_variance = self.buffers.light.psf_variance();
        if blur_px < TUNING.max_sharp_blur_px {
            self.updates.psf_variance = Some(psf_variance);
            self.updates.noise = found.is_conclusive().then(|| solution.noise_sums());
            let is_asked = found.is_conclusive() && self.slow.curve.as_ref().is_some_and(LearntCurve::is_due);
            self.updates.curve = is_asked.then(|| solution.curve_sums(self.levels.curve()));
        }
        let known = KnownPsfVariance { error: self.slow.psf_variance - psf_variance, sigma: TUNING.blurred_psf_variance_sigma };
        let exposure = exposure_clue(&blur, known, blur_px);
        self.updates.exposure = exposure.map(|clue| (clue, blur_px));
        Some((found, exposure))
    }

    /// Adds the uncertainty from velocity jumps since the last frame, `since_s` seconds ago, or
    /// within this one, and corrects pose and motion by the jumps that the rows show. `has_jumped`:
    /// whether the frame was solved with the wider prior.
    pub fn allow_for_jumps(&mut self, found: &mut Alignment, since_s: Option<f64>, has_jumped: bool) {
        let shutter = &self.slow.shutter;
        let Some(since_s) = since_s else {
            self.updates.line = Some(UniformMotion::new(found.pose));
            return self.allow_for_jump_within_first(found);
        };
        let Alignment { estimate, pose, covariance, .. } = found;
        let distance_m = distance_m(self.surfaces, pose);
        let mut line = self.slow.line;
        let led = line.as_mut().filter(|_| since_s > 0.0).and_then(|line| line.add(pose, covariance, since_s, distance_m));
        self.updates.line = Some(line.unwrap_or(UniformMotion::new(*pose)));
        *covariance += by_bend(self.expected, estimate, led.as_ref(), shutter, distance_m);
        let with_jerk = MotionPrior {
            information: *self.known.information,
            error: estimate.motion.error_to(self.known.motion),
            likelihood: TUNING.jerk_probability,
            // A frame solved with the wider prior has a covariance that does not belong to this
            // one.
            covariance: (!has_jumped).then_some(estimate.covariance),
        };
        let on_line = led.filter(|led| led.has_left && !shutter.is_global()).and_then(|Continuation { expected, .. }| {
            Some(MotionPrior {
                information: expected.covariance.cholesky()?.inverse(),
                error: estimate.motion.error_to(&expected.motion),
                likelihood: 1.0 - TUNING.jerk_probability,
                covariance: None,
            })
        });
        if let Some(mixture) = self.bands.mixture([Some(with_jerk), on_line], since_s, distance_m) {
            found.take_mixture(&mixture);
        }
    }

    /// Adds the uncertainty from a velocity jump within the first frame of a body, and corrects the
    /// pose by one that the rows of a rolling shutter show. A followed body comes here while the
    /// readout time is in question; a jump would absorb the effect of a wrong one.
    fn allow_for_jump_within_first(&self, found: &mut Alignment) {
        let shutter = &self.slow.shutter;
        found.covariance += by_start(&found.estimate, shutter);
        if shutter.is_global() || self.is_followed {
            return;
        }
        let (expected, information) = self.by_blur.unwrap_or((*self.known.motion, *self.known.information));
        let prior = MotionPrior {
            information,
            error: found.estimate.motion.error_to(&expected),
            likelihood: 1.0,
            covariance: Some(found.estimate.covariance),
        };
        if let Some(mixture) = self.bands.mixture([Some(prior), None], 0.0, distance_m(self.surfaces, &found.pose)) {
            found.take_mixture(&mixture);
        }
    }

    /// Returns the frame's clues on the shutter, with the clue on the exposure passed through.
    /// `None` where there is no solution or the picture moves too slowly.
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

    /// Returns what the slow estimates would learn from the frame.
    pub fn into_updates(self) -> Updates {
        self.updates
    }

    /// Returns the uncertainty of the start in the frame: two sigma, pixels.
    fn uncertain_px(&self) -> f64 {
        let focal = self.rays.camera().intrinsics().fx;
        let c = &self.expected.covariance;
        let sigma = |k: usize| (c[(k, k)] + c[(k + 1, k + 1)] + c[(k + 2, k + 2)]).max(0.0).sqrt();
        2.0 * focal * (sigma(3).min(1.0) + sigma(0) / distance_m(self.surfaces, &self.expected.motion.pose))
    }
}

/// Returns the finest level whose basin holds a start error of `off_px` frame pixels; the coarsest
/// if none does.
fn level_for(off_px: f64) -> usize {
    if off_px < TUNING.reselection_px * f64::from(1u32 << FINEST) {
        return FINEST;
    }
    (FINEST + 1..LEVELS).find(|l| TUNING.basin_px * f64::from(1u32 << l) > off_px).unwrap_or(LEVELS - 1)
}
