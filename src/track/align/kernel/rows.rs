//! What the rows within a tile add to its sums, because a rolling shutter exposes each row a little
//! before or after the middle of the tile.
//!
//! A camera that approaches while its rows are read stretches the picture from top to bottom. So
//! does a camera at rest that is slightly pitched and shifted. To first order the two look the same
//! on a flat stage, and only the motion prior tells them apart. With one time for all rows of a
//! tile, the steps from tile to tile would pass for a difference between the two: the pose would
//! absorb the motion's part, by centimetres, without any trace in the covariance. So the columns of
//! the motion use the time of each row.

use super::columns::{LIGHT, POSE, POSE_ENTRIES as TRIANGLE, entry};

/// Weighted sums over one run, where `d` is the time from the middle of the tile to a pixel's row,
/// seconds.
#[derive(Debug, Clone, Copy)]
pub struct RowSums {
    sums: [f32; Self::ENTRIES],
}

impl RowSums {
    /// Number of the sums: two triangles of the pose, by d and by d², and the pose by light and
    /// residual.
    pub const ENTRIES: usize = 2 * TRIANGLE + POSE * (LIGHT + 1);

    /// Takes the sums in the order of their indices.
    pub fn new(sums: [f32; Self::ENTRIES]) -> Self {
        Self { sums }
    }

    /// Returns the index of the sum of w d a_i a_j, for columns of the pose.
    pub const fn timed(i: usize, j: usize) -> usize {
        entry(i, j)
    }

    /// Returns the index of the sum of w d² a_i a_j, likewise.
    pub const fn squared(i: usize, j: usize) -> usize {
        TRIANGLE + entry(i, j)
    }

    /// Returns the index of the sum of w d a_i a_c: column `i` of the pose by any other column from
    /// [`POSE`] on; [`COLUMNS`](super::columns::COLUMNS) is the residual.
    pub const fn other(i: usize, c: usize) -> usize {
        2 * TRIANGLE + i * (LIGHT + 1) + c - POSE
    }

    /// Returns the sums of w d a_i a_j for columns of the pose: the upper triangle, row by row.
    #[inline(always)]
    pub fn by_time(&self) -> [f64; TRIANGLE] {
        std::array::from_fn(|k| f64::from(self.sums[k]))
    }

    /// Returns the sums of w d² a_i a_j, likewise.
    #[inline(always)]
    pub fn by_squared_time(&self) -> [f64; TRIANGLE] {
        std::array::from_fn(|k| f64::from(self.sums[TRIANGLE + k]))
    }

    /// Returns the sum of w d a_i a_c: column `i` of the pose by any other column, see
    /// [`other`](Self::other).
    #[inline(always)]
    pub fn by_other(&self, i: usize, c: usize) -> f64 {
        f64::from(self.sums[Self::other(i, c)])
    }
}
