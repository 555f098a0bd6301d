//! One level at work: its pixels, what they should look like, what they say, and the system that they make.

use nalgebra::{Matrix6, Vector2, Vector3};

mod readout;
pub mod used_pixels;

use super::AlignSurface;
use super::appearance::{Appearance, Predicted, predict};
use super::evidence::{RunEvidence, evidence};
use super::frame_levels::FrameLevels;
use super::gauge::{Gauge, median};
use super::light::Light;
use super::motion::{Motion, MotionEstimate, MotionMatrix};
use super::noise::{Noise, NoiseSums};
use super::normal::{COLUMNS, Residuals, RunView, TileLight, TileSums, Weighing, moments, residuals, squares_after, tile_sums};
use super::pixels::{Pixels, Run, Source};
use super::selection::{Choice, Chosen, Selector};
use super::slopes::{ChangeSums, Foretold};
use super::system::{Prior, System, TileTime};
use super::task::{Task, moved};
use crate::geometry::resection::larger_covariance;

/// Fewest pixels that a level is solved with.
const LEAST_PIXELS: usize = 60;
/// Runs that correlate less with their prediction show something else.
const LEAST_CORRELATION: f32 = 0.9;
/// Runs that correlate better tell of the bias, which is never larger than this, grey levels.
const TELLING_CORRELATION: f32 = 0.8;
const LARGEST_BIAS: f64 = 60.0;
/// Weight of the usual gain at a node, beside the tiles that touch it.
const USUAL_SHARE: f64 = 0.2;
/// Residuals that are looked at for their spread.
const SCALE_SAMPLES: usize = 1500;
/// A residual beyond three sigmas says no more of how well a prediction fits.
const LARGEST_MISFIT: f32 = 9.0;
/// Pixels that a step rests on which only the next one's weights are taken from, and that tell of the noise; runs are so long that this
/// many groups of theirs may be stepped over.
const ROUGH_PIXELS: usize = 2500;
const LARGEST_STRIDE: usize = 16;

/// What is expected of the motion.
#[derive(Clone, Copy)]
pub struct Expected<'a> {
    /// Best guess.
    pub motion: &'a Motion,
    /// Its information.
    pub information: &'a MotionMatrix,
    /// The slow average of the point spread, and one sigma about it.
    pub spread: f64,
    /// See `spread`.
    pub spread_sigma: f64,
}

/// The buffers of a level, and where they are linearised.
#[derive(Debug, Default)]
pub struct Work {
    /// The pixels.
    pub pixels: Pixels,
    appearance: Appearance,
    residuals: Residuals,
    /// Where the pixels were predicted.
    at: Option<Motion>,
    /// The light before the last step.
    light: Light,
    /// The step of each run's columns.
    steps: Vec<[f32; COLUMNS]>,
    /// How each run compares with its prediction.
    gauges: Vec<Gauge>,
    node_weights: Vec<f64>,
    foretold: Foretold,
    sorted: Vec<f32>,
    /// What the open runs said in the last pass, in order.
    sums: Vec<TileSums>,
    /// What each run showed at the solution.
    pub evidence: Vec<RunEvidence>,
}

/// Where the linearisation led.
#[derive(Debug, Clone, Copy)]
pub struct Corrected {
    /// The motion.
    pub motion: Motion,
    /// Robust standard deviation of the residuals, in sigmas.
    pub scale: f64,
}

impl Work {
    /// Chooses and lays out the pixels of the level; false where there are too few.
    pub fn lay_out(
        &mut self,
        task: &Task,
        frame: &mut FrameLevels,
        motion: &Motion,
        selector: &mut Selector,
        chosen: &mut Vec<Chosen>,
    ) -> bool {
        self.at = None;
        let Some(table) = &task.eye.tables[task.level] else { return false };
        let Task { level, sensor, blur_px, count, is_dense, .. } = *task;
        let choice = Choice { camera: &task.eye.camera, table, level, sensor: *sensor, blur_px, count, is_dense };
        selector.choose(task.surfaces, motion, &choice, chosen);
        if chosen.len() < LEAST_PIXELS {
            return false;
        }
        let source = Source { l: task.level, level: frame.level(task.level), table, sensor: task.sensor, height: task.eye.camera.height() };
        self.pixels.arrange(chosen, task.surfaces.len(), &source);
        let n = self.pixels.len();
        self.appearance.resize(n);
        self.residuals.resize(n);
        true
    }

