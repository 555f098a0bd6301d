//! The linear system of one alignment step, tile by tile: how the residuals of a tile's pixels change with the
//! pose at the tile's rows, with the light of the tile's corners, the bias and the point spread.

use super::appearance::Appearance;
use super::lanes::{LANES, Lanes, dispatch, load_at, store_at};
use super::light::Light;
use super::pixels::{Pixels, Run};

/// Columns of a tile: pose (6), point spread, bias, gain at the four corners of its cell.
pub const COLUMNS: usize = 12;
/// Where the columns other than the pose start.
pub const SPREAD: usize = 6;
/// See [`SPREAD`].
pub const BIAS: usize = 7;
/// See [`SPREAD`].
pub const GAINS: usize = 8;
const ALL: usize = COLUMNS + 1;
/// Entries of the upper triangle of the columns and the residual.
const ENTRIES: usize = ALL * (ALL + 1) / 2;

/// Weighted sums over one run of pixels.
#[derive(Debug, Clone, Copy)]
pub struct TileSums {
    sums: [f32; ENTRIES],
}

impl TileSums {
    /// Sum of w a_i a_j for columns i <= j; column [`COLUMNS`] is the residual.
    pub fn product(&self, i: usize, j: usize) -> f64 {
        let (i, j) = if i <= j { (i, j) } else { (j, i) };
        f64::from(self.sums[i * ALL - i * (i + 1) / 2 + j])
    }
}

/// Tukey's biweight: residuals beyond this many robust sigmas count nothing.
const TUKEY: f32 = 4.7;
/// Geman and McClure's weight for a first look falls to one half at this many sigmas.
const FIRST_LOOK: f32 = 2.7;

/// How residuals are weighed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weighing {
    /// Robust standard deviation of the whitened residuals.
    pub scale: f64,
    /// Weights that never vanish instead of Tukey's: for a start that may be far off.
    pub is_first_look: bool,
    /// Of so many groups of [`LANES`] pixels one is summed: a rough step to take weights from needs no more.
    pub stride: usize,
}

/// Per-pixel numbers that the step owns.
#[derive(Debug, Default)]
pub struct Residuals {
    /// Seen less predicted grey, at the state of the linearisation.
    pub grey: Vec<f32>,
    /// Inverse of the variance that noise and model explain; 0 where a pixel tells nothing.
    pub information: Vec<f32>,
}

impl Residuals {
    /// Makes room for `n` pixels, none of which tells anything yet.
    pub fn resize(&mut self, n: usize) {
        for list in [&mut self.grey, &mut self.information] {
            list.clear();
            list.resize(n, 0.0);
        }
    }
}

/// The light at a tile and the small changes that a solution brings to its pixels.
#[derive(Debug, Clone, Copy)]
pub struct TileLight {
    gains: [f32; 4],
    spread: f32,
    bias: f32,
}

impl TileLight {
    /// The light of a tile from its nodes.
    pub fn new(light: &Light, nodes: [usize; 4]) -> Self {
        Self { gains: nodes.map(|n| light.gains[n] as f32), spread: light.spread as f32, bias: light.bias as f32 }
    }
}

/// What the noise of a pixel is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Variance at black, and its growth per grey level, of one pixel of the level.
    pub dark: f32,
    /// See `dark`.
    pub per_grey: f32,
    /// Error of the model in pixels of the level: it keeps strong edges from ruling.
    pub model_px: f32,
}

dispatch! {
    /// Residuals of a run at the linearisation, and their informations.
    residuals, residuals_avx2, residuals_lanes,
    (pixels: &Pixels, run: &Run, appearance: &Appearance, light: &TileLight, noise: &Noise, out: &mut Residuals)
}

dispatch! {
    /// Sums of a run at the linearisation; weights are those of the residuals as `step` (the tile's columns) leaves them.
    tile_sums, tile_sums_avx2, tile_sums_lanes,
    (view: &RunView, step: &[f32; COLUMNS], weighing: &Weighing) -> TileSums
}

