//! The photometric model: how lamps and camera turn the reference's light into the frame's. It has
//! a gain that varies smoothly over the frame, a bias, and a point spread wider or narrower than
//! that of the reference.
//!
//! A [`Light`] and the grid of its gains are one value and change together, so that every tile of
//! the grid has its four nodes. What outlives a grid is a [`RememberedLight`], which no tile can
//! query.
//!
//! # How to add a parameter
//! 1. [`columns`](crate::track::align::kernel::columns): add its column before `GAINS`, and one to
//!    `LIGHT`. Sums take their sizes from there. The blocks in which `tile_products` computes them
//!    no longer compile until they are laid out anew.
//! 2. [`normal`](crate::track::align::kernel::normal): add its effect to `residuals_lanes` and its
//!    derivative to `columns`; `kernel_tests` compare the two by finite differences. A term that is
//!    not linear in the picture also changes the other columns, and `g` there: by how much the seen
//!    light changes per predicted light. A new derivative per pixel is computed in
//!    [`appearance`](crate::track::align::pixels::appearance).
//! 3. Here: add a field to [`Light`], [`TileLight`] and [`RememberedLight`], and to all that copies
//!    them: `of_tile`, `spread_over`, `correct`, `guess`, `take`, `clone_from`.
//!    [`level_problem`](crate::track::align::solve::level_problem) calls `correct` and `guess`
//!    through [`pixels`](crate::track::align::pixels::runs).
//! 4. [`system`](crate::track::align::solve::system): add its prior to `begin`, its part to `Step`
//!    and its `of_tile`, and its place to `spread_out` and to the list `others` of
//!    `add_plain`. A parameter with one value for the whole frame counts among `SHARED`.
//! 5. With a learnt mean: add it to `Prior` and `LevelPrior`, and to
//!    [`online_calibration`](crate::track::align::learned::online_calibration).
//! 6. `kernel_tests` first: `derivatives_by_the_light_agree_with_differences`.

use crate::track::align::tuning::TUNING;
use crate::track::frame::tile_grid::TileGrid;

/// The light at a tile. A solution changes it by little.
#[derive(Debug, Clone, Copy, Default)]
pub struct TileLight {
    /// Gain at the corners of the tile's cell of the light grid: top left, top right, bottom left,
    /// bottom right.
    pub gains: [f32; 4],
    /// Variance added by the point spread, in the kernel's unit (a twelfth of a square pixel of the
    /// level).
    pub psf_variance: f32,
    /// Bias, in units of light.
    pub bias: f32,
}

/// The light over the frame: seen = gain(x) (light + psf_variance * d light / d psf_variance) +
/// bias.
#[derive(Debug, Default)]
pub struct Light {
    grid: TileGrid,
    /// Gain at the nodes of the grid, numbered column by column.
    gains: Vec<f64>,
    /// Bias, in units of light.
    bias: f64,
    /// Variance added by the point spread, in the kernel's unit.
    psf_variance: f64,
    /// Weights of the nodes while a light is guessed.
    weights: Vec<f64>,
}

impl Light {
    /// Returns the grid.
    pub fn grid(&self) -> &TileGrid {
        &self.grid
    }

    /// Returns the gain at the nodes of the grid, numbered column by column.
    pub fn gains(&self) -> &[f64] {
        &self.gains
    }

    /// Returns the bias, in units of light.
    pub fn bias(&self) -> f64 {
        self.bias
    }

    /// Returns the variance added by the point spread, in the kernel's unit.
    pub fn psf_variance(&self) -> f64 {
        self.psf_variance
    }

    /// Returns the mean gain of the nodes.
    pub fn mean_gain(&self) -> f64 {
        mean(&self.gains)
    }

    /// Returns the nodes at the corners of a tile's cell.
    pub fn nodes_of(&self, tile: u32) -> [usize; 4] {
        self.grid.nodes_of(tile as usize)
    }

    /// Returns the light of a tile of the grid.
    pub fn of_tile(&self, tile: u32) -> TileLight {
        let gains = self.nodes_of(tile).map(|n| self.gains[n] as f32);
        TileLight { gains, psf_variance: self.psf_variance as f32, bias: self.bias as f32 }
    }

    /// Takes a remembered light to another grid, which may cover another part of the frame. With
    /// the same number of nodes, nodes keep their gains; otherwise all take the mean.
    pub fn spread_over(&mut self, grid: TileGrid, light: &RememberedLight) {
        self.grid = grid;
        let nodes = grid.nodes();
        self.gains.clear();
        if nodes == light.nodes {
            self.gains.extend_from_slice(&light.gains);
        } else {
            // The mean is enough to start from: the grid changes when the view does, and the
            // solution is linear in the gains.
            self.gains.resize(nodes[0] * nodes[1], mean(&light.gains));
        }
        (self.bias, self.psf_variance) = (light.bias, light.psf_variance);
    }

    /// Adds a fraction of a solution's changes of the gains at the nodes, of the point spread and
    /// of the bias.
    pub fn correct(&mut self, fraction: f64, gains: &[f64], psf_variance: f64, bias: f64) {
        self.psf_variance += fraction * psf_variance;
        self.bias += fraction * bias;
        for (gain, change) in self.gains.iter_mut().zip(gains) {
            *gain += fraction * change;
        }
    }

    /// Takes a light from guesses: the gain of a node is the mean of its adjacent tiles (tile,
    /// gain) and, with a small weight, of the usual gain.
    pub fn guess(&mut self, bias: f64, psf_variance: f64, usual: f64, tiles: impl Iterator<Item = (u32, f64)>) {
        (self.bias, self.psf_variance) = (bias, psf_variance);
        self.weights.clear();
        self.weights.resize(self.gains.len(), TUNING.usual_gain_weight);
        self.gains.fill(usual * TUNING.usual_gain_weight);
        for (tile, gain) in tiles {
            for node in self.nodes_of(tile) {
                self.gains[node] += gain;
                self.weights[node] += 1.0;
            }
        }
        for (gain, weight) in self.gains.iter_mut().zip(&self.weights) {
            *gain /= weight;
        }
    }
}

/// The part of a light that is kept from level to level and from frame to frame.
#[derive(Debug, PartialEq)]
pub struct RememberedLight {
    /// Gain at the nodes, numbered column by column.
    gains: Vec<f64>,
    /// Nodes across and down.
    nodes: [usize; 2],
    bias: f64,
    psf_variance: f64,
}

impl Default for RememberedLight {
    fn default() -> Self {
        Self { gains: vec![1.0; 4], nodes: [2, 2], bias: 0.0, psf_variance: 0.0 }
    }
}

impl Clone for RememberedLight {
    fn clone(&self) -> Self {
        Self { gains: self.gains.clone(), ..*self }
    }

    /// Reuses the list of gains: allocates nothing unless there are more nodes than before.
    fn clone_from(&mut self, other: &Self) {
        self.gains.clone_from(&other.gains);
        (self.nodes, self.bias, self.psf_variance) = (other.nodes, other.bias, other.psf_variance);
    }
}

impl RememberedLight {
    /// Remembers a light as it is now.
    pub fn take(&mut self, light: &Light) {
        self.gains.clear();
        self.gains.extend_from_slice(&light.gains);
        (self.nodes, self.bias, self.psf_variance) = (light.grid.nodes(), light.bias, light.psf_variance);
    }

    /// Returns the variance added by the point spread, in the kernel's unit.
    pub fn psf_variance(&self) -> f64 {
        self.psf_variance
    }
}

fn mean(gains: &[f64]) -> f64 {
    gains.iter().sum::<f64>() / gains.len().max(1) as f64
}
