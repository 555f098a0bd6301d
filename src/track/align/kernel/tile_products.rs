//! The kernel of the normal equations: weighted products of the columns of a run's pixels, summed
//! over the run.
//!
//! A tile has few pixels, so work per run costs as much as work per pixel. The columns of a run are
//! laid out in a buffer that is reused and never cleared. Their products are summed block by block
//! in registers, and at the end eight sums at a time are added across their lanes.

use super::columns::{ALL, COLUMNS, POSE, TileSums};
use super::normal::{RobustWeighting, RunView, columns, less_step, weight};
use super::rows::RowSums;
use super::tile_equations::TileEquations;
use crate::track::align::lanes::{LANES, Lanes, dispatch, load_at};

/// Groups of [`LANES`] pixels that are laid out before their products are summed. Raised, the
/// buffer leaves the first-level cache; lowered, long runs take more rounds.
const CHUNK: usize = 16;
/// First of the factors by time, and by squared time, and number of all factors. The first [`ALL`]
/// are the weighted columns.
const TIMED: usize = ALL;
const SQUARED: usize = TIMED + POSE;
const FACTORS: usize = SQUARED + POSE;
/// Index of the first sum for the rows, after those for the tile, each padded to whole [`LANES`];
/// and number of all sums.
const ROW_SUMS: usize = TileSums::ENTRIES.next_multiple_of(LANES);
const SUMS: usize = ROW_SUMS + RowSums::ENTRIES.next_multiple_of(LANES);

/// The numbers of [`LANES`] pixels.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
struct Group([f32; LANES]);

/// The columns of a chunk, and the sums of the chunks before it. Nothing is read that was not
/// written for the same run.
#[derive(Debug)]
pub struct ProductBuffer {
    factors: [[Group; CHUNK]; FACTORS],
    plain: [[Group; CHUNK]; ALL],
    sums: [Group; SUMS],
}

impl Default for ProductBuffer {
    fn default() -> Self {
        let zero = Group([0.0; LANES]);
        Self { factors: [[zero; CHUNK]; FACTORS], plain: [[zero; CHUNK]; ALL], sums: [zero; SUMS] }
    }
}

dispatch! {
    /// Sums a run at the linearisation, with the weights of the residuals after `step` (in the
    /// tile's columns). `delay_s`: the time at which the tile counts as exposed, seconds from the
    /// frame's stamp, where the sums by the times of its rows are wanted too.
    tile_equations, tile_equations_lanes,
    (view: &RunView, delay_s: Option<f32>, step: &[f32; COLUMNS], weighting: &RobustWeighting, buffer: &mut ProductBuffer) -> TileEquations
}

/// Does the work of [`tile_equations`], for one type of lanes.
#[inline(always)]
pub fn tile_equations_lanes<L: Lanes>(
    view: &RunView,
    delay_s: Option<f32>,
    step: &[f32; COLUMNS],
    weighting: &RobustWeighting,
    buffer: &mut ProductBuffer,
) -> TileEquations {
    let RunView { pixels, run, appearance, light, residuals } = *view;
    let (mut n, mut is_first) = (0, true);
    for k in run.range().step_by(LANES * weighting.stride) {
        if n == CHUNK {
            add_products::<L>(buffer, n, is_first, delay_s.is_some());
            (n, is_first) = (0, false);
        }
        let (columns, _) = columns::<L>(pixels, appearance, light, k);
        let r = load_at::<L>(&residuals.intensity, k);
        let after = less_step(r, &columns, step);
        let information = load_at::<L>(&residuals.information, k);
        let w = weight(after.mul(after).mul(information), weighting).mul(information);
        for c in 0..COLUMNS {
            put::<L>(&mut buffer.plain[c], n, columns[c]);
            put::<L>(&mut buffer.factors[c], n, columns[c].mul(w));
        }
        put::<L>(&mut buffer.plain[COLUMNS], n, r);
        put::<L>(&mut buffer.factors[COLUMNS], n, r.mul(w));
        if let Some(delay_s) = delay_s {
            let d = load_at::<L>(&pixels.delay_s, k).sub(L::splat(delay_s));
            for i in 0..POSE {
                let timed = columns[i].mul(w).mul(d);
                put::<L>(&mut buffer.factors[TIMED + i], n, timed);
                put::<L>(&mut buffer.factors[SQUARED + i], n, timed.mul(d));
            }
        }
        n += 1;
    }
    add_products::<L>(buffer, n, is_first, delay_s.is_some());
    TileEquations {
        sums: TileSums::new(totals::<L, { TileSums::ENTRIES }>(&buffer.sums[..ROW_SUMS])),
        rows: delay_s.map(|_| RowSums::new(totals::<L, { RowSums::ENTRIES }>(&buffer.sums[ROW_SUMS..]))),
    }
}

