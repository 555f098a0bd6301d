//! The normal equations of one tile, in its own columns and in those that its rows' times add.

use super::normal::{COLUMNS, SPREAD, TileSums};
use super::rows::RowSums;

/// What a tile says, linearised: its sums, and those of the times of its rows.
#[derive(Debug, Clone, Copy, Default)]
pub struct TileEquations {
    /// Over its pixels.
    pub sums: TileSums,
    /// How they differ in time.
    pub rows: RowSums,
}

/// A change of everything that a tile sees.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TileStep {
    /// Of its columns, at its middle.
    pub columns: [f32; COLUMNS],
    /// How the change of the pose grows from row to row, per second.
    pub rate: [f32; SPREAD],
}

/// One number for each column, and for each column of the pose times the seconds from the middle of the tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TileScore {
    /// By column.
    pub columns: [f64; COLUMNS],
    /// By column of the pose and time.
    pub timed: [f64; SPREAD],
}

impl TileEquations {
    /// The normal matrix times a step: what of the right side it explains.
    pub fn explained(&self, step: &TileStep) -> TileScore {
        let (columns, rate) = (step.columns.map(f64::from), step.rate.map(f64::from));
        let by_column = |c: usize| {
            let own: f64 = columns.iter().enumerate().map(|(k, s)| self.sums.product(c, k) * s).sum();
            own + rate.iter().enumerate().map(|(k, s)| self.by_time(k, c) * s).sum::<f64>()
        };
        let by_time = |i: usize| {
            let own: f64 = columns.iter().enumerate().map(|(k, s)| self.by_time(i, k) * s).sum();
            own + rate.iter().enumerate().map(|(k, s)| self.rows.by_squared_time(i, k) * s).sum::<f64>()
        };
        TileScore { columns: std::array::from_fn(by_column), timed: std::array::from_fn(by_time) }
    }

    /// What of the right side a step leaves.
    pub fn left_by(&self, step: &TileStep) -> TileScore {
        let explained = self.explained(step);
        TileScore {
            columns: std::array::from_fn(|c| self.sums.product(c, COLUMNS) - explained.columns[c]),
            timed: std::array::from_fn(|i| self.rows.by_other(i, COLUMNS) - explained.timed[i]),
        }
    }

    /// Sum of w d a_i a_c: column `i` of the pose by any column.
    fn by_time(&self, i: usize, c: usize) -> f64 {
        if c < SPREAD { self.rows.by_time(i, c) } else { self.rows.by_other(i, c) }
    }
}
