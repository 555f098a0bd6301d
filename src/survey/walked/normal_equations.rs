//! The normal equations of a survey: all frames' tiles, with each frame's own unknowns eliminated
//! (Schur complement).
//!
//! A tile connects its frame's motion to a few of the model's unknowns. Motions of different frames
//! are independent, so each frame's unknowns are eliminated separately, and one dense system of the
//! model's unknowns remains. Source: Triggs et al., *Bundle Adjustment - A Modern Synthesis*
//! (2000), section 6.1.
//!
//! A frame has as many unknowns here as its alignment leaves free. Without its accelerations, each
//! step would attribute to the lens or a fold what the next alignment attributes to a curved camera
//! path, and the adjustment would converge very slowly.

use nalgebra::{DMatrix, DVector, Matrix2, SMatrix, SVector, Vector2};

use super::dense_system::subtract_square;
use super::stage_model::StageModel;
use super::tile_derivatives::{FRAME_UNKNOWNS, TileDerivatives};
use crate::geometry::robust_kernel::tukey_weight;
use crate::motion::{Motion, unseen};
use crate::track::{KnownRates, ObservedFrame, ObservedTile};

/// Noise floor of every tile, pixels, one sigma along each axis: remaining errors of light, print
/// and lens. (research: 0.015.) Raised, tiles with much detail count no more than others; lowered,
/// they are trusted too much.
const FLOOR_PX: f64 = 0.015;
/// Prior of a frame's pose around its alignment, one sigma, metres and radians: too weak to matter,
/// but it keeps frames with few tiles solvable.
const POSE_SIGMA: f64 = 0.3;

type FrameMatrix = SMatrix<f64, FRAME_UNKNOWNS, FRAME_UNKNOWNS>;
type FrameVector = SVector<f64, FRAME_UNKNOWNS>;

/// A tile's contribution to the equations.
#[derive(Debug, Clone)]
pub struct TileRow {
    derivatives: TileDerivatives,
    /// Its residual, pixels.
    residual: Vector2<f64>,
    information: Matrix2<f64>,
    /// Index of its surface.
    pub surface: usize,
    /// Whether it is held out, for judging the smoothness.
    pub is_held_out: bool,
}

/// A frame's tiles and priors.
#[derive(Debug, Clone, Default)]
pub struct FrameRows {
    rows: Vec<TileRow>,
    /// Prior information of the frame's unknowns, and its right-hand side.
    prior: FrameMatrix,
    prior_right: FrameVector,
    /// Number of unknowns that the tiles may constrain: the first six with a global shutter.
    constrained: usize,
}

/// The system of the model's unknowns.
#[derive(Debug, Clone)]
pub struct NormalEquations {
    /// Information matrix.
    pub matrix: DMatrix<f64>,
    /// Right-hand side: the solution is matrix⁻¹ right.
    pub right: DVector<f64>,
    frames: Vec<EliminatedFrame>,
}

/// What is needed to recover a frame's unknowns.
#[derive(Debug, Clone)]
struct EliminatedFrame {
    inverse: FrameMatrix,
    right: FrameVector,
    coupling: DMatrix<f64>,
}

impl TileRow {
    /// Returns the squared residual after a step, in sigmas.
    fn squared(&self, by_frame: &FrameVector, step: &DVector<f64>) -> f64 {
        let mut left = self.residual - self.derivatives.by_frame * by_frame;
        for (k, d) in &self.derivatives.by_model {
            left -= d * step[*k];
        }
        left.dot(&(self.information * left))
    }

    /// Returns how far a step of the model alone moves the tile, pixels, squared.
    pub fn moved_squared(&self, step: &DVector<f64>) -> f64 {
        self.derivatives.by_model.iter().map(|(k, d)| d * step[*k]).sum::<Vector2<f64>>().norm_squared()
    }

    /// Returns the squared residual before any step, in sigmas.
    pub fn squared_now(&self) -> f64 {
        self.residual.dot(&(self.information * self.residual))
    }

    /// Returns Tukey's weight at a robust scale, divided by the scale squared.
    pub fn weight(&self, scale: f64) -> f64 {
        tukey_weight(self.squared_now(), scale) / (scale * scale)
    }
}

impl FrameRows {
    /// Creates the rows of an observed frame. `holds_out` selects the tiles to hold out.
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
        let prior = frame_prior(frame.rates, distance_m);
        let prior_right = frame.rates.map_or(FrameVector::zeros(), |rates| prior * missing_rates(&frame.motion, &rates));
        let constrained = if model.readout_s() == 0.0 { 6 } else { FRAME_UNKNOWNS };
        Self { rows: rows.collect(), prior, prior_right, constrained }
    }

    /// Returns the tiles.
    pub fn rows(&self) -> &[TileRow] {
        &self.rows
    }
}

/// Returns the prior information of a frame's unknowns.
fn frame_prior(rates: Option<KnownRates>, distance_m: f64) -> FrameMatrix {
    let of_rates = rates.map_or_else(|| unseen(distance_m), |rates| rates.sigmas);
    let sigma = |k: usize| if k < 6 { POSE_SIGMA } else { of_rates[k / 3 - 2] };
    FrameMatrix::from_diagonal(&FrameVector::from_fn(|k, _| sigma(k).powi(-2)))
}

