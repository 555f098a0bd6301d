//! The linear system of one step over all tiles: light first, motion last. It is factored once and
//! used for the step, for the covariance, and for the scatter of the tiles' votes.
//!
//! A light node shares tiles only with its neighbours and with the dense end (point spread, bias,
//! motion). Eliminated in this order, the factor stays banded, at a fraction of a dense one's cost.
//! The order of calls is [`System::begin`], [`System::add`] for each tile, [`System::solve`], then
//! [`System::covariance`].

use crate::track::align::tuning::TUNING;
use nalgebra::SVector;

use self::banded_cholesky::{Band, back_substitute, factor};
use crate::motion::{MotionError, MotionMatrix};
use crate::simd::multiversion;
use crate::track::align::kernel::columns::{BIAS, COLUMNS, GAINS, LIGHT, POSE, POSE_ENTRIES, PSF_VARIANCE, entry};
use crate::track::align::kernel::rows::RowSums;
use crate::track::align::kernel::tile_equations::{TileEquations, TileScore, TileStep};
use crate::track::align::learned::light::Light;
use crate::track::align::pixels::level_spec::{POWERS, TileTime};

mod banded_cholesky;
pub mod schur_complement;

/// Degrees of freedom of a motion: position and rotation, with velocity and acceleration.
pub const MOTION: usize = 18;
/// Unknowns of the light that are the same for the whole frame, behind its nodes: point spread and
/// bias; not the four gains.
const SHARED: usize = LIGHT - 4;
/// Unknowns behind the light nodes: the shared ones, and the motion.
const DENSE: usize = SHARED + MOTION;

/// The prior of a step.
pub struct Prior<'a> {
    /// Information of the motion.
    pub information: &'a MotionMatrix,
    /// Error of the motion from the linearisation to the prior's mean.
    pub error: MotionError,
    /// The slow average of the point spread's variance, and one sigma about it.
    pub psf_variance: f64,
    /// See `psf_variance`.
    pub psf_variance_sigma: f64,
}

impl Prior<'_> {
    /// Returns the prior's part of the cost at the linearisation: half the squared deviations, in
    /// sigmas, of the motion and of a light from what the prior expects.
    pub fn cost(&self, light: &Light) -> f64 {
        let psf_variance = (light.psf_variance() - self.psf_variance) / self.psf_variance_sigma;
        let bias = light.bias() / TUNING.bias_sigma;
        let roughness: f64 = neighbours(light).map(|[a, b]| (light.gains()[b] - light.gains()[a]).powi(2)).sum();
        let of_light = psf_variance.powi(2) + bias.powi(2) + roughness * roughness_information(light);
        0.5 * (self.error.dot(&(self.information * self.error)) + of_light)
    }
}

/// Returns the information of the difference between neighbouring nodes' gains.
fn roughness_information(light: &Light) -> f64 {
    (TUNING.gain_roughness * light.mean_gain().abs().max(0.02)).powi(-2)
}

/// Returns the pairs of neighbouring nodes of the light's grid.
fn neighbours(light: &Light) -> impl Iterator<Item = [usize; 2]> {
    let [columns, rows] = light.grid().nodes();
    (0..columns * rows).flat_map(move |a| {
        let next = [(a + rows < columns * rows).then_some(a + rows), ((a + 1) % rows != 0).then_some(a + 1)];
        next.into_iter().flatten().map(move |b| [a, b])
    })
}

/// The tiles' equations for the pose at their own time, by powers of time.
#[derive(Debug)]
struct PoseSums {
    /// Pose by pose, for each pair of powers a >= b (a, b: 00, 10, 11, 20, 21, 22): upper
    /// triangles, row by row.
    by_pose: [[f64; POSE_ENTRIES]; 6],
    /// Pose by all other unknowns, for each power.
    by_others: [Vec<[f64; POSE]>; POWERS],
    right: [[f64; POSE]; POWERS],
}

impl Default for PoseSums {
    fn default() -> Self {
        Self { by_pose: [[0.0; POSE_ENTRIES]; 6], by_others: Default::default(), right: Default::default() }
    }
}

/// Returns the index of a pair of powers a >= b in [`PoseSums::by_pose`].
fn pair(a: usize, b: usize) -> usize {
    a * (a + 1) / 2 + b
}