/// A run with all that is known of its pixels at the linearisation.
#[derive(Clone, Copy)]
pub struct RunView<'a> {
    /// The pixels.
    pub pixels: &'a Pixels,
    /// Which of them.
    pub run: &'a Run,
    /// What they should look like.
    pub appearance: &'a Appearance,
    /// In this light.
    pub light: &'a TileLight,
    /// What they say.
    pub residuals: &'a Residuals,
}

/// Gain at each pixel of a run.
#[inline(always)]
fn corner_weights<L: Lanes>(pixels: &Pixels, k: usize) -> [L; 4] {
    let (a, b) = (load_at::<L>(&pixels.cell[0], k), load_at::<L>(&pixels.cell[1], k));
    let one = L::splat(1.0);
    let (na, nb) = (one.sub(a), one.sub(b));
    [na.mul(nb), a.mul(nb), na.mul(b), a.mul(b)]
}

#[inline(always)]
fn gain<L: Lanes>(light: &TileLight, corners: &[L; 4]) -> L {
    let g = light.gains;
    corners[0]
        .mul(L::splat(g[0]))
        .add(corners[1].mul(L::splat(g[1])))
        .add(corners[2].mul(L::splat(g[2])))
        .add(corners[3].mul(L::splat(g[3])))
}

#[inline(always)]
fn residuals_lanes<L: Lanes>(pixels: &Pixels, run: &Run, appearance: &Appearance, light: &TileLight, noise: &Noise, out: &mut Residuals) {
    let one = L::splat(1.0);
    for k in run.range().step_by(LANES) {
        let corners = corner_weights::<L>(pixels, k);
        let g = gain(light, &corners);
        let grey = load_at::<L>(&appearance.spread, k).mul_add(L::splat(light.spread), load_at(&appearance.grey, k));
        let seen = load_at::<L>(&pixels.seen, k);
        let residual = seen.sub(g.mul_add(grey, L::splat(light.bias)));
        let (across, down) = (load_at::<L>(&appearance.across, k), load_at::<L>(&appearance.down, k));
        let steep = across.mul(across).add(down.mul(down)).mul(g).mul(g);
        let expected = g.mul_add(grey, L::splat(light.bias)).max(L::splat(0.0));
        let variance =
            steep.mul_add(L::splat(noise.model_px * noise.model_px), expected.mul_add(L::splat(noise.per_grey), L::splat(noise.dark)));
        let information = load_at::<L>(&pixels.counts, k).mul(one.div(variance));
        store_at(&mut out.grey, k, residual);
        store_at(&mut out.information, k, information);
    }
}

#[inline(always)]
pub fn tile_sums_lanes<L: Lanes>(view: &RunView, step: &[f32; COLUMNS], weighing: &Weighing) -> TileSums {
    let RunView { pixels, run, appearance, light, residuals } = *view;
    let mut sums = [L::splat(0.0); ENTRIES];
    for k in run.range().step_by(LANES * weighing.stride) {
        let (columns, _) = columns::<L>(pixels, appearance, light, k);
        let r = load_at::<L>(&residuals.grey, k);
        let after = less_step(r, &columns, step);
        let information = load_at::<L>(&residuals.information, k);
        let w = weight(after.mul(after).mul(information), weighing).mul(information);
        let mut at = 0;
        for i in 0..COLUMNS {
            let weighted = columns[i].mul(w);
            for j in i..COLUMNS {
                sums[at] = weighted.mul_add(columns[j], sums[at]);
                at += 1;
            }
            sums[at] = weighted.mul_add(r, sums[at]);
            at += 1;
        }
        sums[at] = r.mul(w).mul_add(r, sums[at]);
    }
    let mut totals = [0.0; ENTRIES];
    for n in 0..ENTRIES {
        totals[n] = total(sums[n]);
    }
    TileSums { sums: totals }
}

