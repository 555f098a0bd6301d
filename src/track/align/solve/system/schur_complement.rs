//! One unknown more beside those that a step solves for: what a frame says of it while all the others stay free.
//!
//! Eliminating the others (the Schur complement of the normal equations) leaves one equation: the unknown's
//! information, and the pull of the residuals that the step left. Quantities that no single frame may change, as the
//! time in which a sensor is read, are learnt from these over many frames.

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
    /// Inverse of the residuals' variance beyond what their whitener says.
    pub weight: f64,
}

impl SchurComplement {
    /// Starts the sums for a system that was solved.
    pub fn begin(&mut self, system: &System) {
        self.with_others.clear();
        self.with_others.resize(system.band.size, 0.0);
        (self.own, self.score) = (0.0, 0.0);
    }

    /// Adds a tile. `by_unknown`: how all that it sees changes with the unknown.
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

    /// Eliminates the other unknowns.
    pub fn finish(&mut self, system: &System) -> Clue {
        self.solved.clone_from(&self.with_others);
        system.back_substitute(&mut self.solved);
        let shared: f64 = self.with_others.iter().zip(&self.solved).map(|(a, b)| a * b).sum();
        Clue { score: self.score, information: (self.own - shared).max(0.0) }
    }

    /// After [`finish`](Self::finish), of an unknown on which the expected motion depends as well. `pull`: the information of that motion times its derivative by the
    /// unknown. Gives what that adds to the change of the score with the unknown (mostly, it takes from it), and the derivative of the solved motion by the unknown.
    pub fn with_pull(&mut self, system: &System, pull: &MotionError) -> (f64, MotionError) {
        let first = system.band.nodes + SHARED;
        let hidden = pull.iter().zip(&self.solved[first..]).map(|(a, b)| a * b).sum();
        self.with_others.fill(0.0);
        self.with_others[first..].copy_from_slice(pull.as_slice());
        system.back_substitute(&mut self.with_others);
        (hidden, MotionError::from_fn(|k, _| self.with_others[first + k] - self.solved[first + k]))
    }
}
