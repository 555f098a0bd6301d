//! The joint adjustment of stage and lens. In every round each keyframe is aligned on grey values
//! with the current model, and the model takes one Gauss-Newton step from the tiles' residuals,
//! with the frames' motions eliminated. The residuals at the end are noise.

use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion, Vector3};

use super::constraints::{self, Constraint, ConstraintCheck};
use super::dense_system::Factor;
use super::normal_equations::{FrameRows, NormalEquations};
use super::observers::{ObservedFrames, Observers};
use super::prior::{self, Smoothness};
use super::scales::{Support, robust_scales, supports};
use super::stage_model::{LENS_NUMBERS, StageModel, distance_m};
use super::unmodelled::unmodelled_m;
use crate::camera::Shutter;
use crate::motion::Motion;
use crate::track::{KnownRates, ObservedFrame, ObservedTile};

/// Maximum number of fine rounds. Most surveys converge in six to nine; those with an unconfigured
/// rolling shutter do not before their clips are tracked again. Raised, only surveys that never
/// converge take longer.
const MAX_ROUNDS: usize = 24;
/// Number of rounds with features, which lead to the basin of the alignment if a lens or a layout
/// is far off.
const FEATURE_ROUNDS: usize = 5;
/// Number of rounds with anchors, the first half of them at half the frame's size.
const ANCHOR_ROUNDS: usize = 4;
/// Step of the tiles' positions, pixels (root mean square), below which a model may count as
/// converged: the remaining motion caused by keyframes that come and go.
const SMALL_STEP_PX: f64 = 0.01;
/// Step below which a model counts as converged in any case, pixels. All keyframes share their
/// systematic errors, so averaging over more does not remove such a step. Raised to
/// `SMALL_STEP_PX`, a set of fifteen panels stops 0.05 mm short, in a direction that depends on its
/// configuration; lowered, rounds are spent on rounding errors.
const REST_PX: f64 = 0.0005;
/// A small step that is longer than this fraction of the previous one is oscillating; treat it as
/// converged.
const NO_LONGER_SHRINKS: f64 = 0.8;
/// Rounds in which the smoothness is chosen: once the residuals are no longer those of a flat
/// stage, and again later.
const CHOOSING_ROUNDS: [usize; 3] = [2, 4, 6];
/// Curvature before the first choice: that of a wall.
const FIRST_CURVATURE: f64 = 0.03;
/// Candidate curvatures, per longer side, one sigma: from practically flat to sharp folds.
const CURVATURES: [f64; 8] = [0.0001, 0.003, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0];
/// Maximum ratio, as a natural logarithm, between the current curvature and the candidates tried
/// later.
const NEAR: f64 = 1.5;
/// Minimum relative reduction of the held-out tiles' cost for choosing a rougher shape.
const BETTER: f64 = 0.01;
/// The same while anchors are used, when only truly bent surfaces should bend. With 0.01 the flats
/// of the clip d-relief, once bent, were never found flat again, and stood 0.15 mm off instead of
/// 0.017. Raised, folds that tiles cannot reach stay.
const MUCH_BETTER: f64 = 0.2;
/// With several surfaces, minimum relative reduction of a surface's held-out cost for it not to be
/// flat. With 0.01 flats were bent by 0.1 mm, fitting residual errors of blur and borders, and
/// stood 0.016 degrees off. Raised, cloth that hangs 0.1 mm off a plane counts as flat.
const CLEARLY_BENT: f64 = 0.05;
/// One tile in this many is held out while the smoothness is chosen.
const HELD_OUT: u32 = 5;
/// Minimum fraction of frames that must still support the model after a step; below it the step
/// left the range in which the equations hold. Raised, people in front of the stage end a survey's
/// progress; lowered, an uninformative walk ends in a model that matches no frame.
const MIN_KEPT_SHARE: f64 = 0.5;
/// Factor by which such a step is shortened after it is undone; later steps grow by its inverse
/// square root until they are whole again. Nearer to 1, more rounds are lost; nearer to 0, good
/// steps are.
const SHORTER: f64 = 0.25;
/// Minimum fraction of a step: shortened three times in a row. Lowered, rounds are lost if the
/// frames are lost for another reason.
const SHORTEST: f64 = SHORTER * SHORTER * SHORTER;
/// Standard deviation of the readout around the configured one if the walk is to find it, seconds:
/// a sensor that reads slowly but is configured as a global shutter. Raised, walks that show the
/// readout are unaffected; lowered, slow sensors are taken for faster ones.
const READOUT_SIGMA_S: f64 = 0.02;
/// The same if the readout is held fixed: with few moving keyframes, and once it was found. Raised,
/// it drifts with the lens; much lower, the equations lose precision.
const KNOWN_READOUT_SIGMA_S: f64 = 1e-6;
/// Minimum number of keyframes with known rates for finding the readout; with fewer it stays as
/// configured. Chosen, not tuned: three for each lens parameter. Raised, short walks do not find
/// it; lowered, an uninformative one (a postcard in the hand, ten keyframes) finds -15 ms, and a
/// lens to match.
const MIN_WITH_RATES: usize = 24;
/// Factor on the covariances of independent tiles: neighbouring keyframes see the same tiles with
/// the same errors.
const INFLATION: f64 = 1.5;