    /// Predicts all pixels.
    pub fn predict(&mut self, task: &Task, motion: &Motion) {
        self.predict_all(task, motion);
        self.at = Some(*motion);
    }

    fn predict_all(&mut self, task: &Task, motion: &Motion) {
        for &(surface, start, end) in &self.pixels.groups {
            let surface = &task.surfaces[surface as usize];
            let range = [start as usize, end as usize];
            let Task { sensor, side, is_enlarged, slope_share, .. } = *task;
            let (places, pixels) = (task.places(), &self.pixels);
            let what = Predicted { surface, motion, sensor, places, side, is_enlarged, slope_share, pixels, range };
            predict(&what, &mut self.appearance);
        }
    }

    /// Predicts the same pixels once more after a step, and says what that changed beside what the slopes foretold.
    pub fn predict_again(&mut self, task: &Task, motion: &Motion) -> ChangeSums {
        self.foretold.resize(self.pixels.len());
        for (run, step) in self.pixels.runs.iter().zip(&self.steps) {
            let step = std::array::from_fn(|c| step[c]);
            self.foretold.foretell(&self.appearance.grey, &self.appearance.by_pose, &step, run.range());
        }
        self.predict(task, motion);
        self.foretold.compare(&self.appearance.grey, &self.pixels.counts)
    }

    /// Residuals of all runs in a light.
    fn residuals_all(&mut self, noise: &Noise, light: &Light) {
        self.light.clone_from(light);
        for run in &self.pixels.runs {
            let light = TileLight::new(light, self.pixels.grid.nodes_of(run.tile as usize));
            residuals(&self.pixels, run, &self.appearance, &light, noise, &mut self.residuals);
        }
    }

    /// The light that a run's residuals were taken in.
    fn light_of(&self, run: &Run) -> TileLight {
        TileLight::new(&self.light, self.pixels.grid.nodes_of(run.tile as usize))
    }

