//! A level that was solved: what only a solution can be asked.

use nalgebra::{Matrix6, Vector6};

use super::{Corrected, LevelProblem, LevelSpec};
use crate::camera::Shutter;
use crate::geometry::resection::larger_covariance;
use crate::motion::{MotionError, MotionEstimate};
use crate::track::align::kernel::evidence::evidence;
use crate::track::align::kernel::normal::{RobustWeighting, squares_after};
use crate::track::align::kernel::tile_equations::TileStep;
use crate::track::align::learned::noise::NoiseSums;
use crate::track::align::solve::aperture::GradientAgreement;
use crate::track::align::solve::jump_instant::RowBands;
use crate::track::align::solve::shutter_clue::ReadoutClue;
use crate::track::align::solve::system::schur_complement::{SchurComplement, SolvedTile};
use crate::track::align::solve::verdict::agreement;
use crate::track::frame::frame_levels::Level;

/// Largest squared residual that counts, sigmas²: beyond three sigmas a pixel shows something else, and its size says nothing of the fit.
/// Raised, what stands in front of the stage has a say in how pictures were enlarged.
const MAX_MISFIT: f32 = 9.0;

/// A solved level.
pub struct LevelSolution<'a> {
    /// Where its linearisation led.
    pub found: Corrected,
    pub(super) problem: &'a mut LevelProblem,
}

/// What the tiles of a solved level say of it.
#[derive(Debug, Clone, Copy)]
pub struct Conclusion {
    /// The motion, and what noise and expectation leave open of it.
    pub estimate: MotionEstimate,
    /// Covariance of the pose: by noise, or by the scatter of the tiles' votes where that is larger.
    pub covariance: Matrix6<f64>,
    /// Pixels that fit, and their squared residuals over squared gradients, pixels².
    pub inliers: f64,
    /// See `inliers`.
    pub squared_px: f64,
    /// Tiles with detail, and those that agree.
    pub tiles: usize,
    /// See `tiles`.
    pub agreeing: usize,
    /// Sums of what the tiles say of blur and point spread, as in their evidence.
    pub blur: [f64; 5],
}

/// How far the votes of single tiles scatter, which are not as independent as their pixels.
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

    /// Covariance of what was voted on: by noise, or by the scatter where that is larger. `None` where that by noise is singular.
    pub fn or_noise(&self, by_noise: &Matrix6<f64>) -> Option<Matrix6<f64>> {
        let n = self.votes;
        let factor = if n > 7.0 { n / (n - 6.0) } else { 7.0 };
        larger_covariance(by_noise, &(self.squares * factor))
    }
}

/// A pixel that alignment asked, as the solution left it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UsedPixel {
    /// Its centre, pixels of the frame (it covers two by two of them).
    pub centre_px: [f32; 2],
    /// Size of its residual in robust standard deviations; beyond 4.7 it counts nothing.
    pub sigmas: f32,
    /// Whether its tile takes part: tiles that show something else do not.
    pub takes_part: bool,
}

