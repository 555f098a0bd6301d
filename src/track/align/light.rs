//! How the stage's light and the camera turn the reference's grey into the frame's: a gain that varies smoothly
//! over the frame, a bias, and a point spread wider or narrower than the reference's.

use super::pixels::TileGrid;

/// seen = gain(x) (grey + spread * d grey / d spread) + bias.
#[derive(Debug, PartialEq)]
pub struct Light {
    /// Gain at the nodes of the light grid, numbered column by column.
    pub gains: Vec<f64>,
    /// Nodes across and down.
    pub nodes: [usize; 2],
    /// Grey levels.
    pub bias: f64,
    /// In the kernel's own unit.
    pub spread: f64,
}

impl Default for Light {
    fn default() -> Self {
        Self { gains: vec![1.0; 4], nodes: [2, 2], bias: 0.0, spread: 0.0 }
    }
}

impl Clone for Light {
    fn clone(&self) -> Self {
        Self { gains: self.gains.clone(), ..*self }
    }

    /// Keeps the list of gains: nothing is allocated where the grid has no more nodes than before.
    fn clone_from(&mut self, other: &Self) {
        self.gains.clone_from(&other.gains);
        (self.nodes, self.bias, self.spread) = (other.nodes, other.bias, other.spread);
    }
}

impl Light {
    /// The same light on another grid, which may cover another part of the frame: nodes keep their relative places.
    pub fn regrid(&mut self, grid: &TileGrid) {
        let nodes = grid.nodes();
        if nodes == self.nodes {
            return;
        }
        // Starts from its mean: the grid changes when the view does, and the solve is linear in the gains.
        let mean = self.mean_gain();
        self.gains.clear();
        self.gains.resize(nodes[0] * nodes[1], mean);
        self.nodes = nodes;
    }

    /// Mean of the nodes.
    pub fn mean_gain(&self) -> f64 {
        self.gains.iter().sum::<f64>() / self.gains.len().max(1) as f64
    }

    /// One gain everywhere.
    pub fn set_gain(&mut self, gain: f64) {
        self.gains.iter_mut().for_each(|g| *g = gain);
    }
}
