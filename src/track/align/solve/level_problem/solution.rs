//! A solved level, with the queries that only a solution can answer: the estimate and its
//! covariance, agreement of tiles, noise, gradients, the clue on the readout, and the pixels used.

use crate::track::align::tuning::TUNING;
use nalgebra::{Matrix6, Vector6};

use super::{Corrected, LevelProblem, LevelSpec};
use crate::camera::Shutter;
use crate::geometry::resection::larger_covariance;
use crate::light::CameraCurve;
use crate::motion::{MotionError, MotionEstimate};
use crate::track::align::kernel::evidence::evidence;
use crate::track::align::kernel::normal::{RobustWeighting, squares_after};
use crate::track::align::kernel::tile_equations::TileStep;
use crate::track::align::learned::camera_curve::CurveSums;
use crate::track::align::learned::noise::NoiseSums;
use crate::track::align::solve::aperture::GradientAgreement;
use crate::track::align::solve::jump_instant::RowBands;
use crate::track::align::solve::shutter_clue::ReadoutClue;
use crate::track::align::solve::system::schur_complement::{SchurComplement, SolvedTile};
use crate::track::align::solve::verdict::agreement;
use crate::track::frame::light_levels::LightLevel;

/// A solved level.
pub struct LevelSolution<'a> {
    /// The result of its linearisation.
    pub found: Corrected,
    pub(super) problem: &'a mut LevelProblem,
}

/// Conclusions from the tiles of a solved level.
#[derive(Debug, Clone, Copy)]
pub struct Conclusion {
    /// The motion, with its covariance by noise and prior.
    pub estimate: MotionEstimate,
    /// Covariance of the pose: by noise, or by the scatter of the tiles' votes where that is
    /// larger.
    pub covariance: Matrix6<f64>,
    /// Number of pixels that fit, and the sum of their squared residuals over squared gradients,
    /// pixels² of the level.
    pub inliers: f64,
    /// See `inliers`.
    pub squared_px: f64,
    /// Number of runs (a surface's part of a tile) with detail, and of those that agree.
    pub tiles: usize,
    /// See `tiles`.
    pub agreeing: usize,
    /// Sums over the tiles' evidence on blur and point spread.
    pub blur: [f64; 5],
}

/// The scatter of single tiles' votes. Tiles are less independent than their pixels suggest.
#[derive(Debug, Default)]
pub struct VoteScatter {
    squares: Matrix6<f64>,
    votes: f64,
}

impl VoteScatter {
    /// Adds a tile's vote.
    pub fn add(&mut self, vote: &Vector6<f64>) {
        self.squares += vote * vote.transpose();
        self.votes += 1.0;
    }

    /// Returns the covariance of what was voted on: by noise, or by the scatter where that is
    /// larger. `None` where that by noise is singular.
    pub fn or_noise(&self, by_noise: &Matrix6<f64>) -> Option<Matrix6<f64>> {
        let n = self.votes;
        let factor = if n > 7.0 { n / (n - 6.0) } else { 7.0 };
        larger_covariance(by_noise, &(self.squares * factor))
    }
}

/// A pixel used by alignment, with its residual at the solution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UsedPixel {
    /// Its centre, pixels of the frame (it covers two by two of them).
    pub centre_px: [f32; 2],
    /// Absolute residual in robust standard deviations; beyond 4.7 the pixel has no weight.
    pub sigmas: f32,
    /// Whether its tile takes part; tiles that show something else do not.
    pub takes_part: bool,
}