    fn view<'a>(&'a self, run: &'a Run, light: &'a TileLight) -> RunView<'a> {
        RunView { pixels: &self.pixels, run, appearance: &self.appearance, light, residuals: &self.residuals }
    }

    /// How far the picture moved since the prediction, pixels of the level; infinite where there is none.
    pub fn moved_since(&self, task: &Task, motion: &Motion) -> f64 {
        self.at.map_or(f64::INFINITY, |at| self.moved_px(task, &at, motion))
    }

    /// Keeps the pixels and their prediction for a new frame.
    pub fn renew(&mut self, task: &Task, frame: &mut FrameLevels) {
        self.pixels.see(task.level, frame.level(task.level));
    }

    /// Solves the linearised problem, iteratively reweighted, and corrects the light. `passes`: reweightings; the first with weights
    /// that never vanish if `is_first`.
    pub fn solve(
        &mut self,
        task: &Task,
        expected: &Expected,
        light: &mut Light,
        system: &mut System,
        is_first: bool,
        passes: usize,
    ) -> Option<Corrected> {
        let at = self.at?;
        self.gauge(&task.noise);
        light.regrid(&self.pixels.grid);
        self.residuals_all(&task.noise, light);
        self.steps.clear();
        self.steps.resize(self.pixels.runs.len(), [0.0; COLUMNS]);
        let mut scale = self.scale();
        let mut all_sums = std::mem::take(&mut self.sums);
        let mut is_solved = true;
        for pass in 0..passes {
            let stride = if pass + 1 < passes { self.rough_stride() } else { 1 };
            let weighing = Weighing { scale, is_first_look: is_first && pass == 0, stride };
            let prior = Prior {
                information: expected.information,
                error: at.error_to(expected.motion),
                spread: expected.spread,
                spread_sigma: expected.spread_sigma,
            };
            system.begin(&self.pixels.grid, light, &prior, task.same_time());
            let weight = scale.powi(-2) * stride as f64;
            all_sums.clear();
            for ((run, step), _) in self.pixels.runs.iter().zip(&self.steps).zip(&self.gauges).filter(|(_, g)| g.is_open) {
                let nodes = self.pixels.grid.nodes_of(run.tile as usize);
                let sums = tile_sums(&self.view(run, &self.light_of(run)), step, &weighing);
                system.add(&sums, nodes, &self.time(task, run), weight);
                all_sums.push(sums);
            }
            let Some(step) = system.solve() else {
                is_solved = false;
                break;
            };
            for k in 0..self.pixels.runs.len() {
                let run = self.pixels.runs[k];
                self.steps[k] = step.of_tile(self.pixels.grid.nodes_of(run.tile as usize), &self.time(task, &run));
            }
            scale = self.scale();
        }
        self.sums = all_sums;
        if !is_solved {
            return None;
        }
        let step = system.step();
        light.spread += step.spread();
        light.bias += step.bias();
        for (gain, change) in light.gains.iter_mut().zip(step.gains()) {
            *gain += change;
        }
        let motion = at.corrected(&step.motion());
        motion.is_finite().then_some(Corrected { motion, scale })
    }

    /// Share of the runs that take part.
    pub fn open_share(&self) -> f64 {
        self.gauges.iter().filter(|g| g.is_open).count() as f64 / self.gauges.len().max(1) as f64
    }

    /// Of so many groups of pixels one is enough for weights and for the noise.
    fn rough_stride(&self) -> usize {
        (self.pixels.len() / ROUGH_PIXELS).clamp(1, LARGEST_STRIDE)
    }

    fn time(&self, task: &Task, run: &Run) -> TileTime {
        let middle = (run.start + run.end) / 2;
        let delay_s = f64::from(self.pixels.delay_s[middle as usize]);
        TileTime { delay_s, mean_square_s2: delay_s * delay_s + task.sensor.exposure_s.powi(2) / 12.0 }
    }

    /// Squared whitened residuals that the last step left in the open runs, of one group of pixels in `stride`.
    fn squares(&mut self, stride: usize) -> &mut [f32] {
        let mut squares = std::mem::take(&mut self.sorted);
        squares.clear();
        for ((run, step), _) in self.pixels.runs.iter().zip(&self.steps).zip(&self.gauges).filter(|(_, g)| g.is_open) {
            squares_after(&self.view(run, &self.light_of(run)), step, stride, &mut squares);
        }
        self.sorted = squares;
        &mut self.sorted
    }

    /// Robust standard deviation of the residuals that the last step left, in sigmas.
    fn scale(&mut self) -> f64 {
        let stride = (self.pixels.len() / SCALE_SAMPLES).max(1);
        median(self.squares(stride)).map_or(1.0, |middle| (middle.sqrt() * 1.4826).max(0.7))
    }

    /// Mean squared residual that the last step left, sigmas squared; each counts as [`LARGEST_MISFIT`] at most.
    pub fn misfit(&mut self) -> f64 {
        let squares = self.squares(1);
        squares.iter().map(|s| f64::from(s.min(LARGEST_MISFIT))).sum::<f64>() / squares.len().max(1) as f64
    }

    /// Compares every run with its prediction, whatever its gain and bias: closes those that show something else.
    fn gauge(&mut self, noise: &Noise) {
        self.gauges.clear();
        self.sorted.clear();
        for run in &self.pixels.runs {
            let gauge = Gauge::new(&moments(&self.pixels, run, &self.appearance), noise);
            self.sorted.push(gauge.correlation);
            self.gauges.push(gauge);
        }
        // The better half at least: from a start that is off, nothing correlates well yet.
        let least = median(&mut self.sorted).map_or(LEAST_CORRELATION, |middle| LEAST_CORRELATION.min(middle as f32));
        for gauge in &mut self.gauges {
            gauge.is_open = gauge.correlation >= least;
        }
    }

    /// The light from the open runs: the median of their biases, then each tile's mean grey. Means do not mind a start that is off.
    pub fn guess_light(&mut self, task: &Task, light: &mut Light, spread: f64) {
        self.gauge(&task.noise);
        self.sorted.clear();
        self.sorted.extend(self.gauges.iter().filter(|g| g.is_open && g.correlation > TELLING_CORRELATION).map(|g| g.bias));
        if let Some(bias) = median(&mut self.sorted).filter(|_| self.sorted.len() >= 6) {
            light.bias = bias.clamp(-LARGEST_BIAS, LARGEST_BIAS);
        }
        light.spread = spread;
        let bias = light.bias;
        let gain = |g: &Gauge| ((f64::from(g.seen) - bias) / f64::from(g.predicted.max(1.0))).clamp(0.02, 20.0);
        self.sorted.clear();
        self.sorted.extend(self.gauges.iter().filter(|g| g.is_open).map(|g| gain(g) as f32));
        let Some(usual) = median(&mut self.sorted) else { return };
        light.regrid(&self.pixels.grid);
        // Each node from the open tiles that touch it, and a little of what is usual.
        self.node_weights.clear();
        self.node_weights.resize(light.gains.len(), USUAL_SHARE);
        light.set_gain(usual * USUAL_SHARE);
        for (run, gauge) in self.pixels.runs.iter().zip(&self.gauges).filter(|(_, g)| g.is_open) {
            let g = gain(gauge).clamp(0.25 * usual, 4.0 * usual);
            for node in self.pixels.grid.nodes_of(run.tile as usize) {
                light.gains[node] += g;
                self.node_weights[node] += 1.0;
            }
        }
        for (gain, weight) in light.gains.iter_mut().zip(&self.node_weights) {
            *gain /= weight;
        }
    }

    /// Largest movement of a tile's middle between two motions, pixels of the level.
    pub fn moved_px(&self, task: &Task, before: &Motion, after: &Motion) -> f64 {
        let focal = task.eye.camera.intrinsics().fx / f64::from(1u32 << task.level);
        let mut most = 0.0f64;
        for run in &self.pixels.runs {
            let k = ((run.start + run.end) / 2) as usize;
            let ray = Vector3::new(f64::from(self.pixels.x[k]), f64::from(self.pixels.y[k]), 1.0);
            let tau = f64::from(self.pixels.delay_s[k]);
            let surface = &task.surfaces[run.surface as usize];
            let moved = moved(surface, &ray, &before.after(tau).pose, &after.after(tau).pose);
            most = most.max(moved.unwrap_or(f64::INFINITY) * focal);
        }
        most
    }

    /// Predicts every run as if the frame showed it shifted (pixels of the level), and looks at it again. The pixels' rays are changed:
    /// nothing may be solved from them after.
    pub fn look_shifted(&mut self, task: &Task, motion: &Motion, light: &Light, shifts: &[Vector2<f64>]) {
        self.at = None;
        for (run, shift) in self.pixels.runs.iter().zip(shifts) {
            let table = task.eye.tables[task.level].as_ref();
            let (su, sv) = (shift.x as f32, shift.y as f32);
            for k in run.range() {
                let Some([x, y]) = table.map(|t| t.rays[self.pixels.index[k] as usize]) else { continue };
                self.pixels.x[k] = x - self.pixels.x_across[k] * su - self.pixels.x_down[k] * sv;
                self.pixels.y[k] = y - self.pixels.y_across[k] * su - self.pixels.y_down[k] * sv;
            }
        }
        self.predict_all(task, motion);
        self.residuals_all(&task.noise, light);
        self.steps.fill([0.0; COLUMNS]);
        let weighing = Weighing { scale: self.scale(), is_first_look: false, stride: 1 };
        let mut seen = std::mem::take(&mut self.evidence);
        for (e, run) in seen.iter_mut().zip(&self.pixels.runs) {
            *e = evidence(&self.view(run, &self.light_of(run)), &[0.0; COLUMNS], &weighing);
        }
        self.evidence = seen;
    }

    /// Where the middle of a run's detail lies on its surface, metres from the centre.
    pub fn middle_on_surface(&self, run: &Run, e: &RunEvidence, surface: &AlignSurface, motion: &Motion) -> Option<Vector2<f64>> {
        // The pixel nearest to the middle stands for it: its ray is known exactly.
        let [weight, u, v] = e.place;
        let (u, v) = ((u / weight) as f32, (v / weight) as f32);
        let [columns, rows] = &self.pixels.place;
        let off = |k: &usize| (columns[*k] - u).powi(2) + (rows[*k] - v).powi(2);
        let k = run.range().min_by(|a, b| off(a).total_cmp(&off(b)))?;
        let ray = Vector3::new(f64::from(self.pixels.x[k]), f64::from(self.pixels.y[k]), 1.0);
        let pose = motion.after(f64::from(self.pixels.delay_s[k])).pose;
        let direction = surface.rotation.transpose() * (pose.rotation * ray);
        let from = surface.rotation.transpose() * (pose.translation - surface.centre);
        let point = from - direction * (from.z / direction.z);
        Some(point.xy())
    }

    /// What the open runs say of the noise, as the last step leaves them.
    pub fn noise_sums(&self, scale: f64) -> NoiseSums {
        let weighing = Weighing { scale, is_first_look: false, stride: self.rough_stride() };
        let mut sums = NoiseSums::default();
        for ((run, step), _) in self.pixels.runs.iter().zip(&self.steps).zip(&self.gauges).filter(|(_, g)| g.is_open) {
            sums.add(&self.view(run, &self.light_of(run)), step, &weighing);
        }
        sums
    }

    /// Covariance at the solution: of the whole motion (noise), and of the pose (noise, or the scatter of the tiles' votes where it
    /// is larger). Fills [`Work::evidence`].
    pub fn conclude(&mut self, task: &Task, solved: &Corrected, system: &mut System) -> Option<(MotionEstimate, Matrix6<f64>)> {
        let weighing = Weighing { scale: solved.scale, is_first_look: false, stride: 1 };
        let covariance = system.motion_covariance();
        let noise: Matrix6<f64> = covariance.fixed_view::<6, 6>(0, 0).into_owned();
        let weight = solved.scale.powi(-2);
        let mut votes = Matrix6::zeros();
        let mut seen = std::mem::take(&mut self.evidence);
        seen.clear();
        let mut sums = self.sums.iter();
        let mut n = 0.0;
        for ((run, step), gauge) in self.pixels.runs.iter().zip(&self.steps).zip(&self.gauges) {
            let light = self.light_of(run);
            let view = self.view(run, &light);
            if let Some(sums) = gauge.is_open.then(|| sums.next()).flatten() {
                let nodes = self.pixels.grid.nodes_of(run.tile as usize);
                let vote = system.vote(sums, step, nodes, &self.time(task, run), weight);
                votes += vote * vote.transpose();
                n += 1.0;
            }
            seen.push(evidence(&view, step, &weighing));
        }
        self.evidence = seen;
        let factor = if n > 7.0 { n / (n - 6.0) } else { 7.0 };
        let honest = larger_covariance(&noise, &(votes * factor))?;
        // A camera that starts or stops at a share s of the exposure is seen s (1 - s) / 2 of it from where its stamp says, per unit of
        // speed: a mean square of 1 / 120 over all s.
        let started = covariance.fixed_view::<6, 6>(6, 6) * (task.sensor.exposure_s.powi(2) / 120.0);
        Some((MotionEstimate { motion: solved.motion, covariance }, honest + started))
    }
}