/// The input and state of an adjustment.
pub struct Adjustment<'a> {
    observers: Observers<'a>,
    lens_sigmas: [f64; LENS_NUMBERS],
    readout_sigma_s: f64,
    constraints: Vec<Constraint>,
    smoothness: Smoothness,
    /// Whether the surfaces stay flat, so that no smoothness is chosen.
    keeps_flat: bool,
    /// What the frames showed with the stage as configured.
    at_start: ObservedFrames,
    last: Option<LastStep>,
}

/// The last step taken, and its starting point.
struct LastStep {
    model: StageModel,
    motions: Vec<Motion>,
    /// Number of frames that supported the model.
    frames: usize,
    step: DVector<f64>,
    /// The fraction of it that was taken.
    share: f64,
}

/// The adjusted model, what its frames showed, and the final equations.
#[derive(Debug)]
pub struct Adjusted {
    /// The model.
    pub model: StageModel,
    /// What each keyframe showed with it; `None` if it does not support the model.
    pub frames: Vec<Option<ObservedFrame>>,
    /// Robust scale of the residuals, in sigmas: the largest among the surfaces with enough tiles.
    pub scale: f64,
    /// The scale of each surface's residuals; infinite if its tiles determine nothing.
    pub scales: Vec<f64>,
    /// The support of each surface's pose.
    pub supports: Vec<Support>,
    /// Root mean square residual of the tiles with the start model, pixels; `None` if no frame
    /// supported it.
    pub start_rms_px: Option<f64>,
    /// The same with the adjusted model.
    pub rms_px: f64,
    /// Median error of the camera positions at the start, relative to now, after removing one rigid
    /// motion of the whole walk, metres; `None` if fewer than three frames supported the start.
    pub start_error_m: Option<f64>,
    /// Each measurement compared with the result.
    pub checks: Vec<ConstraintCheck>,
    /// Covariance of all unknowns.
    pub covariance: DMatrix<f64>,
    /// The final equations.
    pub equations: NormalEquations,
    /// Whether the readout was free.
    pub tells_readout: bool,
    /// Number of rounds.
    pub rounds: usize,
    /// Whether it converged.
    pub has_settled: bool,
}

impl<'a> Adjustment<'a> {
    /// Creates an adjustment of keyframes; `lens_sigmas` is the prior of the lens parameters.
    pub fn new(observers: Observers<'a>, lens_sigmas: [f64; LENS_NUMBERS], constraints: Vec<Constraint>) -> Self {
        let tells_readout = observers.with_rates() >= MIN_WITH_RATES;
        Self {
            observers,
            lens_sigmas,
            readout_sigma_s: if tells_readout { READOUT_SIGMA_S } else { KNOWN_READOUT_SIGMA_S },
            constraints,
            smoothness: Smoothness::even(0, FIRST_CURVATURE),
            keeps_flat: false,
            at_start: Vec::new(),
            last: None,
        }
    }

