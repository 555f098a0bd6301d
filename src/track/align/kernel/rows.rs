//! What the rows within a tile add to its sums: each is exposed a little before or after the middle of the tile.
//!
//! A camera that comes nearer while a rolling shutter reads its rows stretches the picture from top to bottom; so does one that is pitched
//! and shifted a little, at rest. To first order the two look the same on a flat stage: only what is known of the motion
//! beforehand tells them apart. With one time for all rows of a tile, the steps from tile to tile would pass for a
//! difference between them: the pose would take what is the motion's, by centimetres, and the covariance would not tell.
//! So the motion's columns have the time of each row.

use super::columns::{LIGHT, POSE, POSE_ENTRIES as TRIANGLE, entry};

/// Weighted sums over one run, with `d` for the seconds from the middle of the tile to a pixel's row.
#[derive(Debug, Clone, Copy)]
pub struct RowSums {
    sums: [f32; Self::ENTRIES],
}

impl RowSums {
    /// How many sums there are: two triangles of the pose, by time and by its square, and the pose by light and residual.
    pub const ENTRIES: usize = 2 * TRIANGLE + POSE * (LIGHT + 1);

    /// From the sums in the order of their places.
    pub fn new(sums: [f32; Self::ENTRIES]) -> Self {
        Self { sums }
    }

    /// Where the sum of w d a_i a_j is, for columns of the pose.
    pub const fn timed(i: usize, j: usize) -> usize {
        entry(i, j)
    }

    /// Where the sum of w d² a_i a_j is, likewise.
    pub const fn squared(i: usize, j: usize) -> usize {
        TRIANGLE + entry(i, j)
    }

    /// Where the sum of w d a_i a_c is: column `i` of the pose by any other column from [`POSE`] on; [`COLUMNS`](super::columns::COLUMNS) is the residual.
    pub const fn other(i: usize, c: usize) -> usize {
        2 * TRIANGLE + i * (LIGHT + 1) + c - POSE
    }

    /// Sum of w d a_i a_j for columns of the pose: the upper triangle, row by row.
    #[inline(always)]
    pub fn by_time(&self) -> [f64; TRIANGLE] {
        std::array::from_fn(|k| f64::from(self.sums[k]))
    }

    /// Sum of w d² a_i a_j, likewise.
    #[inline(always)]
    pub fn by_squared_time(&self) -> [f64; TRIANGLE] {
        std::array::from_fn(|k| f64::from(self.sums[TRIANGLE + k]))
    }

    /// Sum of w d a_i a_c: column `i` of the pose by any other column, see [`other`](Self::other).
    #[inline(always)]
    pub fn by_other(&self, i: usize, c: usize) -> f64 {
        f64::from(self.sums[Self::other(i, c)])
    }
}
