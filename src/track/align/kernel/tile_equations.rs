//! The normal equations of one tile, in its own columns and in those that the times of its rows
//! add.

use super::columns::{COLUMNS, POSE, POSE_ENTRIES, TileSums, entry};
use super::rows::RowSums;

/// The linearised information of a tile: its sums, and those of the times of its rows.
#[derive(Debug, Clone, Copy, Default)]
pub struct TileEquations {
    /// Sums over its pixels.
    pub sums: TileSums,
    /// Sums by the times of its rows; `None` where all are exposed together, or treated so.
    pub rows: Option<RowSums>,
}

/// A change of all unknowns of a tile.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TileStep {
    /// Change of its columns, at its middle.
    pub columns: [f32; COLUMNS],
    /// Growth of the change of the pose from row to row, per second.
    pub rate: [f32; POSE],
}

/// One number for each column, and for each column of the pose times the seconds from the middle of
/// the tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TileScore {
    /// By column.
    pub columns: [f64; COLUMNS],
    /// By column of the pose, times the seconds.
    pub timed: [f64; POSE],
}

/// Returns a symmetric matrix of the pose's columns times a vector.
fn times(triangle: &[f64; POSE_ENTRIES], vector: &[f64; POSE]) -> [f64; POSE] {
    std::array::from_fn(|i| (0..POSE).map(|j| triangle[entry(i, j)] * vector[j]).sum())
}

impl TileEquations {
    /// Returns the normal matrix times a step: the part of the right side that the step explains.
    pub fn explained(&self, step: &TileStep) -> TileScore {
        let mut columns = self.sums.by_step(&step.columns);
        let Some(rows) = &self.rows else { return TileScore { columns, timed: [0.0; POSE] } };
        let rate = step.rate.map(f64::from);
        let by_time = rows.by_time();
        let pose: [f64; POSE] = std::array::from_fn(|i| f64::from(step.columns[i]));
        let (own, squared) = (times(&by_time, &pose), times(&rows.by_squared_time(), &rate));
        let mut timed: [f64; POSE] = std::array::from_fn(|i| own[i] + squared[i]);
        for (sum, more) in columns.iter_mut().zip(times(&by_time, &rate)) {
            *sum += more;
        }
        for (c, sum) in columns.iter_mut().enumerate().skip(POSE) {
            for (i, timed) in timed.iter_mut().enumerate() {
                let product = rows.by_other(i, c);
                *sum += product * rate[i];
                *timed += product * f64::from(step.columns[c]);
            }
        }
        TileScore { columns, timed }
    }

    /// Returns the right side that remains after a step.
    pub fn left_by(&self, step: &TileStep) -> TileScore {
        let explained = self.explained(step);
        let by_residual = |i: usize| self.rows.as_ref().map_or(0.0, |rows| rows.by_other(i, COLUMNS));
        TileScore {
            columns: std::array::from_fn(|c| self.sums.product(c, COLUMNS) - explained.columns[c]),
            timed: std::array::from_fn(|i| by_residual(i) - explained.timed[i]),
        }
    }
}