impl LevelSolution<'_> {
    /// The motion, and what noise and expectation leave open of it.
    pub fn estimate(&mut self) -> MotionEstimate {
        let (covariance, _) = self.problem.system.covariance();
        MotionEstimate { motion: self.found.motion, covariance }
    }

    /// Concludes from all tiles; keeps each one's evidence with it, and fills `bands` with what the open ones say. `None` where the covariance is
    /// singular.
    pub fn conclude(&mut self, spec: &LevelSpec, bands: &mut RowBands) -> Option<Conclusion> {
        let Corrected { motion, scale } = self.found;
        let weighting = RobustWeighting { scale, is_first_pass: false, stride: 1 };
        let weight = scale.powi(-2);
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

    /// Mean squared residual that the last step left, sigmas squared; each counts as [`MAX_MISFIT`] at most.
    pub fn misfit(&mut self) -> f64 {
        let squares = self.problem.squares(1);
        squares.iter().map(|s| f64::from(s.min(MAX_MISFIT))).sum::<f64>() / squares.len().max(1) as f64
    }

    /// What the open runs say of the noise, as the last step leaves them.
    pub fn noise_sums(&self) -> NoiseSums {
        let LevelProblem { picture, runs, .. } = &*self.problem;
        let weighting = RobustWeighting { scale: self.found.scale, is_first_pass: false, stride: self.problem.rough_stride() };
        let mut sums = NoiseSums::default();
        for r in runs.iter().filter(|r| r.gate.is_open) {
            sums.add(&picture.view(r), &r.step.columns, &weighting);
        }
        sums
    }

    /// How the gradients go together at the chosen pixels, once it is [concluded](Self::conclude) which tiles agree; `level`: the frame's.
    pub fn gradient_agreement(&self, level: &Level) -> GradientAgreement {
        let LevelProblem { picture, runs, .. } = &*self.problem;
        let mut gradients = GradientAgreement::default();
        for r in runs {
            gradients.add(&r.run, agreement(&r.evidence) == Some(true), &picture.pixels, &picture.appearance, level);
        }
        gradients
    }

    /// What the frame says of the time in which the sensor's rows are read. `pull`: the information of the expected motion, times the derivative of that motion by the
    /// readout.
    ///
    /// The expectation comes from frames that were solved with the same readout: with another one they would have led elsewhere. So a change of the readout moves the
    /// rows and the expectation at once (Friedland 1969, "Treatment of bias in recursive filtering"), and only a part of it shows.
    pub fn readout_clue(&self, spec: &LevelSpec, pull: &MotionError, column: &mut SchurComplement) -> ReadoutClue {
        let Corrected { motion, scale } = self.found;
        let LevelProblem { picture, runs, system, .. } = &*self.problem;
        // A second more of readout delays a row by as much as a sensor of one second's readout does.
        let slow = Shutter { readout_s: 1.0, ..*spec.shutter };
        column.begin(system);
        for r in runs.iter().filter(|r| r.gate.is_open) {
            let time = picture.time(spec, &r.run);
            let row = picture.pixels.place[1][((r.run.start + r.run.end) / 2) as usize];
            let share = slow.delay_s(spec.frame_y(row as f64), spec.rays.camera().height());
            let velocity = motion.velocity + motion.acceleration * time.delay_s;
            let turn_rate = motion.turn_rate + motion.turn_acceleration * time.delay_s;
            // Later rows of the tile are delayed the more, by the share of a readout that lies between them.
            let per_second = if spec.shutter.readout_s > 0.0 { 1.0 / spec.shutter.readout_s } else { 0.0 };
            let mut by_readout = TileStep::default();
            for (c, speed) in velocity.iter().chain(&turn_rate).enumerate() {
                by_readout.columns[c] = (speed * share) as f32;
                by_readout.rate[c] = (speed * per_second) as f32;
            }
            let nodes = picture.pixels.light().nodes_of(r.run.tile);
            let tile = SolvedTile { equations: &r.equations, step: &r.step, nodes, time, weight: scale.powi(-2) };
            column.add(system, &tile, &by_readout);
        }
        let clue = column.finish(system);
        let (hidden, motion_by_readout) = column.with_pull(system, pull);
        ReadoutClue { clue, shown: (1.0 + hidden / clue.information).max(0.0), motion_by_readout }
    }

    /// Adds the pixels of the level that tell something, for pictures that show what the tracker saw.
    pub fn used_pixels(&self, level: usize, out: &mut Vec<UsedPixel>) {
        let LevelProblem { picture, runs, .. } = &*self.problem;
        let n = (1u32 << level) as f32;
        let mut squares = Vec::new();
        for r in runs {
            squares.clear();
            squares_after(&picture.view(r), &r.step.columns, 1, &mut squares);
            // Those that tell something, as the squares are.
            let told = r.run.range().filter(|k| picture.residuals.information[*k] > 0.0);
            out.extend(told.zip(&squares).map(|(k, square)| UsedPixel {
                centre_px: [0, 1].map(|axis| n * picture.pixels.place[axis][k] + 0.5 * (n - 1.0)),
                sigmas: square.sqrt() / self.found.scale as f32,
                takes_part: r.gate.is_open,
            }));
        }
    }
}
