//! How the stage's light and the camera turn the reference's grey into the frame's: a gain that varies smoothly
//! over the frame, a bias, and a point spread wider or narrower than the reference's.
//!
//! A [`Light`] and the grid that its gains are for are one value and change together: every tile of the grid has its
//! four nodes. What outlives a grid is a [`RememberedLight`], which no tile can ask.
//!
//! # Where another parameter goes
//! 1. [`columns`](crate::track::align::kernel::columns): its column before `GAINS`, and `LIGHT` one more. Sums take their sizes from there; the blocks that they are
//!    computed by stop compiling until `tile_products` lays them out anew.
//! 2. [`normal`](crate::track::align::kernel::normal): its effect in `residuals_lanes`, its derivative in `columns`; `kernel_tests` hold the one to differences of the other.
//!    A term that is not linear in the picture also changes the columns beside it, and the slope of seen by predicted that `columns` gives as the gain.
//! 3. Here: a field of [`Light`], [`TileLight`] and [`RememberedLight`], and all that copies them: `of_tile`, `spread_over`, `correct`, `guess`, `take`,
//!    `clone_from`. `correct` and `guess` are called through [`pixels`](crate::track::align::pixels::runs) by [`level_problem`](crate::track::align::solve::level_problem).
//! 4. [`system`](crate::track::align::solve::system): its prior in `begin`, its part of `Step` and of `of_tile`, its place in `spread_out` and in the list `others` of `add`.
//!    A parameter that is one for the whole frame counts among `SHARED`.

use crate::track::frame::tile_grid::TileGrid;

/// Weight of the usual gain at a node, beside the tiles that touch it, which weigh 1 each. Only the first guess: the solution corrects it.
/// Chosen, not tuned. At 0, nodes without a tile would have no gain; raised, shadows are guessed too bright.
const USUAL_SHARE: f64 = 0.2;

/// The light at a tile and the small changes that a solution brings to its pixels.
#[derive(Debug, Clone, Copy, Default)]
pub struct TileLight {
    /// Gain at the corners of its cell.
    pub gains: [f32; 4],
    /// Point spread.
    pub psf_variance: f32,
    /// Grey levels.
    pub bias: f32,
}

/// seen = gain(x) (grey + spread * d grey / d spread) + bias.
#[derive(Debug, Default)]
pub struct Light {
    grid: TileGrid,
    /// Gain at the nodes of the grid, numbered column by column.
    gains: Vec<f64>,
    /// Grey levels.
    bias: f64,
    /// In the kernel's own unit.
    psf_variance: f64,
    /// How much is known of each node while a light is guessed.
    weights: Vec<f64>,
}

impl Light {
    /// The grid.
    pub fn grid(&self) -> &TileGrid {
        &self.grid
    }

    /// Gain at the nodes of the grid.
    pub fn gains(&self) -> &[f64] {
        &self.gains
    }

    /// Grey levels.
    pub fn bias(&self) -> f64 {
        self.bias
    }

    /// In the kernel's own unit.
    pub fn psf_variance(&self) -> f64 {
        self.psf_variance
    }

    /// Mean of the nodes.
    pub fn mean_gain(&self) -> f64 {
        mean(&self.gains)
    }

    /// The nodes of a tile of the grid.
    pub fn nodes_of(&self, tile: u32) -> [usize; 4] {
        self.grid.nodes_of(tile as usize)
    }

    /// The light of a tile of the grid.
    pub fn of_tile(&self, tile: u32) -> TileLight {
        let gains = self.nodes_of(tile).map(|n| self.gains[n] as f32);
        TileLight { gains, psf_variance: self.psf_variance as f32, bias: self.bias as f32 }
    }

    /// A light that is remembered, on another grid, which may cover another part of the frame: nodes keep their relative places.
    pub fn spread_over(&mut self, grid: TileGrid, light: &RememberedLight) {
        self.grid = grid;
        let nodes = grid.nodes();
        self.gains.clear();
        if nodes == light.nodes {
            self.gains.extend_from_slice(&light.gains);
        } else {
            // Starts from its mean: the grid changes when the view does, and the solve is linear in the gains.
            self.gains.resize(nodes[0] * nodes[1], mean(&light.gains));
        }
        (self.bias, self.psf_variance) = (light.bias, light.psf_variance);
    }

    /// Adds a solution's changes of the gains at the nodes, the point spread and the bias.
    pub fn correct(&mut self, gains: &[f64], psf_variance: f64, bias: f64) {
        self.psf_variance += psf_variance;
        self.bias += bias;
        for (gain, change) in self.gains.iter_mut().zip(gains) {
            *gain += change;
        }
    }

    /// Takes a light from guesses: each node's gain is the mean of the tiles that touch it, and a little of what is usual.
    pub fn guess(&mut self, bias: f64, psf_variance: f64, usual: f64, tiles: impl Iterator<Item = (u32, f64)>) {
        (self.bias, self.psf_variance) = (bias, psf_variance);
        self.weights.clear();
        self.weights.resize(self.gains.len(), USUAL_SHARE);
        self.gains.fill(usual * USUAL_SHARE);
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

/// What is remembered of a light from level to level and from frame to frame.
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

    /// Keeps the list of gains: nothing is allocated where there are no more nodes than before.
    fn clone_from(&mut self, other: &Self) {
        self.gains.clone_from(&other.gains);
        (self.nodes, self.bias, self.psf_variance) = (other.nodes, other.bias, other.psf_variance);
    }
}

impl RememberedLight {
    /// Takes what a light is now.
    pub fn take(&mut self, light: &Light) {
        self.gains.clear();
        self.gains.extend_from_slice(&light.gains);
        (self.nodes, self.bias, self.psf_variance) = (light.grid.nodes(), light.bias, light.psf_variance);
    }

    /// In the kernel's own unit.
    pub fn psf_variance(&self) -> f64 {
        self.psf_variance
    }
}

fn mean(gains: &[f64]) -> f64 {
    gains.iter().sum::<f64>() / gains.len().max(1) as f64
}