#[inline(always)]
fn add_scaled<const N: usize>(sums: &mut [f64; N], factor: f64, values: &[f64; N]) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += factor * value);
}

multiversion! {
    /// Runs [`System::add`] in wide registers where the processor has them.
    fn add_tile(system: &mut System, tile: &TileEquations, nodes: [usize; 4], time: &TileTime, weight: f64); ["avx2"] => System::add_plain, else System::add_plain
}

/// The system and its factor; keeps its buffers.
#[derive(Debug, Default)]
pub struct System {
    pose: PoseSums,
    /// The time of all tiles, where it is the same for all; then pose sums are kept for power 0
    /// alone.
    same_time: Option<TileTime>,
    band: Band,
    /// Lower triangle, row by row (a full square is allocated).
    matrix: Vec<f64>,
    right: Vec<f64>,
    solution: Vec<f64>,
    /// Columns of the inverse that belong to the pose.
    pose_columns: [Vec<f64>; POSE],
    score: Vec<f64>,
}

/// A correction of all unknowns.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    /// Gains of the nodes, then point spread, bias, motion.
    all: &'a [f64],
    nodes: usize,
}

impl Step<'_> {
    /// Returns the corrections of the light nodes' gains.
    pub fn gains(&self) -> &[f64] {
        &self.all[..self.nodes]
    }

    /// Returns the correction of the point spread's variance.
    pub fn psf_variance(&self) -> f64 {
        self.all[self.nodes]
    }

    /// Returns the correction of the bias, in units of light.
    pub fn bias(&self) -> f64 {
        self.all[self.nodes + 1]
    }

    /// Returns the correction of the motion.
    pub fn motion(&self) -> MotionError {
        MotionError::from_column_slice(&self.all[self.nodes + SHARED..])
    }

    /// Returns the part of the step that affects a tile.
    pub fn of_tile(&self, nodes: [usize; 4], time: &TileTime) -> TileStep {
        let motion = &self.all[self.nodes + SHARED..];
        let by = |factors: [f64; POWERS], c: usize| (0..POWERS).map(|p| factors[p] * motion[POSE * p + c]).sum::<f64>();
        let columns = std::array::from_fn(|c| {
            let value = match c {
                0..POSE => by(time.factors(), c),
                PSF_VARIANCE => self.psf_variance(),
                BIAS => self.bias(),
                _ => self.all[nodes[c - GAINS]],
            };
            value as f32
        });
        TileStep { columns, rate: std::array::from_fn(|c| by(time.rates(), c) as f32) }
    }
}

impl System {
    /// Starts a system with its prior. `light`: the light at the linearisation; `same_time`: the
    /// time of all tiles, where it is the same.
    pub fn begin(&mut self, light: &Light, prior: &Prior, same_time: Option<TileTime>) {
        self.same_time = same_time;
        let [columns, rows] = light.grid().nodes();
        self.band = Band { size: columns * rows + DENSE, nodes: columns * rows, rows };
        let n = self.band.size;
        // Clears only what the factor reads: the matrix is far larger than its band.
        self.matrix.resize(n * n, 0.0);
        for row in 0..n {
            let first = self.band.first(row);
            self.matrix[row * n + first..=row * n + row].fill(0.0);
        }
        for list in [&mut self.right, &mut self.solution, &mut self.score] {
            list.clear();
            list.resize(n, 0.0);
        }
        self.pose.by_pose = [[0.0; POSE_ENTRIES]; 6];
        self.pose.right = [[0.0; POSE]; POWERS];
        for list in &mut self.pose.by_others {
            list.clear();
            list.resize(self.band.nodes + SHARED, [0.0; POSE]);
        }
        self.smooth(light);
        let (psf_variance, bias, motion) = (self.band.nodes, self.band.nodes + 1, self.band.nodes + SHARED);
        self.matrix[psf_variance * n + psf_variance] = prior.psf_variance_sigma.powi(-2);
        self.right[psf_variance] = (prior.psf_variance - light.psf_variance()) * prior.psf_variance_sigma.powi(-2);
        self.matrix[bias * n + bias] = TUNING.bias_sigma.powi(-2);
        self.right[bias] = -light.bias() * TUNING.bias_sigma.powi(-2);
        let right = prior.information * prior.error;
        for i in 0..MOTION {
            self.right[motion + i] = right[i];
            for j in 0..=i {
                self.matrix[(motion + i) * n + motion + j] = prior.information[(i, j)];
            }
        }
    }