    /// Makes the surfaces stay flat, for a model that was made so.
    pub fn keeping_flat(mut self, keeps_flat: bool) -> Self {
        self.keeps_flat = keeps_flat;
        self
    }

    fn rows(&self, model: &StageModel, frames: &[Option<ObservedFrame>]) -> Vec<FrameRows> {
        let of_frame = |(k, frame): (usize, &Option<ObservedFrame>)| {
            let Some(frame) = frame else { return FrameRows::default() };
            let distance_m = distance_m(&model.surfaces, &frame.motion.pose);
            FrameRows::new(frame, model, distance_m, |tile| is_held_out(k, tile))
        };
        frames.iter().enumerate().map(of_frame).filter(|rows| !rows.rows().is_empty()).collect()
    }

    /// Adjusts a model. `progress` is called with the number of each round before it. Returns
    /// `None` if the equations have no solution, or the work was stopped.
    pub fn run(&mut self, start: StageModel, mut progress: impl FnMut(usize)) -> Option<Adjusted> {
        self.at_start = self.observers.tiles(&start)?;
        let mut model = start;
        let curvature = if self.keeps_flat { CURVATURES[0] } else { FIRST_CURVATURE };
        self.smoothness = Smoothness::even(model.surfaces.len(), curvature);
        self.last = None;
        let mut round = 0;
        while round < FEATURE_ROUNDS + ANCHOR_ROUNDS {
            progress(round);
            let anchors_at = round.checked_sub(FEATURE_ROUNDS);
            let frames = match anchors_at {
                None => self.observers.features(&model)?,
                Some(n) => self.observers.anchors(&model, 2 * n < ANCHOR_ROUNDS)?,
            };
            let rows = self.rows(&model, &frames);
            if let Some(nearer) = self.taken_back(rows.len()) {
                model = nearer;
                continue;
            }
            round += 1;
            let Some(scales) = robust_scales(&rows, model.surfaces.len()) else { continue };
            if anchors_at.is_some_and(|n| n > 0) && !self.keeps_flat {
                self.choose_rough_smoothness(&model, &rows, &scales)?;
            }
            let step = self.step(&model, &rows, &scales)?;
            tracing::debug!(round, frames = rows.len(), ?scales, rms_px = rms_px(&frames), step_px = step_px(&rows, &step), "rough");
            model = self.stepped(&model, step, rows.len())?;
        }
        self.settle(model, progress)
    }

    /// Returns each surface's root mean square height that its spline does not show, metres. `None`
    /// if the work was stopped meanwhile.
    pub fn unmodelled_m(&mut self, model: &StageModel) -> Option<Vec<f64>> {
        Some(unmodelled_m(self.observers.cells(model)?.iter().flatten(), model.surfaces.len()))
    }

    /// Readjusts a model with another shutter. See [`run`](Self::run).
    pub fn run_with_shutter(&mut self, model: StageModel, shutter: Shutter, progress: impl FnMut(usize)) -> Option<Adjusted> {
        self.readout_sigma_s = KNOWN_READOUT_SIGMA_S;
        self.last = None;
        self.observers.take_shutter(&model, shutter);
        self.settle(model.with_readout(shutter.readout_s), progress)
    }

    /// Readjusts a model after some keyframes' rates (by their number in the walk) are known
    /// better. `exposure_s` is the exposure as far as known.
    pub fn run_with_rates(
        &mut self,
        model: StageModel,
        rates: &[(usize, KnownRates)],
        exposure_s: f64,
        progress: impl FnMut(usize),
    ) -> Option<Adjusted> {
        self.last = None;
        self.observers.take_rates(rates);
        self.observers.take_shutter(&model, Shutter { readout_s: model.readout_s(), exposure_s });
        self.settle(model, progress)
    }

