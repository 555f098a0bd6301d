//! One frame for one body: what the hypotheses solve, and how.
//!
//! A descent selects, predicts and solves each level's pixels in turn, from the coarsest level that
//! the start error requires down to the finest (`descent`). [`FrameProblem::settle`] continues from
//! a solution with another prior. [`FrameProblem::verified`] says how well the current solution
//! agrees with the frame. The slow estimates do not change here; what a frame would teach them is
//! in its `Updates`.

mod blur_doubt;
mod descent;
mod level_minimisation;

use crate::track::align::tuning::TUNING;
use nalgebra::{Vector2, Vector6};

use super::learned::camera_curve::LearntCurve;
use super::learned::clue::Clue;
use super::learned::exposure::{KnownPsfVariance, exposure_clue};
use super::learned::light::RememberedLight;
use super::learned::online_calibration::{OnlineCalibration, Updates};
use super::picture::surface::{AlignSurface, distance_m};
use super::pixels::level_spec::LevelSpec;
use super::pixels::selection::Selector;
use super::request::{AlignRequest, Start};
use super::solve::jump_instant::RowBands;
use super::solve::level_problem::solution::Conclusion;
use super::solve::level_problem::{Corrected, LevelPrior, LevelProblem};
use super::solve::minimiser::{End, Minimum, minimise};
use super::solve::shutter_clue::{ReadoutQuestion, ShutterClue};
use super::solve::system::schur_complement::SchurComplement;
use super::solve::verdict::{Alignment, squared_mahalanobis};
use crate::motion::{Motion, MotionEstimate, MotionMatrix};
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
    pub still_frames: u32,
    /// The light of the frame, and of a trial beside it.
    pub light: RememberedLight,
    /// See `light`.
    pub trial_light: RememberedLight,
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
    pub fn at_level(&mut self, level: usize) -> (&mut LevelProblem, &mut Selector, &mut RememberedLight) {
        (if level == FINEST { &mut self.fine } else { &mut self.coarse }, &mut self.selector, &mut self.light)
    }
}

/// A frame being solved for one body.
pub struct FrameProblem<'a> {
    pub(super) surfaces: &'a [AlignSurface],
    pub(super) slow: &'a OnlineCalibration,
    pub(super) buffers: &'a mut Buffers,
    pub(super) levels: &'a mut FrameLevels,
    rays: &'a CameraRays,
    /// The predicted motion.
    pub(super) expected: &'a MotionEstimate,
    /// The prior of a descent.
    pub(super) known: LevelPrior<'a>,
    /// Whether the body was seen in the frame before.
    pub(super) is_followed: bool,
    /// Seconds since the last frame in which the velocity may have jumped; `None` for a body that
    /// was just found, and while the readout time is in question: a jump would absorb the effect of
    /// a wrong one, and the readout would seem confirmed.
    pub(super) since_s: Option<f64>,
    /// Whether the readout time is in question.
    pub(super) is_readout_open: bool,
    /// Whether a pose of it was reported before. Then whatever differs from the body is in front of
    /// it, wherever it is found.
    pub(super) was_reported: bool,
    /// See [`Start::is_nearby_only`].
    is_nearby_only: bool,
    /// The tiles' equations, gathered by the exposure times of their rows.
    pub(super) bands: RowBands,
    pub(super) progress: Progress,
    /// Whether the finest level's pose wandered where little of the body fits; then a coarser start
    /// does not find it either.
    wanders: bool,
    /// See [`Alignment::has_opposite`].
    pub(super) has_opposite: bool,
    /// Whether the frame was solved with a prior whose velocity may have jumped.
    pub(super) has_jumped: bool,
    /// The expected motion, with its information, once blur has shown a velocity.
    pub(super) by_blur: Option<(Motion, MotionMatrix)>,
    /// The verdict on the current solution, with the frame's clue on the exposure.
    verified: Option<(Alignment, Option<Clue>)>,
    pub(super) updates: Updates,
}