impl LevelSolution<'_> {
    /// Returns the motion, with its covariance by noise and prior.
    pub fn estimate(&mut self) -> MotionEstimate {
        let (covariance, _) = self.problem.system.covariance();
        MotionEstimate { motion: self.found.motion, covariance }
    }

    /// Concludes from all tiles. Stores each one's evidence with it, and fills `bands` with the
    /// equations of the open ones. `None` where the covariance is singular.
    pub fn conclude(&mut self, spec: &LevelSpec, bands: &mut RowBands) -> Option<Conclusion> {
        let Corrected { motion, residual_sigma, weight, .. } = self.found;
        let weighting = RobustWeighting { residual_sigma, is_first_pass: false, stride: 1 };
        let LevelProblem { picture, runs, system, .. } = &mut *self.problem;
        let (covariance, votes) = system.covariance();
        let mut scatter = VoteScatter::default();
        let (mut inliers, mut squared_px, mut tiles, mut agreeing, mut blur) = (0.0, 0.0, 0, 0, [0.0; 5]);
        for r in runs {
            if r.gate.is_open {
                let nodes = picture.pixels.light().nodes_of(r.run.tile);
                let (time, left) = (picture.time(spec, &r.run), r.equations.left_by(&r.step));
                bands.add(&r.equations, &left, time.delay_s, weight);
                scatter.add(&votes.of_tile(&left, nodes, &time, weight));
            }
            r.evidence = evidence(&picture.view(r), &r.step.columns, &weighting);
            inliers += r.evidence.inliers;
            squared_px += r.evidence.squared_px;
            let agrees = agreement(&r.evidence);
            tiles += usize::from(agrees.is_some());
            agreeing += usize::from(agrees == Some(true));
            blur.iter_mut().zip(r.evidence.blur).for_each(|(sum, value)| *sum += value);
        }
        let by_noise: Matrix6<f64> = covariance.fixed_view::<6, 6>(0, 0).into_owned();
        let estimate = MotionEstimate { motion, covariance };
        let covariance = scatter.or_noise(&by_noise)?;
        Some(Conclusion { estimate, covariance, inliers, squared_px, tiles, agreeing, blur })
    }

    /// Returns the mean squared residual that the last step left, sigmas²; each counts as
    /// `max_squared_misfit` at most.
    pub fn misfit(&mut self) -> f64 {
        let squares = self.problem.squares(1);
        squares.iter().map(|s| f64::from(s.min(TUNING.max_squared_misfit))).sum::<f64>() / squares.len().max(1) as f64
    }

    /// Returns the open runs' sums for learning the noise, with the residuals of the last step.
    pub fn noise_sums(&self) -> NoiseSums {
        let LevelProblem { picture, runs, .. } = &*self.problem;
        let weighting =
            RobustWeighting { residual_sigma: self.found.residual_sigma, is_first_pass: false, stride: self.problem.rough_stride() };
        let mut sums = NoiseSums::default();
        for r in runs.iter().filter(|r| r.gate.is_open) {
            sums.add(&picture.view(r), &r.step.columns, &weighting);
        }
        sums
    }

    /// Returns the open runs' sums for learning the camera's curve, one run in several, with the
    /// residuals of the last step. `curve`: the one by which the frame was decoded.
    pub fn curve_sums(&self, curve: &CameraCurve) -> CurveSums {
        let LevelProblem { picture, runs, .. } = &*self.problem;
        let weighting = RobustWeighting { residual_sigma: self.found.residual_sigma, is_first_pass: false, stride: 1 };
        let mut sums = CurveSums::default();
        let stride = (picture.pixels.len() / TUNING.max_curve_pixels).max(1);
        for r in runs.iter().filter(|r| r.gate.is_open).step_by(stride) {
            sums.add(&picture.view(r), &r.step.columns, &weighting, curve);
        }
        sums
    }

    /// Returns how observed and expected gradients agree at the selected pixels. Requires
    /// [`conclude`](Self::conclude), which determines the tiles that agree. `level`: the frame's.
    pub fn gradient_agreement(&self, level: LightLevel) -> GradientAgreement {
        let LevelProblem { picture, runs, .. } = &*self.problem;
        let mut gradients = GradientAgreement::default();
        for r in runs {
            gradients.add(&r.run, agreement(&r.evidence) == Some(true), &picture.pixels, &picture.appearance, level);
        }
        gradients
    }

    /// Returns the frame's clue on the readout time. `pull`: the information of the predicted
    /// motion, times the derivative of that motion by the readout.
    ///
    /// The prediction comes from frames that were solved with the same readout; with another one it
    /// would be different. So a change of the readout moves the rows and the prediction at once
    /// (Friedland 1969, "Treatment of bias in recursive filtering"), and only a part of it shows.
    pub fn readout_clue(&self, spec: &LevelSpec, pull: &MotionError, column: &mut SchurComplement) -> ReadoutClue {
        let Corrected { motion, weight, .. } = self.found;
        let LevelProblem { picture, runs, system, .. } = &*self.problem;
        // One second more of readout delays a row by as much as a sensor with a readout of one
        // second does.
        let slow = Shutter { readout_s: 1.0, ..*spec.shutter };
        column.begin(system);
        for r in runs.iter().filter(|r| r.gate.is_open) {
            let time = picture.time(spec, &r.run);
            let row = picture.pixels.place[1][((r.run.start + r.run.end) / 2) as usize];
            let share = slow.delay_s(spec.frame_y(row as f64), spec.rays.camera().height());
            let velocity = motion.velocity + motion.acceleration * time.delay_s;
            let angular_velocity = motion.angular_velocity + motion.angular_acceleration * time.delay_s;
            // Later rows of the tile are delayed more, by the fraction of the readout between them.
            let per_second = if spec.shutter.readout_s > 0.0 { 1.0 / spec.shutter.readout_s } else { 0.0 };
            let mut by_readout = TileStep::default();
            for (c, speed) in velocity.iter().chain(&angular_velocity).enumerate() {
                by_readout.columns[c] = (speed * share) as f32;
                by_readout.rate[c] = (speed * per_second) as f32;
            }
            let nodes = picture.pixels.light().nodes_of(r.run.tile);
            let tile = SolvedTile { equations: &r.equations, step: &r.step, nodes, time, weight };
            column.add(system, &tile, &by_readout);
        }
        let clue = column.finish(system);
        let (hidden, motion_by_readout) = column.with_pull(system, pull);
        ReadoutClue { clue, shown: (1.0 + hidden / clue.information).max(0.0), motion_by_readout }
    }

    /// Appends the level's pixels that carry information, for pictures that show what the tracker
    /// used.
    pub fn used_pixels(&self, level: usize, out: &mut Vec<UsedPixel>) {
        let LevelProblem { picture, runs, .. } = &*self.problem;
        let n = (1u32 << level) as f32;
        let mut squares = Vec::new();
        for r in runs {
            squares.clear();
            squares_after(&picture.view(r), &r.step.columns, 1, &mut squares);
            // The same pixels as those of `squares`.
            let informative = r.run.range().filter(|k| picture.residuals.information[*k] > 0.0);
            out.extend(informative.zip(&squares).map(|(k, square)| UsedPixel {
                centre_px: [0, 1].map(|axis| n * picture.pixels.place[axis][k] + 0.5 * (n - 1.0)),
                sigmas: square.sqrt() / self.found.residual_sigma as f32,
                takes_part: r.gate.is_open,
            }));
        }
    }
}