    /// Aligns on grey values until the model converges.
    fn settle(&mut self, mut model: StageModel, mut progress: impl FnMut(usize)) -> Option<Adjusted> {
        let mut before_px = f64::INFINITY;
        for round in 0..MAX_ROUNDS {
            progress(FEATURE_ROUNDS + ANCHOR_ROUNDS + round);
            let frames = self.observers.tiles(&model)?;
            let rows = self.rows(&model, &frames);
            if let Some(nearer) = self.taken_back(rows.len()).filter(|_| round + 1 < MAX_ROUNDS) {
                model = nearer;
                continue;
            }
            let scales = robust_scales(&rows, model.surfaces.len())?;
            if CHOOSING_ROUNDS.contains(&round) && !self.keeps_flat {
                self.choose_smoothness(&model, &rows, &scales, round == CHOOSING_ROUNDS[0])?;
            }
            let equations = self.equations(&model, &rows, &scales)?;
            let factor = Factor::of(&equations.matrix)?;
            let step = factor.solve(&equations.right);
            let step_px = step_px(&rows, &step);
            let left_px = rms_px(&frames);
            tracing::debug!(round, frames = rows.len(), unknowns = step.len(), ?scales, left_px, step_px, readout_s = model.readout_s(), curvatures = ?self.smoothness.curvatures, is_stretched = self.smoothness.is_stretched, "fine");
            let is_at_rest = round > CHOOSING_ROUNDS[1] && is_rest(step_px, before_px);
            before_px = step_px;
            if is_at_rest || round + 1 == MAX_ROUNDS {
                let (has_settled, rms_px) = (step_px < SMALL_STEP_PX, left_px);
                let start_rms_px = self.at_start.iter().flatten().next().map(|_| self::rms_px(&self.at_start));
                let start_error_m = start_error_m(&self.at_start, &frames);
                let covariance = factor.inverse();
                let checks = constraints::check(&self.constraints, &model, &covariance);
                let covariance = covariance * INFLATION;
                let supports = supports(&rows, &scales);
                tracing::debug!(?scales, ?supports, "at rest");
                let informative = scales.iter().zip(&supports).filter(|(_, support)| !support.is_little());
                return Some(Adjusted {
                    checks,
                    model,
                    frames,
                    scale: informative.map(|(scale, _)| *scale).fold(0.0, f64::max),
                    scales,
                    supports,
                    start_rms_px,
                    rms_px,
                    tells_readout: self.readout_sigma_s > KNOWN_READOUT_SIGMA_S,
                    start_error_m,
                    covariance,
                    equations,
                    rounds: round + 1,
                    has_settled,
                });
            }
            model = self.stepped(&model, step, rows.len())?;
        }
        None
    }

    /// Returns a model after a step supported by `frames` frames, or after a part of the step if
    /// the last ones were too long. `None` if the result is not a valid stage.
    fn stepped(&mut self, model: &StageModel, step: DVector<f64>, frames: usize) -> Option<StageModel> {
        let share = self.last.as_ref().map_or(1.0, |last| (last.share / SHORTER.sqrt()).min(1.0));
        let next = if share < 1.0 { model.stepped(&(&step * share)) } else { model.stepped(&step) };
        self.last = Some(LastStep { model: model.clone(), motions: self.observers.motions(), frames, step, share });
        next
    }

    /// Undoes the last step and takes a shorter one if too few frames support the result.
    fn taken_back(&mut self, frames: usize) -> Option<StageModel> {
        let last = self.last.as_mut()?;
        if frames as f64 >= MIN_KEPT_SHARE * last.frames as f64 {
            return None;
        }
        self.observers.put_back(&last.motions);
        if last.share <= SHORTEST {
            // They are lost for another reason: take the whole step.
            (last.share, last.frames) = (1.0, 0);
            return last.model.stepped(&last.step);
        }
        last.share *= SHORTER;
        tracing::debug!(frames, before = last.frames, share = last.share, "the step was too long");
        last.model.stepped(&(&last.step * last.share))
    }

    fn step(&self, model: &StageModel, rows: &[FrameRows], scales: &[f64]) -> Option<DVector<f64>> {
        let equations = self.equations(model, rows, scales)?;
        Some(Factor::of(&equations.matrix)?.solve(&equations.right))
    }

    /// Returns the equations of all tiles with the priors.
    fn equations(&self, model: &StageModel, rows: &[FrameRows], scales: &[f64]) -> Option<NormalEquations> {
        let data = NormalEquations::new(rows, model.places().count, scales, true)?;
        Some(self.with_priors(data, model, &self.smoothness))
    }