    /// Adds the prior that neighbouring nodes have similar gains.
    fn smooth(&mut self, light: &Light) {
        let n = self.band.size;
        let information = roughness_information(light);
        for [a, b] in neighbours(light) {
            let difference = light.gains()[b] - light.gains()[a];
            self.matrix[a * n + a] += information;
            self.matrix[b * n + b] += information;
            self.matrix[b * n + a] -= information;
            self.right[a] += information * difference;
            self.right[b] -= information * difference;
        }
    }

    /// Distributes a tile's score over the unknowns that it belongs to: calls `add` with an
    /// unknown's index and its part.
    fn spread_out(&self, score: &TileScore, nodes: [usize; 4], time: &TileTime, mut add: impl FnMut(usize, f64)) {
        let (factors, rates) = (time.factors(), time.rates());
        for c in 0..POSE {
            for p in 0..POWERS {
                add(self.band.nodes + SHARED + POSE * p + c, factors[p] * score.columns[c] + rates[p] * score.timed[c]);
            }
        }
        add(self.band.nodes, score.columns[PSF_VARIANCE]);
        add(self.band.nodes + 1, score.columns[BIAS]);
        for (node, value) in nodes.iter().zip(&score.columns[GAINS..]) {
            add(*node, *value);
        }
    }

    /// Adds a tile. `nodes`: its light nodes; `weight`: inverse of the residuals' variance after
    /// whitening.
    pub fn add(&mut self, tile: &TileEquations, nodes: [usize; 4], time: &TileTime, weight: f64) {
        add_tile(self, tile, nodes, time, weight);
    }

    #[inline(always)]
    fn add_plain(&mut self, tile: &TileEquations, nodes: [usize; 4], time: &TileTime, weight: f64) {
        let n = self.band.size;
        let TileEquations { sums, rows } = tile;
        let others: [usize; LIGHT] = [self.band.nodes, self.band.nodes + 1, nodes[0], nodes[1], nodes[2], nodes[3]];
        for (i, row) in others.iter().enumerate() {
            self.right[*row] += weight * sums.product(POSE + i, COLUMNS);
            for (j, column) in others.iter().enumerate().filter(|(_, column)| *column <= row) {
                self.matrix[row * n + column] += weight * sums.product(POSE + i, POSE + j);
            }
        }
        let factors = time.factors();
        // One power of time suffices where the time is the same for all.
        let powers = if self.same_time.is_some() { 1 } else { POWERS };
        let pose = sums.of_pose();
        let right: [f64; POSE] = std::array::from_fn(|i| sums.product(i, COLUMNS));
        let columns: [[f64; POSE]; LIGHT] = std::array::from_fn(|k| std::array::from_fn(|i| sums.product(i, POSE + k)));
        for a in 0..powers {
            for b in 0..=a {
                add_scaled(&mut self.pose.by_pose[pair(a, b)], weight * factors[a] * factors[b], &pose);
            }
            add_scaled(&mut self.pose.right[a], weight * factors[a], &right);
            for (other, column) in others.iter().zip(&columns) {
                add_scaled(&mut self.pose.by_others[a][*other], weight * factors[a], column);
            }
        }
        if let Some(rows) = rows.as_ref().filter(|_| powers > 1) {
            self.add_rows(rows, others, time, weight);
        }
    }

    /// Adds the equations by which a tile's rows differ from its middle. `others`: its unknowns
    /// beside the pose.
    #[inline(always)]
    fn add_rows(&mut self, rows: &RowSums, others: [usize; LIGHT], time: &TileTime, weight: f64) {
        let (factors, rates) = (time.factors(), time.rates());
        let (by_time, by_squared_time) = (rows.by_time(), rows.by_squared_time());
        let right: [f64; POSE] = std::array::from_fn(|i| rows.by_other(i, COLUMNS));
        let columns: [[f64; POSE]; LIGHT] = std::array::from_fn(|k| std::array::from_fn(|i| rows.by_other(i, POSE + k)));
        // At power 0, a pose does not change from row to row.
        for a in 1..POWERS {
            for b in 0..=a {
                let sum = &mut self.pose.by_pose[pair(a, b)];
                add_scaled(sum, weight * (factors[a] * rates[b] + rates[a] * factors[b]), &by_time);
                add_scaled(sum, weight * rates[a] * rates[b], &by_squared_time);
            }
            add_scaled(&mut self.pose.right[a], weight * rates[a], &right);
            for (other, column) in others.iter().zip(&columns) {
                add_scaled(&mut self.pose.by_others[a][*other], weight * rates[a], column);
            }
        }
    }

