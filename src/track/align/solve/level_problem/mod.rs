//! The problem of one pyramid level: its selected pixels, their prediction, their residuals, and
//! the linear system that they form.
//!
//! The order is [`LevelProblem::lay_out`], then [`predict`](LevelProblem::predict), then
//! [`solve`](LevelProblem::solve), then [`solution`](LevelProblem::solution). `solve` gates the
//! tiles, linearises, and reweights. Everything that depends on a selection of pixels ends with it:
//! `lay_out` discards it, and there is no solution until the new pixels were predicted and solved.
//! `blur` solves for a velocity by motion blur, `solution` draws conclusions from a solved level,
//! and `patches` finds correspondences.

use crate::track::align::tuning::TUNING;
use nalgebra::Vector3;

pub mod blur;
pub mod patches;
#[cfg(feature = "cli")]
pub mod pixel_shifts;
pub mod solution;

use super::system::{Prior, System};
use super::tile_correlation::{TileCorrelation, median};
use super::verdict::are_sure;
use crate::motion::{Motion, MotionError, MotionMatrix};
use crate::track::align::kernel::evidence::RunEvidence;
use crate::track::align::kernel::normal::{Residuals, RobustWeighting, RunView, moments, residuals, robust_cost, squares_after};
use crate::track::align::kernel::tile_equations::{TileEquations, TileStep};
use crate::track::align::kernel::tile_products::{ProductBuffer, tile_equations};
use crate::track::align::learned::gradient_gain::{ChangeSums, PredictedChange};
use crate::track::align::learned::light::{RememberedLight, TileLight};
use crate::track::align::learned::noise::Noise;
use crate::track::align::pixels::appearance::{Appearance, Predicted, predict, predict_by_velocity};
use crate::track::align::pixels::level_spec::TileTime;
use crate::track::align::pixels::level_spec::{LevelSpec, moved};
use crate::track::align::pixels::runs::{Pixels, Run};
use crate::track::align::pixels::selection::Selector;
use crate::track::frame::frame_levels::{FINEST, FrameLevels};
use solution::LevelSolution;

/// The prior of the motion and of the point spread.
#[derive(Clone, Copy)]
pub struct LevelPrior<'a> {
    /// The predicted motion.
    pub motion: &'a Motion,
    /// Its information.
    pub information: &'a MotionMatrix,
    /// The slow average of the point spread's variance, and one sigma about it.
    pub psf_variance: f64,
    /// See `psf_variance`.
    pub psf_variance_sigma: f64,
    /// Whether whatever differs from the body is in front of it: it was seen there in the frame
    /// before, or much of it is seen where it was found. Otherwise it may be another body, or of
    /// another size, and a part that fits by chance must not be taken for its visible part.
    pub is_sure: bool,
}

impl LevelPrior<'_> {
    /// Returns the prior of a step from a motion.
    fn at(&self, motion: &Motion) -> Prior<'_> {
        Prior {
            information: self.information,
            error: motion.error_to(self.motion),
            psf_variance: self.psf_variance,
            psf_variance_sigma: self.psf_variance_sigma,
        }
    }
}

/// The pixels of a level with their prediction and their residuals.
#[derive(Debug, Default)]
struct Picture {
    pixels: Pixels,
    appearance: Appearance,
    residuals: Residuals,
}

impl Picture {
    /// Returns when a run was exposed.
    fn time(&self, spec: &LevelSpec, run: &Run) -> TileTime {
        let middle = (run.start + run.end) / 2;
        let delay_s = f64::from(self.pixels.delay_s[middle as usize]);
        TileTime { delay_s, mean_square_s2: delay_s * delay_s + spec.shutter.exposure_s.powi(2) / 12.0 }
    }

    fn view<'a>(&'a self, run: &'a RunAtWork) -> RunView<'a> {
        RunView { pixels: &self.pixels, run: &run.run, appearance: &self.appearance, light: &run.light, residuals: &self.residuals }
    }
}

