//! The normal equations of a survey: all frames' tiles, with the frames' own unknowns eliminated (Schur complement).
//!
//! A tile ties its frame's motion to a few of the model's numbers. Motions of different frames have nothing to do with each other, so each
//! frame's twelve are eliminated by themselves, and one dense system of the model's numbers is left. Source: Triggs et al., *Bundle
//! Adjustment - A Modern Synthesis* (2000), section 6.1.

use nalgebra::{DMatrix, DVector, Matrix2, SMatrix, SVector, Vector2};

use super::stage_model::StageModel;
use super::tile_derivatives::{FRAME_UNKNOWNS, TileDerivatives};
use crate::geometry::robust_kernel::tukey_weight;
use crate::motion::{Motion, unseen};
use crate::track::{KnownRates, ObservedFrame, ObservedTile};

/// What no tile tells better, pixels, one sigma along each axis: what is left of the light, the print and the lens. (research: 0.015.) Raised, tiles
/// with much detail count no more than others; lowered, they are believed too much.
const FLOOR_PX: f64 = 0.015;
/// One sigma of a frame's pose about where it was aligned, metres and radians: none that matters, but frames with few tiles stay solvable.
const POSE_SIGMA: f64 = 0.3;

type FrameMatrix = SMatrix<f64, FRAME_UNKNOWNS, FRAME_UNKNOWNS>;
type FrameVector = SVector<f64, FRAME_UNKNOWNS>;

/// A tile as the equations see it.
#[derive(Debug, Clone)]
pub struct TileRow {
    derivatives: TileDerivatives,
    /// What the model leaves of it, pixels.
    residual: Vector2<f64>,
    information: Matrix2<f64>,
    /// Index of its surface.
    pub surface: usize,
    /// Whether it is kept for judging.
    pub is_held_out: bool,
}

/// A frame's tiles.
#[derive(Debug, Clone, Default)]
pub struct FrameRows {
    rows: Vec<TileRow>,
    /// Information of the frame's unknowns beside the tiles, and what it says of them.
    prior: FrameMatrix,
    prior_right: FrameVector,
}

/// The system of the model's numbers.
#[derive(Debug, Clone)]
pub struct NormalEquations {
    /// Information.
    pub matrix: DMatrix<f64>,
    /// Score: the solution is matrix⁻¹ right.
    pub right: DVector<f64>,
    frames: Vec<EliminatedFrame>,
}

/// What gives a frame's unknowns back.
#[derive(Debug, Clone)]
struct EliminatedFrame {
    inverse: FrameMatrix,
    right: FrameVector,
    coupling: DMatrix<f64>,
}

impl TileRow {
    /// Residual after a step, squared, in sigmas.
    fn squared(&self, by_frame: &FrameVector, step: &DVector<f64>) -> f64 {
        let mut left = self.residual - self.derivatives.by_frame * by_frame;
        for (k, d) in &self.derivatives.by_model {
            left -= d * step[*k];
        }
        left.dot(&(self.information * left))
    }

    /// How far a step of the model alone moves the tile, pixels, squared.
    pub fn moved_squared(&self, step: &DVector<f64>) -> f64 {
        self.derivatives.by_model.iter().map(|(k, d)| d * step[*k]).sum::<Vector2<f64>>().norm_squared()
    }

    /// The same before any step.
    pub fn squared_now(&self) -> f64 {
        self.residual.dot(&(self.information * self.residual))
    }
}

impl FrameRows {
    /// Of what a frame showed. `holds_out`: tiles to judge by.
    pub fn new(frame: &ObservedFrame, model: &StageModel, distance_m: f64, holds_out: impl Fn(&ObservedTile) -> bool) -> Self {
        let rows = frame.tiles.iter().filter_map(|tile| {
            let covariance = tile.information.try_inverse()? + Matrix2::identity() * FLOOR_PX.powi(2);
            Some(TileRow {
                derivatives: TileDerivatives::of(tile, &frame.motion, model)?,
                residual: tile.shift_px,
                information: covariance.try_inverse()?,
                surface: tile.surface,
                is_held_out: holds_out(tile),
            })
        });
        let prior = frame_prior(frame.rates, model.readout_s(), distance_m);
        let prior_right = frame.rates.map_or(FrameVector::zeros(), |rates| prior * missing_rates(&frame.motion, &rates));
        Self { rows: rows.collect(), prior, prior_right }
    }

    /// The tiles.
    pub fn rows(&self) -> &[TileRow] {
        &self.rows
    }
}

