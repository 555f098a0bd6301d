//! One level at work: its pixels, what they should look like, what they say, and the system that they make.
//!
//! All that is known of a choice of pixels lives and ends with it: [`LevelProblem::lay_out`] begins anew, and there is nothing to conclude until
//! these pixels were predicted and solved.

use nalgebra::Vector3;

pub mod blur;
pub mod patches;
pub mod solution;

use super::system::{Prior, System};
use super::tile_correlation::{TileCorrelation, median};
use super::verdict::are_sure;
use crate::motion::{Motion, MotionMatrix};
use crate::track::align::kernel::evidence::RunEvidence;
use crate::track::align::kernel::normal::{Residuals, RobustWeighting, RunView, moments, residuals, squares_after};
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

/// Fewest pixels that a level is solved with. Chosen, not tuned: three for each of a motion's 18 unknowns. Raised, pictures seen small are
/// given up, or begun at finer levels; lowered, the expectation decides what is found.
const MIN_PIXELS: usize = 60;
/// Runs that correlate less with their prediction show something else; the better half takes part even so, unless others bear the pose out. The same limit as
/// that of tiles that agree (`verdict`). Raised, tiles in haze or glare are left out; lowered, people in front of the stage pull the pose.
const MIN_CORRELATION: f32 = 0.9;
/// Runs that correlate better tell of the bias in the first guess of the light, and of what is covered. Chosen, not tuned: below `MIN_CORRELATION`, as nothing
/// correlates well from a start that is off, and as high as something else by chance. Raised, too few runs are left; lowered, runs of something else take part.
const TELLING_CORRELATION: f32 = 0.8;
/// Largest bias of that guess, grey levels: one sigma of the solution's (`BIAS_SIGMA` in `system`). Raised, a line through runs with little
/// contrast can leave nearly no gain.
const MAX_BIAS: f64 = 60.0;
/// Fewest residuals that their robust spread is taken from, where there are as many: it is then known to 3 %. Raised, the median costs
/// more.
const SCALE_SAMPLES: usize = 1500;
/// Pixels that a rough step rests on, from which only the next one's weights are taken, and the estimate of the noise. Runs are stepped
/// over by at most `MAX_STRIDE` groups of them, so that long ones keep some. `ROUGH_PIXELS` raised, frames cost more; lowered, the
/// weights are worse. Chosen: a quarter of the usual pixels.
const ROUGH_PIXELS: usize = 2500;
const MAX_STRIDE: usize = 16;

/// Runs that correlate less show something else. Where half of those that do not tell do so, and enough others bear the pose out, the body is covered. Chosen: people before d-actors
/// are below it, and what a lens that is a little off displaces (postcard-67) is above. Raised, the latter passes for covers, and the pose follows the runs that fit
/// from frame to frame; lowered, people in front of the stage pull the pose.
const COVERED_CORRELATION: f32 = 0.5;

/// What is expected of the motion.
#[derive(Clone, Copy)]
pub struct Expected<'a> {
    /// Best guess.
    pub motion: &'a Motion,
    /// Its information.
    pub information: &'a MotionMatrix,
    /// The slow average of the point spread, and one sigma about it.
    pub psf_variance: f64,
    /// See `psf_variance`.
    pub psf_variance_sigma: f64,
    /// Whether what differs from the body is in front of it: it was seen there just now, or much of it is seen where it was found. Else it may be another, or of another size, and a part
    /// of it that fits by chance must not be taken for what is seen of it.
    pub is_sure: bool,
}

/// The pixels of a level with their prediction and their residuals.
#[derive(Debug, Default)]
struct Picture {
    pixels: Pixels,
    appearance: Appearance,
    residuals: Residuals,
}

impl Picture {
    /// When a run was exposed.
    fn time(&self, spec: &LevelSpec, run: &Run) -> TileTime {
        let middle = (run.start + run.end) / 2;
        let delay_s = f64::from(self.pixels.delay_s[middle as usize]);
        TileTime { delay_s, mean_square_s2: delay_s * delay_s + spec.shutter.exposure_s.powi(2) / 12.0 }
    }

    fn view<'a>(&'a self, run: &'a RunAtWork) -> RunView<'a> {
        RunView { pixels: &self.pixels, run: &run.run, appearance: &self.appearance, light: &run.light, residuals: &self.residuals }
    }
}

/// A run of the pixels with all that it came to so far.
#[derive(Debug, Default)]
pub struct RunAtWork {
    /// Its place.
    pub run: Run,
    /// What it showed at the solution.
    pub evidence: RunEvidence,
    /// The light of its residuals.
    light: TileLight,
    /// How it correlates with its prediction, and whether it takes part.
    gate: TileCorrelation,
    /// The last step of its columns.
    step: TileStep,
    /// What it said in the last pass; of open runs.
    equations: TileEquations,
}

