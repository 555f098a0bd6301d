//! One pyramid level of a frame as a problem for the minimiser: predicted at a motion, solved for a
//! step, and ended where a step is small or the level leads nowhere.

use super::super::learned::gradient_gain::ChangeSums;
use super::super::pixels::level_spec::LevelSpec;
use super::super::solve::level_problem::{Corrected, LevelPrior};
use super::super::solve::minimiser::{End, LeastSquares, Step};
use super::FrameProblem;
use crate::motion::Motion;
use crate::track::align::tuning::TUNING;
use crate::track::frame::frame_levels::FINEST;

/// A level of a frame.
pub struct LevelMinimisation<'p, 'a> {
    frame: &'p mut FrameProblem<'a>,
    spec: LevelSpec<'a>,
    prior: LevelPrior<'p>,
    use_of: Use,
    /// Where its pixels were selected.
    selected_at: Motion,
    /// Whether nothing was solved yet, from a start whose light is unknown.
    is_first: bool,
    /// Whether these pixels were predicted before with this blur.
    is_same: bool,
    /// The fraction of the last step that was taken.
    fraction: f64,
    /// Predictions so far.
    rounds: usize,
    /// The round from which long steps end the level.
    settles_from: usize,
    changes: ChangeSums,
    solved: Option<Corrected>,
}

/// What a level is minimised for.
#[derive(Clone, Copy, PartialEq)]
pub enum Use {
    /// To find the body, from a start that may be far off.
    Descent,
    /// To continue from a solution with another prior.
    Settling,
}

impl<'p, 'a> LevelMinimisation<'p, 'a> {
    /// Takes a level whose pixels were selected at `start`. `is_first`: whether its light is to be
    /// guessed.
    pub fn new(
        frame: &'p mut FrameProblem<'a>,
        spec: LevelSpec<'a>,
        prior: LevelPrior<'p>,
        use_of: Use,
        start: Motion,
        is_first: bool,
    ) -> Self {
        Self {
            frame,
            spec,
            prior,
            use_of,
            selected_at: start,
            is_first,
            is_same: false,
            fraction: 1.0,
            rounds: 0,
            settles_from: TUNING.settling_rounds,
            changes: ChangeSums::default(),
            solved: None,
        }
    }

    /// Returns the last solution if its step was short enough to be reported. At the finest level,
    /// the frame keeps what the steps of a descent say of the slopes.
    pub fn finish_descent(self) -> Option<Corrected> {
        if self.spec.level == FINEST {
            self.frame.updates.changes = self.changes;
        }
        self.solved.filter(|_| self.frame.progress.last_moved_px < TUNING.max_last_step_px)
    }

    /// Takes up the blur of the motion so far. In a descent, only rows of a rolling shutter show
    /// the motion of a body that was just found, so its prediction starts without blur.
    fn take_up_blur(&mut self, motion: &Motion) {
        let blurred = match self.use_of {
            Use::Settling => self.frame.spec(self.spec.level, motion),
            Use::Descent if self.spec.level != FINEST && self.frame.may_ask_blur() => self.spec.blurred_by(motion),
            Use::Descent => return,
        };
        if blurred.places > self.spec.places {
            self.settles_from = self.rounds + TUNING.settling_rounds;
        }
        self.is_same &= blurred.places == self.spec.places;
        self.spec = blurred;
    }

    /// Whether a descent ends with a solution that moved the picture by `moved_px`.
    fn end_of_descent(&mut self, solved: &Corrected, moved_px: f64) -> Option<End> {
        let Self { frame, spec, rounds, .. } = self;
        let residual_sigma = solved.residual_sigma;
        let is_half_open = spec.level == FINEST && frame.buffers.fine.inlier_tile_ratio() < TUNING.hopeless_inlier_ratio;
        // Where barely half the tiles of a new body fit, and those poorly, full convergence is not
        // needed: tiles keep entering and leaving.
        let is_poor = is_half_open && !frame.is_followed && *rounds > TUNING.settling_rounds && residual_sigma > TUNING.clear_fit_sigma;
        // An occluded body converges later, once it is known which tiles fit; a blurred one fits
        // once its velocity is known.
        let is_covered = is_half_open && frame.is_found_again() && residual_sigma < TUNING.clear_fit_sigma;
        let is_hopeless = is_half_open && *rounds >= TUNING.hopeless_rounds && residual_sigma > TUNING.hopeless_sigma;
        let is_blurred = is_hopeless && residual_sigma < TUNING.poor_fit_sigma && frame.is_clearly_blurred(residual_sigma);
        let small_px = if is_poor || is_covered || is_blurred {
            TUNING.max_last_step_px
        } else if spec.level == FINEST {
            frame.fine_step_px()
        } else {
            TUNING.coarse_converged_px
        };
        if moved_px < small_px {
            return Some(End::Converged);
        }
        let is_bad = is_poor || residual_sigma > TUNING.poor_fit_sigma;
        let longest_px = if is_bad { TUNING.max_settled_step_of_poor_fit_px } else { TUNING.max_settled_step_px };
        if *rounds > self.settles_from && moved_px > longest_px || is_poor && *rounds >= TUNING.max_poor_rounds {
            frame.wanders = is_poor;
            return Some(End::Futile);
        }
        (is_hopeless && !is_blurred).then_some(End::Futile)
    }