    /// Moves the pose sums into the matrix.
    fn place_pose_sums(&mut self) {
        let (n, motion) = (self.band.size, self.band.nodes + SHARED);
        // With one time for all, every power is the first one's sum, times its factor.
        let factors = self.same_time.map_or([1.0; POWERS], |t| t.factors());
        let kept = |a: usize| if self.same_time.is_some() { 0 } else { a };
        for a in 0..POWERS {
            for i in 0..POSE {
                let row = motion + POSE * a + i;
                self.right[row] += factors[a] * self.pose.right[kept(a)][i];
                for (other, column) in self.pose.by_others[kept(a)].iter().enumerate() {
                    self.matrix[row * n + other] += factors[a] * column[i];
                }
                for b in 0..=a {
                    let sums = &self.pose.by_pose[pair(kept(a), kept(b))];
                    for j in 0..POSE {
                        self.matrix[row * n + motion + POSE * b + j] += factors[a] * factors[b] * sums[entry(i, j)];
                    }
                }
            }
        }
    }

    /// Factors the system in place (Cholesky) and solves it; `None` where a direction is
    /// undetermined.
    pub fn solve(&mut self) -> Option<Step<'_>> {
        self.place_pose_sums();
        factor(&mut self.matrix, &self.band)?;
        let mut x = std::mem::take(&mut self.solution);
        x.copy_from_slice(&self.right);
        self.back_substitute(&mut x);
        self.solution = x;
        Some(Step { all: &self.solution, nodes: self.band.nodes })
    }

    /// Returns the last solution.
    pub fn step(&self) -> Step<'_> {
        Step { all: &self.solution, nodes: self.band.nodes }
    }

    /// Returns by how much the last solution lowers the cost of the linearised system; also half
    /// its squared length in sigmas.
    pub fn predicted_decrease(&self) -> f64 {
        0.5 * self.right.iter().zip(&self.solution).map(|(right, step)| right * step).sum::<f64>()
    }

    /// Solves with the factor, in place.
    fn back_substitute(&self, x: &mut [f64]) {
        back_substitute(&self.matrix, &self.band, x);
    }

    /// Returns the covariance of the motion, and the tiles' votes by it. The covariance is the last
    /// block of the inverse, unscaled, as weights were inverse variances.
    pub fn covariance(&mut self) -> (MotionMatrix, Votes<'_>) {
        let mut covariance = MotionMatrix::zeros();
        let mut column = std::mem::take(&mut self.score);
        for k in 0..MOTION {
            column.fill(0.0);
            column[self.band.nodes + SHARED + k] = 1.0;
            self.back_substitute(&mut column);
            for i in 0..MOTION {
                covariance[(i, k)] = column[self.band.nodes + SHARED + i];
            }
            if let Some(kept) = self.pose_columns.get_mut(k) {
                kept.clear();
                kept.extend_from_slice(&column);
            }
        }
        self.score = column;
        ((covariance + covariance.transpose()) * 0.5, Votes { system: self })
    }
}

/// The votes of single tiles on the pose.
pub struct Votes<'a> {
    system: &'a System,
}

impl Votes<'_> {
    /// Returns the step that a tile's remaining residuals alone would add. `left`: the part of the
    /// tile's right side that the solution left.
    pub fn of_tile(&self, left: &TileScore, nodes: [usize; 4], time: &TileTime, weight: f64) -> SVector<f64, 6> {
        let mut vote = SVector::<f64, 6>::zeros();
        self.system.spread_out(left, nodes, time, |row, score| {
            for (v, column) in vote.iter_mut().zip(&self.system.pose_columns) {
                *v += column[row] * score * weight;
            }
        });
        vote
    }
}