/// A run of pixels with its results so far.
#[derive(Debug, Default)]
pub struct RunAtWork {
    /// Its pixels.
    pub run: Run,
    /// Its evidence at the solution.
    pub evidence: RunEvidence,
    /// The light of its residuals.
    light: TileLight,
    /// Its correlation with its prediction, and whether it takes part.
    gate: TileCorrelation,
    /// The last step of its columns.
    step: TileStep,
    /// Its equations in the last pass; only of open runs.
    equations: TileEquations,
}

/// A level: its pixels, where they are linearised, and their solution. Keeps its buffers.
#[derive(Debug, Default)]
pub struct LevelProblem {
    picture: Picture,
    /// The runs of the pixels.
    runs: Vec<RunAtWork>,
    /// The motion that the pixels were predicted for.
    at: Option<Motion>,
    /// The solution of that prediction.
    solved: Option<Corrected>,
    products: Box<ProductBuffer>,
    system: System,
    predicted_change: PredictedChange,
    sorted: Vec<f32>,
    /// Linearisations that were solved since the start.
    pub rounds: u64,
}

/// The result of reweighting.
struct Reweighted {
    /// Robust standard deviation of the residuals that the last step left, in sigmas of noise.
    residual_sigma: f64,
    /// Weight of the tiles in the last system: by the residuals before that step.
    weight: f64,
}

/// Minimum mean light that a tile's gain is guessed from. Raised, dark tiles are guessed too dark.
const MIN_PREDICTED_LIGHT: f32 = 0.1;

/// Whether tiles with these correlations show a body of which more than half may be occluded:
/// enough tiles fit, and most others show something else.
fn is_covered(correlations: &[f32]) -> bool {
    let telling = correlations.iter().filter(|correlation| **correlation > TUNING.min_bias_run_correlation).count();
    let others = correlations.iter().filter(|correlation| **correlation < TUNING.max_occluded_correlation).count();
    are_sure(telling, correlations.len()) && 2 * others >= correlations.len() - telling
}

/// The result of a linearisation.
#[derive(Debug, Clone, Copy)]
pub struct Corrected {
    /// The corrected motion.
    pub motion: Motion,
    /// Robust standard deviation of the residuals, in sigmas of noise.
    pub residual_sigma: f64,
    /// Weight of the tiles in the solved system. Whatever is added to that system or eliminated
    /// from it must have the same.
    pub weight: f64,
    /// The cost at the linearisation, by this solution's weights and tiles.
    pub cost: f64,
    /// By how much the step lowers it, if residuals are linear.
    pub decrease: f64,
}

impl LevelProblem {
    /// Selects and lays out the pixels of the level, in the remembered light. Returns false if
    /// there are too few.
    pub fn lay_out(
        &mut self,
        spec: &LevelSpec,
        frame: &mut FrameLevels,
        motion: &Motion,
        selector: &mut Selector,
        light: &RememberedLight,
    ) -> bool {
        (self.at, self.solved) = (None, None);
        self.runs.clear();
        let chosen = selector.choose(spec, motion);
        if chosen.len() < TUNING.min_level_pixels {
            return false;
        }
        let Picture { pixels, appearance, residuals } = &mut self.picture;
        pixels.arrange(chosen, spec, frame.light(spec.level), light);
        pixels.touch(spec, motion);
        appearance.resize(pixels.len());
        residuals.resize(pixels.len());
        self.runs.extend(pixels.runs().iter().map(|run| RunAtWork { run: *run, ..RunAtWork::default() }));
        true
    }

    /// Returns the pixels.
    pub fn pixels(&self) -> &Pixels {
        &self.picture.pixels
    }