    /// Selects the pixels of the finest level anew where the pose moved much; false if there are
    /// too few.
    fn reselect(&mut self, motion: &Motion) -> bool {
        let Self { frame, spec, .. } = self;
        let may_move = self.use_of == Use::Descent && spec.level == FINEST;
        if !may_move || frame.buffers.fine.moved_px(spec, &self.selected_at, motion) <= TUNING.reselection_px {
            return true;
        }
        (self.selected_at, self.is_same) = (*motion, false);
        frame.lay_out(spec, motion)
    }
}

impl LeastSquares for LevelMinimisation<'_, '_> {
    type State = Motion;

    fn predict(&mut self, at: &Motion) -> Option<bool> {
        self.take_up_blur(at);
        self.rounds += 1;
        if !self.reselect(at) {
            return None;
        }
        let Self { frame, spec, .. } = self;
        let (problem, _, _) = frame.buffers.at_level(spec.level);
        if self.is_same && spec.level == FINEST && self.fraction == 1.0 {
            self.changes.add(&problem.predict_again(spec, at));
        } else {
            problem.predict(spec, at);
        }
        if self.is_first {
            problem.guess_light(spec, frame.slow.psf_variance);
        }
        // Above the finest level costs are not compared: from a distant start they rise before they
        // fall.
        Some(std::mem::replace(&mut self.is_same, true) && spec.level == FINEST)
    }

    fn cost(&mut self) -> f64 {
        let Self { frame, spec, prior, solved, .. } = self;
        let (problem, ..) = frame.buffers.at_level(spec.level);
        solved.and_then(|solved| problem.cost(spec, prior, solved.residual_sigma)).unwrap_or(f64::NAN)
    }

    fn solve(&mut self, at: &Motion) -> Option<Step<Motion>> {
        let Self { frame, spec, prior, .. } = self;
        let (problem, _, light) = frame.buffers.at_level(spec.level);
        let is_first = std::mem::take(&mut self.is_first);
        let solved = problem.solve(spec, prior, light, is_first, if is_first { 3 } else { 2 })?;
        let moved_px = problem.moved_px(spec, at, &solved.motion);
        tracing::trace!(
            level = spec.level,
            moved_px,
            pixels = problem.pixels().len(),
            residual_sigma = solved.residual_sigma,
            inlier_tile_ratio = problem.inlier_tile_ratio(),
            cost = solved.cost,
            decrease = solved.decrease
        );
        (frame.progress.last_step, frame.progress.last_moved_px) = (at.pose_error_to(&solved.motion), moved_px);
        (self.solved, self.fraction) = (Some(solved), 1.0);
        Some(Step { to: solved.motion, cost: solved.cost, decrease: solved.decrease })
    }

    fn at_fraction(&mut self, from: &Motion, fraction: f64) -> Motion {
        let Self { frame, spec, .. } = self;
        let (problem, _, light) = frame.buffers.at_level(spec.level);
        let change = fraction - std::mem::replace(&mut self.fraction, fraction);
        from.corrected(&(problem.change_light_by_step(change, light) * fraction))
    }