/// A level: its pixels, where they are linearised, and what they were solved to.
#[derive(Debug, Default)]
pub struct LevelProblem {
    picture: Picture,
    /// The runs of the pixels.
    runs: Vec<RunAtWork>,
    /// Where the pixels were predicted.
    at: Option<Motion>,
    /// Where that prediction led.
    solved: Option<Corrected>,
    products: Box<ProductBuffer>,
    system: System,
    predicted_change: PredictedChange,
    sorted: Vec<f32>,
}

/// Whether tiles that correlate like this show a body of which more than half may be covered: enough tell of it, and most others show something else.
fn is_covered(correlations: &[f32]) -> bool {
    let telling = correlations.iter().filter(|correlation| **correlation > TELLING_CORRELATION).count();
    let others = correlations.iter().filter(|correlation| **correlation < COVERED_CORRELATION).count();
    are_sure(telling, correlations.len()) && 2 * others >= correlations.len() - telling
}

/// Where the linearisation led.
#[derive(Debug, Clone, Copy)]
pub struct Corrected {
    /// The motion.
    pub motion: Motion,
    /// Robust standard deviation of the residuals, in sigmas.
    pub scale: f64,
}

impl LevelProblem {
    /// Chooses and lays out the pixels of the level, in the light that is remembered; false where there are too few.
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
        if chosen.len() < MIN_PIXELS {
            return false;
        }
        let Picture { pixels, appearance, residuals } = &mut self.picture;
        pixels.arrange(chosen, spec, frame.level(spec.level), light);
        pixels.touch(spec, motion);
        appearance.resize(pixels.len());
        residuals.resize(pixels.len());
        self.runs.extend(pixels.runs().iter().map(|run| RunAtWork { run: *run, ..RunAtWork::default() }));
        true
    }

    /// The pixels.
    pub fn pixels(&self) -> &Pixels {
        &self.picture.pixels
    }

    /// Where the last prediction of these pixels led; `None` before it is solved.
    pub fn solution(&mut self) -> Option<LevelSolution<'_>> {
        Some(LevelSolution { found: self.solved?, problem: self })
    }

    /// Goes back to a light that is remembered.
    pub fn recall_light(&mut self, light: &RememberedLight) {
        self.picture.pixels.recall_light(light);
    }

    /// Predicts all pixels.
    pub fn predict(&mut self, spec: &LevelSpec, motion: &Motion) {
        self.predict_each(spec, motion, predict);
        self.at = Some(*motion);
    }

    /// Predicts all pixels, and how they change with the velocity.
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

    /// Predicts the same pixels once more after a step, and says what that changed beside what the slopes predicted.
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

    /// Residuals of all runs in the light of their pixels.
    fn residuals_all(&mut self, noise: &Noise) {
        let Picture { pixels, appearance, residuals: out } = &mut self.picture;
        for r in &mut self.runs {
            r.light = pixels.light_of(&r.run);
            r.step = TileStep::default();
            residuals(pixels, &r.run, appearance, &r.light, noise, out);
        }
    }

    /// How far the picture moved since the prediction, pixels of the level; infinite where there is none.
    pub fn moved_since(&self, spec: &LevelSpec, motion: &Motion) -> f64 {
        self.at.map_or(f64::INFINITY, |at| self.moved_px(spec, &at, motion))
    }

    /// The motion that the pixels' prediction is of; `None` before the first.
    pub fn predicted_at(&self) -> Option<Motion> {
        self.at
    }

    /// Keeps the pixels and their prediction for a new frame.
    pub fn renew(&mut self, spec: &LevelSpec, frame: &mut FrameLevels) {
        self.solved = None;
        self.picture.pixels.see(spec.level, frame.level(spec.level));
    }

    /// Solves the linearised problem, iteratively reweighted, and corrects the light, which is remembered. `passes`: reweightings; the first
    /// with weights that never vanish if `is_first`.
    pub fn solve(
        &mut self,
        spec: &LevelSpec,
        expected: &Expected,
        light: &mut RememberedLight,
        is_first: bool,
        passes: usize,
    ) -> Option<Corrected> {
        self.solved = None;
        let at = self.at?;
        let prior = Prior {
            information: expected.information,
            error: at.error_to(expected.motion),
            psf_variance: expected.psf_variance,
            psf_variance_sigma: expected.psf_variance_sigma,
        };
        // From a start that is off, nothing correlates well yet: at the finest level it hardly is.
        let may_be_covered = expected.is_sure && !is_first && spec.level == FINEST;
        self.gate_tiles(&spec.noise, may_be_covered);
        let scale = self.reweight(spec, &prior, spec.same_time(), is_first, passes)?;
        let step = self.system.step();
        self.picture.pixels.correct_light(step.gains(), step.psf_variance(), step.bias());
        light.take(self.picture.pixels.light());
        let motion = at.corrected(&step.motion());
        self.solved = motion.is_finite().then_some(Corrected { motion, scale });
        self.solved
    }

    /// Solves for the step of the gated tiles from the linearisation, iteratively reweighted, and gives the robust standard deviation of the residuals that it leaves, in
    /// sigmas. `same_time`: of all tiles, where it is the same.
    fn reweight(&mut self, spec: &LevelSpec, prior: &Prior, same_time: Option<TileTime>, is_first: bool, passes: usize) -> Option<f64> {
        self.residuals_all(&spec.noise);
        let mut scale = self.scale();
        for pass in 0..passes {
            let stride = if pass + 1 < passes { self.rough_stride() } else { 1 };
            let weighting = RobustWeighting { scale, is_first_pass: is_first && pass == 0, stride };
            let Self { picture, runs, products, system, .. } = self;
            let light = picture.pixels.light();
            system.begin(light, prior, same_time);
            let weight = scale.powi(-2) * stride as f64;
            // A rough step, which only weights are taken from, needs no times of rows.
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
            scale = self.scale();
        }
        Some(scale)
    }

    /// Whether the solution shows a body of which more than half may be covered.
    pub fn may_be_covered(&mut self) -> bool {
        self.sorted.clear();
        self.sorted.extend(self.runs.iter().map(|r| r.gate.correlation));
        is_covered(&self.sorted)
    }

    /// Share of the runs that take part.
    pub fn open_share(&self) -> f64 {
        self.runs.iter().filter(|r| r.gate.is_open).count() as f64 / self.runs.len().max(1) as f64
    }

    /// Stride over groups of pixels that is fine enough for weights and for the noise.
    fn rough_stride(&self) -> usize {
        (self.pixels().len() / ROUGH_PIXELS).clamp(1, MAX_STRIDE)
    }

    /// Squared whitened residuals that the last step left in the open runs, of one group of pixels in `stride`.
    fn squares(&mut self, stride: usize) -> &mut [f32] {
        self.sorted.clear();
        for r in self.runs.iter().filter(|r| r.gate.is_open) {
            squares_after(&self.picture.view(r), &r.step.columns, stride, &mut self.sorted);
        }
        &mut self.sorted
    }

    /// Robust standard deviation of the residuals that the last step left, in sigmas.
    fn scale(&mut self) -> f64 {
        let stride = (self.pixels().len() / SCALE_SAMPLES).max(1);
        median(self.squares(stride)).map_or(1.0, |middle| (middle.sqrt() * 1.4826).max(0.7))
    }

    /// Gates the tiles: those that correlate too little with their prediction, whatever its gain and bias, show something else and are left out.
    /// `may_be_covered`: whether so few may show the body that the better half does not.
    fn gate_tiles(&mut self, noise: &Noise, may_be_covered: bool) {
        let Picture { pixels, appearance, .. } = &self.picture;
        self.sorted.clear();
        for r in &mut self.runs {
            r.gate = TileCorrelation::new(&moments(pixels, &r.run, appearance), noise);
            self.sorted.push(r.gate.correlation);
        }
        let is_covered = may_be_covered && is_covered(&self.sorted);
        // The better half. But where more than that is covered, what covers it pulls the pose, and the tiles beside it that show some of both do.
        let least = median(&mut self.sorted).map_or(MIN_CORRELATION, |middle| MIN_CORRELATION.min(middle as f32));
        let least = if is_covered { least.max(TELLING_CORRELATION) } else { least };
        for r in &mut self.runs {
            r.gate.is_open = r.gate.correlation >= least;
        }
    }

    /// The light from the open runs: the median of their biases, then each tile's mean grey. Means do not mind a start that is off.
    pub fn guess_light(&mut self, spec: &LevelSpec, psf_variance: f64) {
        self.gate_tiles(&spec.noise, false);
        let Self { picture, runs, sorted, .. } = self;
        let open = || runs.iter().filter(|r| r.gate.is_open);
        sorted.clear();
        sorted.extend(open().map(|r| &r.gate).filter(|g| g.correlation > TELLING_CORRELATION).map(|g| g.bias));
        let bias = median(sorted).filter(|_| sorted.len() >= 6).map(|bias| bias.clamp(-MAX_BIAS, MAX_BIAS));
        let bias = bias.unwrap_or(picture.pixels.light().bias());
        let gain = |g: &TileCorrelation| ((f64::from(g.seen) - bias) / f64::from(g.predicted.max(1.0))).clamp(0.02, 20.0);
        sorted.clear();
        sorted.extend(open().map(|r| gain(&r.gate) as f32));
        let Some(usual) = median(sorted) else { return };
        let tiles = open().map(|r| (r.run.tile, gain(&r.gate).clamp(0.25 * usual, 4.0 * usual)));
        picture.pixels.guess_light(bias, psf_variance, usual, tiles);
    }

    /// Largest movement of a tile's middle between two motions, pixels of the level.
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