#[inline(always)]
fn put<L: Lanes>(column: &mut [Group; CHUNK], n: usize, value: L) {
    value.store(&mut column[n].0);
}

/// Adds the products of the first `n` groups of a chunk to the sums, or starts the sums.
#[inline(always)]
fn add_products<L: Lanes>(buffer: &mut ProductBuffer, n: usize, is_first: bool, has_rows: bool) {
    macro_rules! blocks {
        ($rows:literal x $columns:literal: $([$i:expr, $j:expr])*) => {
            $(add_block::<L, $rows, $columns, { $i }, { $j }>(buffer, n, is_first);)*
        };
    }
    const { assert!(POSE == 6 && COLUMNS == 12, "the blocks are laid out for these columns and the residual: lay them out anew") }
    // Blocks of three factors by four columns: their sums stay in registers while the chunk is
    // read.
    blocks!(3 x 4: [0, 0] [0, 4] [0, 8] [3, 3] [3, 7] [6, 6] [9, 9]);
    blocks!(3 x 1: [0, 12] [3, 11] [3, 12] [6, 10] [6, 11] [6, 12]);
    blocks!(1 x 1: [12, 12]);
    if has_rows {
        blocks!(3 x 4: [TIMED, 0] [TIMED, 4] [TIMED, 8] [TIMED + 3, 3] [TIMED + 3, 7] [SQUARED, 0]);
        blocks!(3 x 2: [TIMED + 3, 11] [SQUARED, 4] [SQUARED + 3, 4]);
        blocks!(3 x 1: [TIMED, 12] [SQUARED + 3, 3]);
    }
}

/// Adds the products of `R` factors from the `I`th with `C` columns from the `J`th.
#[inline(always)]
fn add_block<L: Lanes, const R: usize, const C: usize, const I: usize, const J: usize>(
    buffer: &mut ProductBuffer,
    n: usize,
    is_first: bool,
) {
    let mut block = [[L::splat(0.0); C]; R];
    for p in 0..n.min(CHUNK) {
        let mut plain = [L::splat(0.0); C];
        for b in 0..C {
            plain[b] = L::load(&buffer.plain[J + b][p].0);
        }
        for a in 0..R {
            let factor = L::load(&buffer.factors[I + a][p].0);
            for b in 0..C {
                block[a][b] = factor.mul_add(plain[b], block[a][b]);
            }
        }
    }
    for a in 0..R {
        for b in 0..C {
            let Some(place) = place(I + a, J + b) else { continue };
            let sum = &mut buffer.sums[place].0;
            let more = if is_first { block[a][b] } else { L::load(sum).add(block[a][b]) };
            more.store(sum);
        }
    }
}

/// Returns the index of the sum of a factor's products with a column; `None` where the column comes
/// first, because symmetric products are stored once.
#[inline(always)]
const fn place(factor: usize, column: usize) -> Option<usize> {
    if factor < TIMED {
        if factor <= column { Some(TileSums::entry(factor, column)) } else { None }
    } else if factor < SQUARED {
        let i = factor - TIMED;
        if i > column {
            None
        } else if column < POSE {
            Some(ROW_SUMS + RowSums::timed(i, column))
        } else {
            Some(ROW_SUMS + RowSums::other(i, column))
        }
    } else {
        let i = factor - SQUARED;
        if i <= column { Some(ROW_SUMS + RowSums::squared(i, column)) } else { None }
    }
}

/// Returns each sum added up across its lanes.
#[inline(always)]
fn totals<L: Lanes, const N: usize>(sums: &[Group]) -> [f32; N] {
    let mut totals = [0.0; N];
    for (eight, out) in sums.chunks_exact(LANES).zip(totals.chunks_mut(LANES)) {
        let mut lanes = [L::splat(0.0); LANES];
        for k in 0..LANES {
            lanes[k] = L::load(&eight[k].0);
        }
        let mut values = [0.0; LANES];
        L::totals(lanes).store(&mut values);
        out.copy_from_slice(&values[..out.len()]);
    }
    totals
}
