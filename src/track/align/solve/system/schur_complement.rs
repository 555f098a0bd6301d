//! One additional unknown: what a frame says of it while all unknowns of the step stay free.
//!
//! Eliminating the others (the Schur complement of the normal equations) leaves one equation: the
//! unknown's information, and the score of the residuals that the step left. Quantities that no
//! single frame may change, such as the readout time, are learnt from these over many frames.

use super::{SHARED, System};
use crate::motion::MotionError;
use crate::track::align::kernel::tile_equations::{TileEquations, TileStep};
use crate::track::align::learned::clue::Clue;
use crate::track::align::pixels::level_spec::TileTime;

/// Sums over tiles for the unknown; keeps its buffers.
#[derive(Debug, Default)]
pub struct SchurComplement {
    with_others: Vec<f64>,
    solved: Vec<f64>,
    own: f64,
    score: f64,
}

/// A tile at the solution.
pub struct SolvedTile<'a> {
    /// Its equations at the linearisation.
    pub equations: &'a TileEquations,
    /// Its part of the solution.
    pub step: &'a TileStep,
    /// Its light nodes.
    pub nodes: [usize; 4],
    /// When it was exposed.
    pub time: TileTime,
    /// Inverse of the residuals' variance after whitening.
    pub weight: f64,
}

impl SchurComplement {
    /// Starts the sums for a solved system.
    pub fn begin(&mut self, system: &System) {
        self.with_others.clear();
        self.with_others.resize(system.band.size, 0.0);
        (self.own, self.score) = (0.0, 0.0);
    }

    /// Adds a tile. `by_unknown`: derivative, by the unknown, of everything that affects the tile.
    pub fn add(&mut self, system: &System, tile: &SolvedTile, by_unknown: &TileStep) {
        let shared = tile.equations.explained(by_unknown);
        let left = tile.equations.left_by(tile.step);
        system.spread_out(&shared, tile.nodes, &tile.time, |row, score| self.with_others[row] += score * tile.weight);
        let changes = by_unknown.columns.iter().chain(&by_unknown.rate).map(|d| f64::from(*d) * tile.weight);
        let own = shared.columns.iter().chain(&shared.timed);
        for (d, (own, left)) in changes.zip(own.zip(left.columns.iter().chain(&left.timed))) {
            self.own += d * own;
            self.score += d * left;
        }
    }

    /// Eliminates the other unknowns. Returns the clue on the unknown.
    pub fn finish(&mut self, system: &System) -> Clue {
        self.solved.clone_from(&self.with_others);
        system.back_substitute(&mut self.solved);
        let shared: f64 = self.with_others.iter().zip(&self.solved).map(|(a, b)| a * b).sum();
        Clue { score: self.score, information: (self.own - shared).max(0.0) }
    }

    /// Handles an unknown on which the predicted motion depends as well; call after
    /// [`finish`](Self::finish). `pull`: the information of that motion, times its derivative by
    /// the unknown. Returns what this dependence adds to the score's change with the unknown
    /// (mostly negative), and the derivative of the solved motion by the unknown.
    pub fn with_pull(&mut self, system: &System, pull: &MotionError) -> (f64, MotionError) {
        let first = system.band.nodes + SHARED;
        let hidden = pull.iter().zip(&self.solved[first..]).map(|(a, b)| a * b).sum();
        self.with_others.fill(0.0);
        self.with_others[first..].copy_from_slice(pull.as_slice());
        system.back_substitute(&mut self.with_others);
        (hidden, MotionError::from_fn(|k, _| self.with_others[first + k] - self.solved[first + k]))
    }
}