    /// Adds the priors for a smoothness to the equations of tiles, and makes them symmetric.
    fn with_priors(&self, mut equations: NormalEquations, model: &StageModel, smoothness: &Smoothness) -> NormalEquations {
        prior::add(
            model,
            smoothness,
            &self.lens_sigmas,
            self.readout_sigma_s,
            &self.constraints,
            &mut equations.matrix,
            &mut equations.right,
        );
        equations.matrix.fill_upper_triangle_with_lower_triangle();
        equations
    }

    /// Lets surfaces bend if the anchors clearly show that they do. Returns `None` if the work was
    /// stopped meanwhile.
    fn choose_rough_smoothness(&mut self, model: &StageModel, rows: &[FrameRows], scales: &[f64]) -> Option<()> {
        let Some(data) = NormalEquations::new(rows, model.places().count, scales, false) else { return Some(()) };
        let n = model.surfaces.len();
        let mut tried: Vec<(f64, f64)> = Vec::new();
        for curvature in CURVATURES.into_iter().filter(|curvature| *curvature >= FIRST_CURVATURE) {
            self.observers.go_on().then_some(())?;
            let equations = self.with_priors(data.clone(), model, &Smoothness::even(n, curvature));
            let Some(factor) = Factor::of(&equations.matrix) else { continue };
            let cost = equations.held_out_costs(rows, &factor.solve(&equations.right), scales).iter().sum::<f64>();
            tracing::debug!(curvature, cost, "rough smoothness");
            tried.push((cost, curvature));
        }
        let least = tried.iter().map(|(cost, _)| *cost).fold(f64::INFINITY, f64::min);
        // The smoothest one that no rougher one clearly beats.
        let chosen = tried.into_iter().find(|(cost, _)| (1.0 - MUCH_BETTER) * cost <= least);
        if let Some((_, curvature)) = chosen.filter(|(_, curvature)| *curvature > FIRST_CURVATURE) {
            self.smoothness = Smoothness::even(n, curvature);
        }
        self.observers.go_on().then_some(())
    }

    /// Chooses the smoothness that predicts held-out tiles best: first one for all surfaces, then
    /// for each surface whether flat does as well. Returns `None` if the work was stopped
    /// meanwhile.
    fn choose_smoothness(&mut self, model: &StageModel, rows: &[FrameRows], scales: &[f64], is_first: bool) -> Option<()> {
        let Some(data) = NormalEquations::new(rows, model.places().count, scales, false) else { return Some(()) };
        let n = model.surfaces.len();
        let costs = |smoothness: &Smoothness| -> Option<Vec<f64>> {
            if !self.observers.go_on() {
                return None;
            }
            let equations = self.with_priors(data.clone(), model, smoothness);
            let step = Factor::of(&equations.matrix)?.solve(&equations.right);
            Some(equations.held_out_costs(rows, &step, scales))
        };
        // After the first choice only its neighbours are tried.
        let usual = self.smoothness.curvatures.iter().copied().fold(0.0, f64::max);
        let is_near = |curvature: f64| is_first || (curvature / usual).ln().abs() < NEAR;
        let tried = CURVATURES.into_iter().filter(|curvature| is_near(*curvature)).filter_map(|curvature| {
            let smoothness = Smoothness { is_stretched: self.smoothness.is_stretched, ..Smoothness::even(n, curvature) };
            let cost = costs(&smoothness)?.iter().sum::<f64>();
            tracing::debug!(curvature, cost, "smoothness");
            Some((cost, smoothness))
        });
        let tried: Vec<(f64, Smoothness)> = tried.collect();
        // The smoothest of those that do as well as the best.
        let least = tried.iter().map(|(cost, _)| *cost).fold(f64::INFINITY, f64::min);
        let mut tried = tried.into_iter();
        let Some((_, mut best)) = tried.find(|(cost, _)| (1.0 - BETTER) * cost <= least) else {
            return self.observers.go_on().then_some(());
        };
        let [rigid, stretched] = [false, true].map(|is_stretched| Smoothness { is_stretched, ..best.clone() });
        if let (Some(rigid_costs), Some(costs)) = (costs(&rigid), costs(&stretched)) {
            let [rigid_cost, cost] = [rigid_costs, costs].map(|costs| costs.iter().sum::<f64>());
            tracing::debug!(rigid_cost, cost, "stretch");
            best = if cost < (1.0 - BETTER) * rigid_cost { stretched } else { rigid };
        }
        if let (true, Some(bent)) = (n > 1 && !is_first, costs(&best)) {
            for k in 0..n {
                let flat = best.with(k, CURVATURES[0]);
                if costs(&flat).is_some_and(|flat| flat[k] * (1.0 - CLEARLY_BENT) <= bent[k]) {
                    best = flat;
                }
            }
        }
        self.smoothness = best;
        self.observers.go_on().then_some(())
    }
}

