//! A row of pixels shared out among the cells of a grid and the directions of their histograms: what descriptions by histograms of gradients have in
//! common (trilinear interpolation: Lowe, Distinctive Image Features from Scale-Invariant Keypoints, IJCV 2004, section 6.1).

/// Where the pixels of a row fall in a grid.
#[derive(Debug, Default)]
pub struct Shares {
    /// Number of the first of the four cells that share a pixel, row by row of the grid.
    pub cells: Vec<u32>,
    /// Share of the next cell in the row.
    pub next: Vec<f32>,
    /// Share of the two cells in the row below.
    pub below: Vec<f32>,
    /// Directions in the grid's frame, in bins, from 0.
    pub bins: Vec<f32>,
}

impl Shares {
    /// For `n` pixels.
    pub fn resize(&mut self, n: usize) {
        self.cells.resize(n, 0);
        [&mut self.next, &mut self.below, &mut self.bins].into_iter().for_each(|v| v.resize(n, 0.0));
    }
}

/// Place of an angle among `count` bins around the circle, 0 to `count`, of an angle from -2 turns to 1 turn.
#[inline(always)]
pub fn bin(angle: f32, count: f32) -> f32 {
    let bin = angle * (count / std::f32::consts::TAU);
    let bin = if bin < 0.0 { bin + count } else { bin };
    if bin < 0.0 { bin + count } else { bin }
}

/// Two grids of `CELLS` histograms. Neighbouring pixels mostly fall in the same cells: taking turns, an addition need not wait for the one before.
pub type Grids<const BINS: usize, const CELLS: usize> = [[[f32; BINS]; CELLS]; 2];

/// Adds the lengths of a row's gradients to grids with `ROW` cells a row. Inlined, so that it is compiled for the processor of its caller.
#[inline(always)]
pub fn add_row<const BINS: usize, const CELLS: usize, const ROW: usize>(shares: &Shares, lengths: &[f32], grids: &mut Grids<BINS, CELLS>) {
    let n = lengths.len();
    let (cells, next, below, bins) = (&shares.cells[..n], &shares.next[..n], &shares.below[..n], &shares.bins[..n]);
    for i in 0..n {
        // All shares at once: a bin loses one for each bin that it is away, around the circle.
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