/// How far the solution has come. A descent that leads to the same solution as an earlier one
/// restores the earlier one's.
#[derive(Clone, Copy)]
pub struct Progress {
    /// The pose part of the last step, from where the tiles were predicted.
    pub last_step: Vector6<f64>,
    /// The maximum movement of a tile in the finest level's last step, pixels of the level.
    pub last_moved_px: f64,
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
        let AlignRequest { start: Start { expected, since_s, is_nearby_only }, was_reported, readout } = *request;
        let is_readout_open = readout.is_some_and(|question| question.is_open);
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
            since_s: since_s.filter(|_| !is_readout_open),
            is_readout_open,
            was_reported,
            is_nearby_only,
            bands,
            progress: Progress { last_step: Vector6::zeros(), last_moved_px: 0.0, above: None },
            wanders: false,
            has_opposite: false,
            has_jumped: false,
            by_blur: None,
            verified: None,
            updates,
        };
        let spec = frame.spec(FINEST, motion);
        if spec.frame_px() * spec.blur_px > TUNING.max_sharp_blur_px {
            frame.known.psf_variance_sigma = TUNING.blurred_psf_variance_sigma;
        }
        frame
    }

    /// Returns how a level is solved around a motion.
    pub fn spec(&self, level: usize, motion: &Motion) -> LevelSpec<'a> {
        let spec = LevelSpec::new(self.surfaces, self.slow, self.rays, self.updates.is_enlarged, level, motion);
        // A start found by features may lead nowhere. Filling up the pixels would then take as long
        // as several frames, in vain.
        LevelSpec { fills_up: level == FINEST && self.is_followed, ..spec }
    }

    /// Whether the body was reported before but not seen in the frame before.
    pub fn is_found_again(&self) -> bool {
        self.was_reported && !self.is_followed
    }

    /// Returns the current solution of the finest level.
    pub fn found(&mut self) -> Option<Corrected> {
        self.buffers.fine.solution().map(|solution| solution.found)
    }

    /// Selects the pixels of a level; false if there are too few.
    pub fn lay_out(&mut self, spec: &LevelSpec, motion: &Motion) -> bool {
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

    /// Solves the finest level once more from the solution.
    pub fn solve_again(&mut self, found: &Corrected) -> Option<Corrected> {
        let spec = self.spec(FINEST, &found.motion);
        let (fine, _, light) = self.buffers.at_level(FINEST);
        fine.recall_light(light);
        fine.predict(&spec, &found.motion);
        fine.solve(&spec, &self.known, light, false, 2)
    }

    /// Solves the finest level's pixels from a motion until a step is small.
    pub fn settle(&mut self, motion: Motion, known: &LevelPrior) -> Option<()> {
        self.buffers.has_kept = false;
        self.verified = None;
        let spec = self.spec(FINEST, &motion);
        let mut level = LevelMinimisation::new(self, spec, *known, Use::Settling, motion, false);
        let Minimum { end, .. } = minimise(&mut level, motion, TUNING.max_settling_steps);
        matches!(end, End::Converged | End::OutOfRounds).then_some(())
    }

    /// Continues from the solution to convergence, with the usual prior.
    pub fn settle_found(&mut self) -> Option<()> {
        let (found, known) = (self.found()?.motion, self.known);
        self.settle(found, &known)
    }

    /// Solves again with only the tiles that fit, for a newly found body of which much is visible,
    /// but less than half. Until then the better half of its tiles took part, and some of those
    /// show what occludes it. `None` if it does not converge.
    pub fn settle_by_what_fits(&mut self) -> Option<Corrected> {
        self.known.is_sure = true;
        self.settle_found()?;
        self.found().filter(|_| self.progress.last_moved_px < TUNING.max_last_step_px)
    }

    /// Returns the verdict on the current solution: how well its tiles agree, and its covariance;
    /// with the frame's clue on the exposure. `None` where there is no solution or the covariance
    /// is singular.
    pub fn verified(&mut self) -> Option<(Alignment, Option<Clue>)> {
        if self.verified.is_none() {
            self.verified = self.verify();
        }
        self.verified
    }

    fn verify(&mut self) -> Option<(Alignment, Option<Clue>)> {
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
    pub fn uncertain_px(&self) -> f64 {
        let focal = self.rays.camera().intrinsics().fx;
        let c = &self.expected.covariance;
        let sigma = |k: usize| (c[(k, k)] + c[(k + 1, k + 1)] + c[(k + 2, k + 2)]).max(0.0).sqrt();
        2.0 * focal * (sigma(3).min(1.0) + sigma(0) / distance_m(self.surfaces, &self.expected.motion.pose))
    }
}

/// Returns the finest level whose basin holds a start error of `off_px` frame pixels; the coarsest
/// if none does.
pub fn level_for(off_px: f64) -> usize {
    if off_px < TUNING.reselection_px * f64::from(1u32 << FINEST) {
        return FINEST;
    }
    (FINEST + 1..LEVELS).find(|l| TUNING.basin_px * f64::from(1u32 << l) > off_px).unwrap_or(LEVELS - 1)
}