/// Whether a step shows that the model has converged, given the previous step `before_px`.
fn is_rest(step_px: f64, before_px: f64) -> bool {
    step_px < REST_PX || step_px < SMALL_STEP_PX && step_px > NO_LONGER_SHRINKS * before_px
}

/// Whether a tile is held out: a fixed pseudo-random choice by frame, tile and surface.
fn is_held_out(frame: usize, tile: &ObservedTile) -> bool {
    let mixed = (frame as u32).wrapping_mul(0x9e37_79b1)
        ^ (tile.number + 1).wrapping_mul(0x85eb_ca77)
        ^ (tile.surface as u32).wrapping_mul(0xc2b2_ae3d);
    (mixed ^ (mixed >> 15)).wrapping_mul(0x2c1b_3c6d) >> 8 & 0xffff < 0xffff / HELD_OUT
}

/// Returns the root mean square residual of the tiles, pixels, without the largest twentieth, which
/// are outliers.
fn rms_px(frames: &[Option<ObservedFrame>]) -> f64 {
    let mut squares: Vec<f64> = frames.iter().flatten().flat_map(|f| &f.tiles).map(|t| t.shift_px.norm_squared()).collect();
    squares.sort_by(f64::total_cmp);
    let n = squares.len() - squares.len() / 20;
    (squares[..n].iter().sum::<f64>() / n.max(1) as f64).sqrt()
}

/// See [`Adjusted::start_error_m`].
fn start_error_m(start: &[Option<ObservedFrame>], now: &[Option<ObservedFrame>]) -> Option<f64> {
    let pairs: Vec<_> = start.iter().zip(now).filter_map(|(a, b)| Some((a.as_ref()?.motion.pose, b.as_ref()?.motion.pose))).collect();
    if pairs.len() < 3 {
        return None;
    }
    let mean = pairs.iter().map(|(a, b)| b.rotation_matrix() * a.rotation_matrix().transpose()).sum::<Matrix3<f64>>();
    let rotation = UnitQuaternion::from_matrix(&mean);
    let shift = pairs.iter().map(|(a, b)| b.translation - rotation * a.translation).sum::<Vector3<f64>>() / pairs.len() as f64;
    let mut errors: Vec<f64> = pairs.iter().map(|(a, b)| (rotation * a.translation + shift - b.translation).norm()).collect();
    errors.sort_by(f64::total_cmp);
    Some(errors[errors.len() / 2])
}

fn step_px(rows: &[FrameRows], step: &DVector<f64>) -> f64 {
    let moved: Vec<f64> = rows.iter().flat_map(FrameRows::rows).map(|r| r.moved_squared(step)).collect();
    (moved.iter().sum::<f64>() / moved.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shrinking_steps_do_not_count_as_converged() {
        // A set of fifteen panels: each step leaves four to seven tenths of the previous error.
        let steps = [0.04, 0.0094, 0.0113, 0.0040, 0.0027, 0.0011, 0.0007, 0.0003];
        let rests: Vec<bool> = steps.windows(2).map(|pair| is_rest(pair[1], pair[0])).collect();
        assert_eq!(rests, [false, false, false, false, false, false, true]);
        // Oscillating: converged if the step is small, not if it is large.
        assert!(is_rest(0.0031, 0.0033) && is_rest(0.0033, 0.0031));
        assert!(!is_rest(0.031, 0.033) && !is_rest(0.009, f64::INFINITY));
    }
}