/// The columns of [`LANES`] pixels: how the predicted grey changes; and the gain there.
#[inline(always)]
fn columns<L: Lanes>(pixels: &Pixels, appearance: &Appearance, light: &TileLight, k: usize) -> ([L; COLUMNS], L) {
    let corners = corner_weights::<L>(pixels, k);
    let g = gain(light, &corners);
    let spread = load_at::<L>(&appearance.spread, k);
    let grey = spread.mul_add(L::splat(light.spread), load_at(&appearance.grey, k));
    let mut columns = [g; COLUMNS];
    for c in 0..SPREAD {
        columns[c] = load_at::<L>(&appearance.by_pose[c], k).mul(g);
    }
    columns[SPREAD] = spread.mul(g);
    columns[BIAS] = L::splat(1.0);
    for c in 0..4 {
        columns[GAINS + c] = corners[c].mul(grey);
    }
    (columns, g)
}

/// The residual that a step leaves.
#[inline(always)]
fn less_step<L: Lanes>(mut r: L, columns: &[L; COLUMNS], step: &[f32; COLUMNS]) -> L {
    for c in 0..COLUMNS {
        r = r.sub(columns[c].mul(L::splat(step[c])));
    }
    r
}

/// The robust weight of a squared whitened residual.
#[inline(always)]
fn weight<L: Lanes>(squared: L, weighing: &Weighing) -> L {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let scale2 = (weighing.scale * weighing.scale) as f32;
    if weighing.is_first_look {
        let u = squared.mul(L::splat(1.0 / (scale2 * FIRST_LOOK * FIRST_LOOK)));
        return one.div(one.add(u));
    }
    let u = one.sub(squared.mul(L::splat(1.0 / (scale2 * TUKEY * TUKEY)))).max(zero);
    u.mul(u)
}

#[inline(always)]
fn total<L: Lanes>(v: L) -> f32 {
    let mut lanes = [0.0; LANES];
    v.store(&mut lanes);
    ((lanes[0] + lanes[4]) + (lanes[2] + lanes[6])) + ((lanes[1] + lanes[5]) + (lanes[3] + lanes[7]))
}

dispatch! {
    /// Sums over the pixels of a run that tell something: their number, predicted, seen, predicted², seen², predicted seen.
    moments, moments_avx2, moments_lanes, (pixels: &Pixels, run: &Run, appearance: &Appearance) -> [f64; 6]
}

#[inline(always)]
fn moments_lanes<L: Lanes>(pixels: &Pixels, run: &Run, appearance: &Appearance) -> [f64; 6] {
    let mut sums = [L::splat(0.0); 6];
    for k in run.range().step_by(LANES) {
        let c = load_at::<L>(&pixels.counts, k);
        let (p, s) = (load_at::<L>(&appearance.grey, k).mul(c), load_at::<L>(&pixels.seen, k).mul(c));
        let terms = [c, p, s, p.mul(p), s.mul(s), p.mul(s)];
        for n in 0..6 {
            sums[n] = sums[n].add(terms[n]);
        }
    }
    let mut totals = [0.0; 6];
    for n in 0..6 {
        totals[n] = f64::from(total(sums[n]));
    }
    totals
}

/// What a run shows at the solution, for the judgement and for correspondences.
#[derive(Debug, Clone, Copy, Default)]
pub struct RunEvidence {
    /// Pixels that tell something.
    pub count: f64,
    /// Of these, with a robust weight above one half.
    pub inliers: f64,
    /// Sum of squared residuals, and of squared residuals over squared gradient (pixels²), of the inliers.
    pub squared_px: f64,
    /// Sums of seen, predicted, their squares and their product.
    pub moments: [f64; 5],
    /// Sum of the noise variance.
    pub noise: f64,
    /// Weighted sums of across², across down, down², across r, down r (gradients of the predicted frame).
    pub shift: [f64; 5],
    /// Weighted sums of the pixel's place: weight, column, row.
    pub place: [f64; 3],
    /// Weighted sums of spread², spread sharper, sharper², spread r, sharper r.
    pub blur: [f64; 5],
}

dispatch! {
    /// Adds the squared whitened residuals that `step` leaves, of one group of [`LANES`] pixels in `stride`, to `squares`.
    squares_after, squares_after_avx2, squares_after_lanes,
    (view: &RunView, step: &[f32; COLUMNS], stride: usize, squares: &mut Vec<f32>)
}