    /// Returns the solution of the last prediction; `None` before it is solved.
    pub fn solution(&mut self) -> Option<LevelSolution<'_>> {
        Some(LevelSolution { found: self.solved?, problem: self })
    }

    /// Restores a remembered light.
    pub fn recall_light(&mut self, light: &RememberedLight) {
        self.picture.pixels.recall_light(light);
    }

    /// Predicts all pixels for a motion.
    pub fn predict(&mut self, spec: &LevelSpec, motion: &Motion) {
        self.predict_each(spec, motion, predict);
        self.at = Some(*motion);
    }

    /// Predicts all pixels, and their derivatives by the velocity.
    fn predict_by_velocity(&mut self, spec: &LevelSpec, motion: &Motion) {
        self.picture.appearance.make_room_for_velocity();
        self.predict_each(spec, motion, predict_by_velocity);
    }

    fn predict_each(&mut self, spec: &LevelSpec, motion: &Motion, predict: impl Fn(&Predicted, &mut Appearance)) {
        self.solved = None;
        let Picture { pixels, appearance, .. } = &mut self.picture;
        for &(surface, start, end) in &pixels.groups {
            let surface = &spec.surfaces[surface as usize];
            let range = [start as usize, end as usize];
            predict(&Predicted { surface, motion, spec, pixels, range }, appearance);
        }
    }

    /// Predicts the same pixels again after a step. Returns how much the intensities changed,
    /// against the change that the slopes predicted.
    pub fn predict_again(&mut self, spec: &LevelSpec, motion: &Motion) -> ChangeSums {
        self.predicted_change.resize(self.pixels().len());
        let appearance = &self.picture.appearance;
        for r in &self.runs {
            let step = std::array::from_fn(|c| r.step.columns[c]);
            self.predicted_change.predict(&appearance.intensity, &appearance.by_pose, &step, r.run.range());
        }
        self.predict(spec, motion);
        self.predicted_change.compare(&self.picture.appearance.intensity, &self.picture.pixels.counts)
    }

    /// Computes the residuals of all runs in the light of their pixels.
    fn residuals_all(&mut self, noise: &Noise) {
        let Picture { pixels, appearance, residuals: out } = &mut self.picture;
        for r in &mut self.runs {
            r.light = pixels.light_of(&r.run);
            r.step = TileStep::default();
            residuals(pixels, &r.run, appearance, &r.light, noise, out);
        }
    }

    /// Returns the cost of the prediction: of the residuals of the tiles that take part, in robust
    /// sigmas of `residual_sigma`, and of the prior. Comparable with the cost at another motion as
    /// long as pixels and tiles are the same.
    pub fn cost(&mut self, spec: &LevelSpec, level_prior: &LevelPrior, residual_sigma: f64) -> Option<f64> {
        let prior = level_prior.at(&self.at?);
        self.residuals_all(&spec.noise);
        Some(self.cost_of_residuals(&prior, residual_sigma))
    }

    /// Does the same for the residuals that are there.
    fn cost_of_residuals(&self, prior: &Prior, residual_sigma: f64) -> f64 {
        let Picture { pixels, residuals, .. } = &self.picture;
        let open = self.runs.iter().filter(|r| r.gate.is_open);
        open.map(|r| robust_cost(pixels, &r.run, residuals, residual_sigma)).sum::<f64>() + prior.cost(pixels.light())
    }

    /// Returns how far the picture moved since the prediction, pixels of the level; infinite before
    /// the first one.
    pub fn moved_since(&self, spec: &LevelSpec, motion: &Motion) -> f64 {
        self.at.map_or(f64::INFINITY, |at| self.moved_px(spec, &at, motion))
    }

    /// Returns the motion that the pixels were predicted for; `None` before the first prediction.
    pub fn predicted_at(&self) -> Option<Motion> {
        self.at
    }

    /// Keeps the pixels and their prediction for a new frame, and reads its intensities.
    pub fn renew(&mut self, spec: &LevelSpec, frame: &mut FrameLevels) {
        self.solved = None;
        self.picture.pixels.see(frame.light(spec.level));
    }

    /// Solves the linearised problem, iteratively reweighted, and corrects the light, which is
    /// remembered in `light`. `passes`: number of reweightings; if `is_first`, the first one has
    /// weights that never vanish. `None` where nothing was predicted, the system is singular or the
    /// motion is not finite.
    pub fn solve(
        &mut self,
        spec: &LevelSpec,
        level_prior: &LevelPrior,
        light: &mut RememberedLight,
        is_first: bool,
        passes: usize,
    ) -> Option<Corrected> {
        self.solved = None;
        let at = self.at?;
        let prior = level_prior.at(&at);
        // From a start that is off, nothing correlates well yet. At the finest level it is hardly
        // off.
        let may_be_covered = level_prior.is_sure && !is_first && spec.level == FINEST;
        self.gate_tiles(&spec.noise, may_be_covered);
        let Reweighted { residual_sigma, weight } = self.reweight(spec, &prior, spec.same_time(), is_first, passes)?;
        let (cost, decrease) = (self.cost_of_residuals(&prior, residual_sigma), self.system.predicted_decrease());
        let step = self.system.step();
        self.picture.pixels.correct_light(1.0, step.gains(), step.psf_variance(), step.bias());
        light.take(self.picture.pixels.light());
        let motion = at.corrected(&step.motion());
        self.solved = motion.is_finite().then_some(Corrected { motion, residual_sigma, weight, cost, decrease });
        self.solved
    }

    /// Changes the light by a part of the last step: `change` is the difference of the fractions
    /// that are taken of it. Returns the whole step of the motion.
    pub fn change_light_by_step(&mut self, change: f64, light: &mut RememberedLight) -> MotionError {
        self.solved = None;
        let step = self.system.step();
        self.picture.pixels.correct_light(change, step.gains(), step.psf_variance(), step.bias());
        light.take(self.picture.pixels.light());
        step.motion()
    }

    /// Solves for the step of the gated tiles from the linearisation, iteratively reweighted.
    /// `same_time`: the time of all tiles, where it is the same.
    fn reweight(
        &mut self,
        spec: &LevelSpec,
        prior: &Prior,
        same_time: Option<TileTime>,
        is_first: bool,
        passes: usize,
    ) -> Option<Reweighted> {
        self.rounds += 1;
        self.residuals_all(&spec.noise);
        let (mut residual_sigma, mut weight) = (self.residual_sigma(), 1.0);
        for pass in 0..passes {
            let stride = if pass + 1 < passes { self.rough_stride() } else { 1 };
            let weighting = RobustWeighting { residual_sigma, is_first_pass: is_first && pass == 0, stride };
            let Self { picture, runs, products, system, .. } = self;
            let light = picture.pixels.light();
            system.begin(light, prior, same_time);
            weight = residual_sigma.powi(-2) * stride as f64;
            // A rough step is used only for weights, so it ignores the times of rows.
            let is_rolling = same_time.is_none() && pass + 1 == passes;
            for r in runs.iter_mut().filter(|r| r.gate.is_open) {
                let (time, step) = (same_time.unwrap_or_else(|| picture.time(spec, &r.run)), &r.step.columns);
                let delay_s = is_rolling.then_some(time.delay_s as f32);
                r.equations = tile_equations(&picture.view(r), delay_s, step, &weighting, products);
                system.add(&r.equations, light.nodes_of(r.run.tile), &time, weight);
            }
            let step = system.solve()?;
            for r in runs {
                r.step = step.of_tile(light.nodes_of(r.run.tile), &same_time.unwrap_or_else(|| picture.time(spec, &r.run)));
            }
            residual_sigma = self.residual_sigma();
        }
        Some(Reweighted { residual_sigma, weight })
    }

    /// Whether the solution shows a body of which more than half may be occluded.
    pub fn may_be_covered(&mut self) -> bool {
        self.sorted.clear();
        self.sorted.extend(self.runs.iter().map(|r| r.gate.correlation));
        is_covered(&self.sorted)
    }

    /// Returns the ratio of runs that take part.
    pub fn inlier_tile_ratio(&self) -> f64 {
        self.runs.iter().filter(|r| r.gate.is_open).count() as f64 / self.runs.len().max(1) as f64
    }

    /// Returns the stride over groups of pixels that is fine enough for weights and for the noise.
    fn rough_stride(&self) -> usize {
        (self.pixels().len() / TUNING.rough_step_pixels).clamp(1, TUNING.max_group_stride)
    }

    /// Returns the squared whitened residuals that the last step left in the open runs, of one
    /// group of pixels in `stride`.
    fn squares(&mut self, stride: usize) -> &mut [f32] {
        self.sorted.clear();
        for r in self.runs.iter().filter(|r| r.gate.is_open) {
            squares_after(&self.picture.view(r), &r.step.columns, stride, &mut self.sorted);
        }
        &mut self.sorted
    }

    /// Returns the robust standard deviation of the residuals that the last step left, in sigmas.
    fn residual_sigma(&mut self) -> f64 {
        let stride = (self.pixels().len() / TUNING.min_scale_residuals).max(1);
        median(self.squares(stride)).map_or(1.0, |middle| (middle.sqrt() * 1.4826).max(0.7))
    }

    /// Gates the tiles: those that correlate too little with their prediction, at any gain and
    /// bias, show something else and are excluded. `may_be_covered`: whether more than half of the
    /// tiles may be excluded.
    fn gate_tiles(&mut self, noise: &Noise, may_be_covered: bool) {
        let Picture { pixels, appearance, .. } = &self.picture;
        self.sorted.clear();
        for r in &mut self.runs {
            r.gate = TileCorrelation::new(&moments(pixels, &r.run, appearance), noise);
            self.sorted.push(r.gate.correlation);
        }
        let is_covered = may_be_covered && is_covered(&self.sorted);
        // At least the better half takes part. But if more than that is occluded, the occluder
        // pulls the pose, and so do the tiles at its edge.
        let least = median(&mut self.sorted).map_or(TUNING.min_run_correlation, |middle| TUNING.min_run_correlation.min(middle as f32));
        let least = if is_covered { least.max(TUNING.min_bias_run_correlation) } else { least };
        for r in &mut self.runs {
            r.gate.is_open = r.gate.correlation >= least;
        }
    }

    /// Guesses the light from the open runs: the median of their biases, then each tile's mean
    /// light. Means are insensitive to a start that is off.
    pub fn guess_light(&mut self, spec: &LevelSpec, psf_variance: f64) {
        self.gate_tiles(&spec.noise, false);
        let Self { picture, runs, sorted, .. } = self;
        let open = || runs.iter().filter(|r| r.gate.is_open);
        sorted.clear();
        sorted.extend(open().map(|r| &r.gate).filter(|g| g.correlation > TUNING.min_bias_run_correlation).map(|g| g.bias));
        let bias = median(sorted).filter(|_| sorted.len() >= 6).map(|bias| bias.clamp(-TUNING.max_initial_bias, TUNING.max_initial_bias));
        let bias = bias.unwrap_or(picture.pixels.light().bias());
        let gain = |g: &TileCorrelation| ((f64::from(g.seen) - bias) / f64::from(g.predicted.max(MIN_PREDICTED_LIGHT))).clamp(0.02, 20.0);
        sorted.clear();
        sorted.extend(open().map(|r| gain(&r.gate) as f32));
        let Some(usual) = median(sorted) else { return };
        let tiles = open().map(|r| (r.run.tile, gain(&r.gate).clamp(0.25 * usual, 4.0 * usual)));
        picture.pixels.guess_light(bias, psf_variance, usual, tiles);
    }

    /// Returns the maximum movement of a tile's middle between two motions, pixels of the level.
    pub fn moved_px(&self, spec: &LevelSpec, before: &Motion, after: &Motion) -> f64 {
        let focal = spec.rays.camera().intrinsics().fx / f64::from(1u32 << spec.level);
        let pixels = self.pixels();
        let mut most = 0.0f64;
        for RunAtWork { run, .. } in &self.runs {
            let k = ((run.start + run.end) / 2) as usize;
            let ray = Vector3::new(f64::from(pixels.x[k]), f64::from(pixels.y[k]), 1.0);
            let tau = f64::from(pixels.delay_s[k]);
            let surface = &spec.surfaces[run.surface as usize];
            let moved = moved(surface, &ray, &before.after(tau).pose, &after.after(tau).pose);
            most = most.max(moved.unwrap_or(f64::INFINITY) * focal);
        }
        most
    }
}