/// Returns the difference between a motion's rates and the known ones, as the frame's unknowns.
/// Their signs are inverted, since a camera that moves right sees everything move left.
fn missing_rates(motion: &Motion, known: &KnownRates) -> FrameVector {
    let to_camera = motion.pose.rotation.inverse();
    let off = known.on(&motion.pose).error_to(motion);
    let part = |first: usize| off.fixed_rows::<3>(first).into_owned();
    let parts = [part(0), part(3), to_camera * part(6), part(9), to_camera * part(12), part(15)];
    FrameVector::from_fn(|k, _| parts[k / 3][k % 3])
}

impl NormalEquations {
    /// Sums up all frames, with Tukey's weights at each surface's robust scale. Held-out tiles only
    /// count if `with_held_out`.
    pub fn new(frames: &[FrameRows], unknowns: usize, scales: &[f64], with_held_out: bool) -> Option<Self> {
        let mut out =
            Self { matrix: DMatrix::zeros(unknowns, unknowns), right: DVector::zeros(unknowns), frames: Vec::with_capacity(frames.len()) };
        let mut roots = DMatrix::zeros(unknowns, frames.iter().map(|frame| frame.constrained).sum());
        let mut first = 0;
        for frame in frames {
            let root = out.add(frame, scales, with_held_out)?;
            roots.columns_mut(first, frame.constrained).copy_from(&root);
            first += frame.constrained;
        }
        // For all frames at once: one product passes through the matrix once.
        subtract_square(&mut out.matrix, &roots);
        Some(out)
    }

    /// Adds a frame's tiles and eliminates its unknowns. Returns the root R of what the elimination
    /// subtracts from the matrix, R Rᵀ; the caller subtracts it.
    fn add(&mut self, frame: &FrameRows, scales: &[f64], with_held_out: bool) -> Option<DMatrix<f64>> {
        let mut own = frame.prior;
        let mut right = frame.prior_right;
        let mut coupling = DMatrix::zeros(self.right.len(), FRAME_UNKNOWNS);
        for row in frame.rows.iter().filter(|r| with_held_out || !r.is_held_out) {
            let information = row.information * row.weight(scales[row.surface]);
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
        // C F⁻¹ Cᵀ is the square of C L⁻ᵀ.
        let inverse_root = factor.l().try_inverse()?;
        let own_root = inverse_root.view((0, 0), (frame.constrained, frame.constrained));
        let root = coupling.columns(0, frame.constrained) * own_root.transpose();
        let inverse = factor.inverse();
        self.right.gemv(-1.0, &coupling, &DVector::from_column_slice((inverse * right).as_slice()), 1.0);
        self.frames.push(EliminatedFrame { inverse, right, coupling });
        Some(root)
    }

    /// Returns the derivative of frame `k`'s solved pose, [δp, δθ] in camera axes, by the model's
    /// unknowns.
    pub fn pose_by_model(&self, k: usize) -> DMatrix<f64> {
        let EliminatedFrame { inverse, coupling, .. } = &self.frames[k];
        let pose: DMatrix<f64> = DMatrix::from_fn(6, FRAME_UNKNOWNS, |i, j| inverse[(i, j)]);
        -(pose * coupling.transpose())
    }

    /// Returns the number of frames.
    pub fn frame_count(&self) -> usize {
        self.frames.len()
    }

    /// Returns the robust cost of each surface's held-out tiles after a step, in squared scales,
    /// each tile capped at Tukey's limit.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraModel;
    use crate::survey::walked::synthetic::{LENS, camera_poses, observed, stage};

    /// Errors of the motions: m, rad, m/s, rad/s, m/s², rad/s²; small enough that tiles keep their
    /// weights.
    const OFF: [f64; 6] = [1e-5, 1e-5, 5e-4, 2e-4, 1.0, 0.5];

    /// Returns the squared residuals, in sigmas, of tiles that are shifted only by the camera's
    /// motion, and how much a step of the model reduces them.
    fn squares_and_taken(readout_s: f64) -> [f64; 2] {
        let model = StageModel::new(CameraModel::new(LENS).unwrap(), &stage(), true, false).with_readout(readout_s);
        let motions: Vec<Motion> = camera_poses(12).into_iter().map(Motion::still).collect();
        let mut frames = observed(&model, &model, &motions, 0.0, 1);
        for (n, frame) in frames.iter_mut().enumerate() {
            let off = FrameVector::from_fn(|k, _| OFF[k / 3] * (1.7 * (n * FRAME_UNKNOWNS + k) as f64).sin());
            for tile in &mut frame.tiles {
                tile.shift_px = TileDerivatives::of(tile, &frame.motion, &model).unwrap().by_frame * off;
            }
        }
        let rows: Vec<FrameRows> = frames.iter().map(|frame| FrameRows::new(frame, &model, 3.0, |_| false)).collect();
        let mut equations = NormalEquations::new(&rows, model.places().count, &[1.0; 2], true).unwrap();
        // Weak compared with the tiles, strong compared with the priors of the cameras: the world
        // stays where it is.
        for k in 0..model.places().count {
            equations.matrix[(k, k)] += 1e4;
        }
        equations.matrix.fill_upper_triangle_with_lower_triangle();
        let step = equations.matrix.cholesky().unwrap().solve(&equations.right);
        [rows.iter().flat_map(FrameRows::rows).map(TileRow::squared_now).sum(), step.dot(&equations.right)]
    }

    #[test]
    fn residuals_explained_by_frame_motion_change_no_model() {
        for readout_s in [0.0, 0.018, -0.01] {
            let [squares, taken] = squares_and_taken(readout_s);
            assert!(squares > 100.0 && taken < 1e-4 * squares, "{readout_s}: {squares} {taken}");
        }
    }
}