#[inline(always)]
fn squares_after_lanes<L: Lanes>(view: &RunView, step: &[f32; COLUMNS], stride: usize, squares: &mut Vec<f32>) {
    let RunView { pixels, run, appearance, light, residuals } = *view;
    for k in run.range().step_by(LANES * stride) {
        let (columns, _) = columns::<L>(pixels, appearance, light, k);
        let r = less_step(load_at(&residuals.grey, k), &columns, step);
        let mut after = [0.0; LANES];
        r.mul(r).mul(load_at(&residuals.information, k)).store(&mut after);
        for n in 0..LANES {
            if residuals.information[k + n] > 0.0 {
                squares.push(after[n]);
            }
        }
    }
}

dispatch! {
    /// Looks at a run again after `step`.
    evidence, evidence_avx2, evidence_lanes,
    (view: &RunView, step: &[f32; COLUMNS], weighing: &Weighing) -> RunEvidence
}

#[inline(always)]
fn evidence_lanes<L: Lanes>(view: &RunView, step: &[f32; COLUMNS], weighing: &Weighing) -> RunEvidence {
    let RunView { pixels, run, appearance, light, residuals } = *view;
    let zero = L::splat(0.0);
    let mut sums = [zero; 22];
    for k in run.range().step_by(LANES) {
        let (columns, g) = columns::<L>(pixels, appearance, light, k);
        let r = less_step(load_at::<L>(&residuals.grey, k), &columns, step);
        let counts = load_at::<L>(&pixels.counts, k);
        let seen = load_at::<L>(&pixels.seen, k).mul(counts);
        let predicted = seen.sub(r.mul(counts));
        let information = load_at::<L>(&residuals.information, k);
        let robust = weight(r.mul(r).mul(information), weighing).mul(counts);
        let w = robust.mul(information);
        let inlier = robust.sub(L::splat(0.5)).mul(L::splat(1e9)).max(zero).min(L::splat(1.0));
        let (across, down) = (load_at::<L>(&appearance.across, k).mul(g), load_at::<L>(&appearance.down, k).mul(g));
        let steep = across.mul(across).add(down.mul(down)).max(L::splat(1.0));
        let (spread, sharper) = (columns[SPREAD], load_at::<L>(&appearance.sharper, k).mul(g));
        let variance = counts.div(information.max(L::splat(1e-9)));
        let mut columns_at = [0.0; LANES];
        let mut rows_at = [0.0; LANES];
        for lane in 0..LANES {
            [columns_at[lane], rows_at[lane]] = pixels.place(k + lane).map(|v| v as f32);
        }
        let (u, v) = (L::load(&columns_at), L::load(&rows_at));
        let (wa, wd, ws, wx) = (w.mul(across), w.mul(down), w.mul(spread), w.mul(sharper));
        let terms = [
            counts,
            inlier,
            r.mul(r).mul(inlier).div(steep),
            seen,
            predicted,
            seen.mul(seen),
            predicted.mul(predicted),
            seen.mul(predicted),
            variance,
            wa.mul(across),
            wa.mul(down),
            wd.mul(down),
            wa.mul(r),
            wd.mul(r),
            w.mul(steep),
            w.mul(steep).mul(u),
            w.mul(steep).mul(v),
            ws.mul(spread),
            ws.mul(sharper),
            wx.mul(sharper),
            ws.mul(r),
            wx.mul(r),
        ];
        for n in 0..22 {
            sums[n] = sums[n].add(terms[n]);
        }
    }
    let mut s = [0.0; 22];
    for n in 0..22 {
        s[n] = f64::from(total(sums[n]));
    }
    RunEvidence {
        count: s[0],
        inliers: s[1],
        squared_px: s[2],
        moments: [s[3], s[4], s[5], s[6], s[7]],
        noise: s[8],
        shift: [s[9], s[10], s[11], s[12], s[13]],
        place: [s[14], s[15], s[16]],
        blur: [s[17], s[18], s[19], s[20], s[21]],
    }
}
