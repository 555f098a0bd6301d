//! Distributes a row of pixels over the cells of a grid and the directions of their histograms;
//! shared by descriptors based on gradient histograms (trilinear interpolation: Lowe, Distinctive
//! Image Features from Scale-Invariant Keypoints, IJCV 2004, section 6.1).

/// Grid coordinates of the pixels of a row.
#[derive(Debug, Default)]
pub struct Shares {
    /// Index of the first of the four cells that share a pixel, in row-major order.
    pub cells: Vec<u32>,
    /// Share of the next cell in the row.
    pub next: Vec<f32>,
    /// Share of the two cells in the row below.
    pub below: Vec<f32>,
    /// Directions in the grid's frame, in bins, from 0.
    pub bins: Vec<f32>,
}

impl Shares {
    /// Resizes the buffers for `n` pixels.
    pub fn resize(&mut self, n: usize) {
        self.cells.resize(n, 0);
        [&mut self.next, &mut self.below, &mut self.bins].into_iter().for_each(|v| v.resize(n, 0.0));
    }
}

/// Converts an angle from -2 turns to 1 turn to a position among `count` bins around the circle, 0
/// to `count`.
#[inline(always)]
pub fn bin(angle: f32, count: f32) -> f32 {
    let bin = angle * (count / std::f32::consts::TAU);
    let bin = if bin < 0.0 { bin + count } else { bin };
    if bin < 0.0 { bin + count } else { bin }
}

/// Two grids of `CELLS` histograms. Neighbouring pixels mostly fall into the same cells;
/// alternating between two grids, an addition need not wait for the previous one.
pub type Grids<const BINS: usize, const CELLS: usize> = [[[f32; BINS]; CELLS]; 2];

/// Adds the gradient lengths of a row to grids with `ROW` cells per row. Inlined, so that it is
/// compiled for its caller's instruction set.
#[inline(always)]
pub fn add_row<const BINS: usize, const CELLS: usize, const ROW: usize>(shares: &Shares, lengths: &[f32], grids: &mut Grids<BINS, CELLS>) {
    let n = lengths.len();
    let (cells, next, below, bins) = (&shares.cells[..n], &shares.next[..n], &shares.below[..n], &shares.bins[..n]);
    for i in 0..n {
        // All shares at once: a bin's share falls with its distance, around the circle.
        let mut parts = [0.0; BINS];
        for (k, part) in parts.iter_mut().enumerate() {
            let away = (bins[i] - k as f32).abs();
            let away = if away < BINS as f32 - away { away } else { BINS as f32 - away };
            *part = if away < 1.0 { 1.0 - away } else { 0.0 };
        }
        let first = cells[i] as usize;
        let Some(four) = grids[i % 2].get_mut(first..first + ROW + 2) else { continue };
        let (lower, upper) = (lengths[i] * below[i], lengths[i] * (1.0 - below[i]));
        let weights = [upper * (1.0 - next[i]), upper * next[i], lower * (1.0 - next[i]), lower * next[i]];
        for (cell, weight) in [0, 1, ROW, ROW + 1].into_iter().zip(weights) {
            for k in 0..BINS {
                four[cell][k] += weight * parts[k];
            }
        }
    }
}
