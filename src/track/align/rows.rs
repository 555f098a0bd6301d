//! What the rows within a tile add to its sums: each is exposed a little before or after the middle of the tile.
//!
//! A camera that comes nearer while a rolling shutter reads its rows stretches the picture from top to bottom; so does one that is pitched
//! and shifted a little, at rest. To first order the two look the same on a flat stage: only what is known of the motion
//! beforehand tells them apart. With one time for all rows of a tile, the steps from tile to tile would pass for a
//! difference between them: the pose would take what is the motion's, by centimetres, and the covariance would not tell.
//! So the motion's columns have the time of each row.

use super::lanes::{LANES, Lanes, dispatch, load_at, total};
use super::normal::{COLUMNS, POSE_ENTRIES as TRIANGLE, RunView, SPREAD, Weighing, columns, less_step, weight};

/// Columns of the pose.
const POSE: usize = SPREAD;
/// Columns of a tile other than the pose.
const OTHERS: usize = COLUMNS - POSE;
const ALL: usize = 2 * TRIANGLE + POSE * (OTHERS + 1);

/// Weighted sums over one run, with `d` for the seconds from the middle of the tile to a pixel's row.
#[derive(Debug, Clone, Copy)]
pub struct RowSums {
    sums: [f32; ALL],
}

impl RowSums {
    /// Sum of w d a_i a_j for columns of the pose: the upper triangle, row by row.
    pub fn by_time(&self) -> [f64; TRIANGLE] {
        std::array::from_fn(|k| f64::from(self.sums[k]))
    }

    /// Sum of w d² a_i a_j, likewise.
    pub fn by_squared_time(&self) -> [f64; TRIANGLE] {
        std::array::from_fn(|k| f64::from(self.sums[TRIANGLE + k]))
    }

    /// Sum of w d a_i a_c: column `i` of the pose by any other column from [`SPREAD`] on; [`COLUMNS`] is the residual.
    pub fn by_other(&self, i: usize, c: usize) -> f64 {
        f64::from(self.sums[2 * TRIANGLE + i * (OTHERS + 1) + c - POSE])
    }
}

dispatch! {
    /// The sums of a run whose tile is taken to be exposed `delay_s` after the frame's stamp; weights are those of
    /// [`tile_sums`](super::normal::tile_sums).
    row_sums, row_sums_avx2, row_sums_lanes,
    (view: &RunView, delay_s: f32, step: &[f32; COLUMNS], weighing: &Weighing) -> RowSums
}

#[inline(always)]
pub fn row_sums_lanes<L: Lanes>(view: &RunView, delay_s: f32, step: &[f32; COLUMNS], weighing: &Weighing) -> RowSums {
    let RunView { pixels, run, appearance, light, residuals } = *view;
    let mut sums = [L::splat(0.0); ALL];
    for k in run.range().step_by(LANES) {
        let (columns, _) = columns::<L>(pixels, appearance, light, k);
        let r = load_at::<L>(&residuals.grey, k);
        let after = less_step(r, &columns, step);
        let information = load_at::<L>(&residuals.information, k);
        let w = weight(after.mul(after).mul(information), weighing).mul(information);
        let d = load_at::<L>(&pixels.delay_s, k).sub(L::splat(delay_s));
        let (mut once, mut twice, mut other) = (0, TRIANGLE, 2 * TRIANGLE);
        for i in 0..POSE {
            let timed = columns[i].mul(w).mul(d);
            let timed_twice = timed.mul(d);
            for j in i..POSE {
                sums[once] = timed.mul_add(columns[j], sums[once]);
                sums[twice] = timed_twice.mul_add(columns[j], sums[twice]);
                (once, twice) = (once + 1, twice + 1);
            }
            for c in POSE..COLUMNS {
                sums[other] = timed.mul_add(columns[c], sums[other]);
                other += 1;
            }
            sums[other] = timed.mul_add(r, sums[other]);
            other += 1;
        }
    }
    let mut totals = [0.0; ALL];
    for n in 0..ALL {
        totals[n] = total(sums[n]);
    }
    RowSums { sums: totals }
}
