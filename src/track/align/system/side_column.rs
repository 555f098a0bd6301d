//! One unknown more beside those that a step solves for: what a frame says of it while all the others stay free.
//!
//! Eliminating the others (the Schur complement of the normal equations) leaves one equation: the unknown's
//! information, and the pull of the residuals that the step left. Quantities that no single frame may change, as the
//! time in which a sensor is read, are learnt from these over many frames.

use super::super::normal::{COLUMNS, TileSums};
use super::{System, TileTime};

/// What one frame says of an unknown that it did not solve for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clue {
    /// Information times the change that the residuals ask for.
    pub pull: f64,
    /// Inverse variance of that change, all other unknowns being free.
    pub information: f64,
}

/// Sums over tiles for the unknown; keeps its buffers.
#[derive(Debug, Default)]
pub struct SideColumn {
    with_others: Vec<f64>,
    solved: Vec<f64>,
    own: f64,
    pull: f64,
}

/// A tile at the solution.
pub struct SolvedTile<'a> {
    /// Its sums at the linearisation.
    pub sums: &'a TileSums,
    /// Its part of the solution.
    pub step: &'a [f32; COLUMNS],
    /// Its light nodes.
    pub nodes: [usize; 4],
    /// When it was exposed.
    pub time: TileTime,
    /// Inverse of the residuals' variance beyond what their whitener says.
    pub weight: f64,
}

impl SideColumn {
    /// Starts the sums for a system that was solved.
    pub fn begin(&mut self, system: &System) {
        self.with_others.clear();
        self.with_others.resize(system.size, 0.0);
        (self.own, self.pull) = (0.0, 0.0);
    }

    /// Adds a tile. `by_unknown`: how its pose (position, rotation as in the columns) changes with the unknown.
    pub fn add(&mut self, system: &System, tile: &SolvedTile, by_unknown: &[f64; 6]) {
        let along = |c: usize| by_unknown.iter().enumerate().map(|(k, d)| tile.sums.product(c, k) * d).sum::<f64>();
        for (c, (rows, factors)) in system.places(tile.nodes, &tile.time).iter().enumerate() {
            let shared = along(c) * tile.weight;
            rows.iter().zip(factors).for_each(|(row, factor)| self.with_others[*row] += factor * shared);
        }
        for (c, d) in by_unknown.iter().enumerate() {
            let explained: f64 = tile.step.iter().enumerate().map(|(k, s)| tile.sums.product(c, k) * f64::from(*s)).sum();
            self.own += d * along(c) * tile.weight;
            self.pull += d * (tile.sums.product(c, COLUMNS) - explained) * tile.weight;
        }
    }

    /// Eliminates the other unknowns.
    pub fn finish(&mut self, system: &System) -> Clue {
        self.solved.clone_from(&self.with_others);
        system.back_substitute(&mut self.solved);
        let shared: f64 = self.with_others.iter().zip(&self.solved).map(|(a, b)| a * b).sum();
        Clue { pull: self.pull, information: (self.own - shared).max(0.0) }
    }
}