    fn end(&mut self) -> Option<End> {
        let moved_px = self.frame.progress.last_moved_px;
        match self.use_of {
            Use::Settling => (moved_px < TUNING.fine_converged_px).then_some(End::Converged),
            Use::Descent => self.end_of_descent(&self.solved?, moved_px),
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Vector3, Vector6};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::super::super::learned::online_calibration::OnlineCalibration;
    use super::super::super::picture::surface::AlignSurface;
    use super::super::super::request::{AlignRequest, Start};
    use super::super::super::solve::minimiser::{Minimum, minimise};
    use super::super::Buffers;
    use super::*;
    use crate::camera::Shutter;
    use crate::geometry::resection::perturbed;
    use crate::motion::MotionEstimate;
    use crate::track::frame::frame_levels::FrameLevels;
    use crate::track::frame::rays::CameraRays;
    use crate::track::synthetic::{cloth, facing, lens, view};

    /// A cloth seen by a still camera.
    struct Scene {
        levels: FrameLevels,
        rays: CameraRays,
        surfaces: [AlignSurface; 1],
        slow: OnlineCalibration,
        buffers: Buffers,
        truth: Motion,
    }

    impl Scene {
        fn new() -> Self {
            let (truth, lens) = (facing(0.2, -0.3, Vector3::new(0.1, 0.05, 3.4)), lens(960, 720));
            let mut levels = FrameLevels::default();
            levels.update(&view(&cloth(1), &truth, &lens));
            let surfaces = [AlignSurface::new(&cloth(1))];
            Self {
                levels,
                rays: CameraRays::new(lens, None),
                slow: OnlineCalibration::new(Shutter { readout_s: 0.0, exposure_s: 1e-6 }),
                buffers: Buffers::with_room_for(&surfaces),
                surfaces,
                truth: Motion::still(truth.inverse()),
            }
        }

        /// Asks a level whose pixels were selected at a start that is off by `error`.
        fn at_level<T>(&mut self, level: usize, error: &Vector6<f64>, ask: impl FnOnce(LevelMinimisation, Motion, &LevelSpec) -> T) -> T {
            let start = perturbed(&self.truth.pose.inverse(), error).inverse();
            let expected = MotionEstimate::unseen(start, 3.4, 0.1, 0.03);
            let information = expected.covariance.cholesky().expect("positive").inverse();
            let request = AlignRequest::new(Start::found(&expected), true);
            let Self { surfaces, slow, buffers, levels, rays, .. } = self;
            let mut frame = FrameProblem::new(surfaces, slow, buffers, levels, rays, &request, &information);
            let motion = Motion::still(start);
            let spec = frame.spec(level, &motion);
            assert!(frame.lay_out(&spec, &motion));
            let prior = frame.known;
            ask(LevelMinimisation::new(&mut frame, spec, prior, Use::Descent, motion, true), motion, &spec)
        }
    }

    /// Returns a random error of the pose that moves the picture by `off_px` pixels of the level.
    fn error(random: &mut Pcg64Mcg, scene: &Scene, level: usize, off_px: f64) -> Vector6<f64> {
        let direction = Vector6::from_fn(|axis, _| random.random_range(-1.0..1.0) * if axis < 3 { 3.4 } else { 1.0 });
        let focal = scene.rays.camera().intrinsics().fx / f64::from(1u32 << level);
        let trial = direction * (off_px / focal);
        let spec = LevelSpec::new(&scene.surfaces, &scene.slow, &scene.rays, true, level, &scene.truth);
        let moved = Motion::still(perturbed(&scene.truth.pose.inverse(), &trial).inverse());
        trial * (off_px / spec.moved_px(&scene.truth, &moved))
    }

    /// The cost falls along a step as the linear system says: its slope at the beginning is twice
    /// the decrease that the whole step promises.
    #[test]
    fn the_cost_falls_along_a_step_as_predicted() {
        let mut scene = Scene::new();
        for level in [FINEST, FINEST + 1, FINEST + 2] {
            let off = error(&mut Pcg64Mcg::seed_from_u64(5), &scene, level, 0.1);
            scene.at_level(level, &off, |mut problem, start, _| {
                // The first step is weighted so that it reaches far; the second as all others are.
                let mut from = start;
                for _ in 0..2 {
                    problem.predict(&from).expect("enough pixels");
                    from = problem.solve(&from).expect("determined").to;
                }
                from = from.corrected(&nalgebra::SVector::<f64, 18>::from_fn(|i, _| if i < 6 { 4e-5 } else { 0.0 }));
                problem.predict(&from);
                let step = problem.solve(&from).expect("determined");
                let at = problem.at_fraction(&from, 0.1);
                problem.predict(&at);
                let ratio = (step.cost - problem.cost()) / (0.19 * step.decrease);
                println!("level {level}: {:.1} of {:.1}, {ratio:.3}", step.decrease, step.cost);
                assert!((0.9..1.1).contains(&ratio), "{ratio}");
            });
        }
    }

    /// Of 20 starts at each distance, how many lead to the pose. `cargo test --lib basin --
    /// --nocapture` prints the curve of every level.
    #[test]
    fn every_level_converges_from_within_its_basin() {
        let mut scene = Scene::new();
        let truth = scene.truth;
        for level in FINEST..=FINEST + 3 {
            for off_px in [0.5, 1.0, 2.0, 2.5, 3.0, 4.0, 6.0, 8.0] {
                let mut random = Pcg64Mcg::seed_from_u64(11);
                let (mut found, mut rounds) = (0, 0);
                for _ in 0..20 {
                    let off = error(&mut random, &scene, level, off_px);
                    let ends_at_truth = |mut problem: LevelMinimisation, start, spec: &LevelSpec| {
                        let Minimum { state, .. } = minimise(&mut problem, start, TUNING.max_coarse_rounds);
                        rounds += problem.rounds;
                        spec.moved_px(&truth, &state) < 0.3
                    };
                    found += usize::from(scene.at_level(level, &off, ends_at_truth));
                }
                println!("level {level}, {off_px} px: {found} of 20, {:.1} rounds", rounds as f64 / 20.0);
                assert!(off_px > TUNING.basin_px || found >= 19, "level {level}, {off_px} px: {found}");
            }
        }
    }
}