/// Rows that are exposed together say nothing of the camera's rates; others less than the frames around.
fn frame_prior(rates: Option<KnownRates>, readout_s: f64, distance_m: f64) -> FrameMatrix {
    let [unseen_velocity, unseen_turn_rate, ..] = unseen(distance_m);
    let [velocity, turn_rate] = rates.map_or([unseen_velocity, unseen_turn_rate], |rates| rates.sigmas);
    let sigma = |k: usize| match (k, readout_s == 0.0) {
        (0..6, _) => POSE_SIGMA,
        (_, true) => 1e-6,
        (6..9, false) => velocity,
        (_, false) => turn_rate,
    };
    FrameMatrix::from_diagonal(&FrameVector::from_fn(|k, _| sigma(k).powi(-2)))
}

/// How far the rates of a motion are from what was known of them, as the frame's unknowns: a camera that goes to the right sees all go to the left.
fn missing_rates(motion: &Motion, known: &KnownRates) -> FrameVector {
    let velocity = motion.pose.rotation.inverse() * (motion.velocity - known.means[0]);
    let turn_rate = motion.turn_rate - known.means[1];
    FrameVector::from_fn(|k, _| match k {
        0..6 => 0.0,
        6..9 => velocity[k - 6],
        _ => turn_rate[k - 9],
    })
}

impl NormalEquations {
    /// Of all frames, with Tukey's weights at the robust scale of each surface. Held-out tiles count only where `with_held_out`.
    pub fn new(frames: &[FrameRows], unknowns: usize, scales: &[f64], with_held_out: bool) -> Option<Self> {
        let mut out =
            Self { matrix: DMatrix::zeros(unknowns, unknowns), right: DVector::zeros(unknowns), frames: Vec::with_capacity(frames.len()) };
        for frame in frames {
            out.add(frame, scales, with_held_out)?;
        }
        Some(out)
    }

    fn add(&mut self, frame: &FrameRows, scales: &[f64], with_held_out: bool) -> Option<()> {
        let mut own = frame.prior;
        let mut right = frame.prior_right;
        let mut coupling = DMatrix::zeros(self.right.len(), FRAME_UNKNOWNS);
        for row in frame.rows.iter().filter(|r| with_held_out || !r.is_held_out) {
            let scale = scales[row.surface];
            let information = row.information * (tukey_weight(row.squared_now(), scale) / (scale * scale));
            let TileDerivatives { by_frame, by_model } = &row.derivatives;
            let weighted = by_frame.transpose() * information;
            own += weighted * by_frame;
            right += weighted * row.residual;
            for (i, d) in by_model {
                let d = information * d;
                self.right[*i] += d.dot(&row.residual);
                let mut coupled = coupling.row_mut(*i);
                coupled += (d.transpose() * by_frame).row(0);
                for (j, other) in by_model.iter().filter(|(j, _)| j <= i) {
                    self.matrix[(*i, *j)] += d.dot(other);
                }
            }
        }
        let factor = own.cholesky()?;
        // Lower triangle of C F⁻¹ Cᵀ, as the product of C L⁻ᵀ with itself.
        let inverse_root = factor.l().try_inverse()?;
        let root = &coupling * inverse_root.transpose();
        self.matrix.gemm(-1.0, &root, &root.transpose(), 1.0);
        let inverse = factor.inverse();
        self.right.gemv(-1.0, &coupling, &DVector::from_column_slice((inverse * right).as_slice()), 1.0);
        self.frames.push(EliminatedFrame { inverse, right, coupling });
        Some(())
    }

    /// How frame `k`'s pose, [δp, δθ] in camera axes, goes with the model's numbers when it is solved anew.
    pub fn pose_by_model(&self, k: usize) -> DMatrix<f64> {
        let EliminatedFrame { inverse, coupling, .. } = &self.frames[k];
        let pose: DMatrix<f64> = DMatrix::from_fn(6, FRAME_UNKNOWNS, |i, j| inverse[(i, j)]);
        -(pose * coupling.transpose())
    }

    /// Frames in it.
    pub fn frame_count(&self) -> usize {
        self.frames.len()
    }

    /// The robust cost that a step leaves of each surface's held-out tiles, in squared scales, each tile cut at Tukey's limit.
    pub fn held_out_costs(&self, frames: &[FrameRows], step: &DVector<f64>, scales: &[f64]) -> Vec<f64> {
        let mut costs = vec![0.0; scales.len()];
        for (frame, own) in frames.iter().zip(&self.frames) {
            let coupled = own.coupling.tr_mul(step);
            let by_frame = own.inverse * (own.right - FrameVector::from_column_slice(coupled.as_slice()));
            for row in frame.rows.iter().filter(|r| r.is_held_out) {
                costs[row.surface] += (row.squared(&by_frame, step) / scales[row.surface].powi(2)).min(22.0);
            }
        }
        costs
    }
}
