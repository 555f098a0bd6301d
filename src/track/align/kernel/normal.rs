//! The residuals of a tile's pixels, their derivatives and their robust weights.
//!
//! The derivatives are the columns of one alignment step: how the predicted light changes with the
//! pose at the tile's rows, the gains at the tile's corners, the bias and the point spread.
//! `tile_products` sums their products.

use super::columns::{BIAS, COLUMNS, GAINS, PSF_VARIANCE};
use crate::geometry::robust_kernel;
use crate::light::transfer::FULL;
use crate::track::align::lanes::{LANES, Lanes, dispatch, load_at, resize_with_room, store_at, total};
use crate::track::align::learned::light::TileLight;
use crate::track::align::learned::noise::Noise;
use crate::track::align::pixels::appearance::Appearance;
use crate::track::align::pixels::runs::{Pixels, Run};
use crate::track::align::tuning::TUNING;

/// Tukey's biweight: residuals beyond this many robust sigmas have no weight. See
/// [`robust_kernel::TUKEY`].
const TUKEY: f32 = robust_kernel::TUKEY as f32;

/// How residuals are weighted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobustWeighting {
    /// Robust standard deviation of the whitened residuals.
    pub residual_sigma: f64,
    /// Whether to use Cauchy's weights, which never vanish, instead of Tukey's: for a start that
    /// may be far off.
    pub is_first_pass: bool,
    /// Only one group of [`LANES`] pixels in `stride` is used: a rough step, needed only for the
    /// weights, does with some of them.
    pub stride: usize,
}

/// Residuals and their information at the linearisation, per pixel.
#[derive(Debug, Default)]
pub struct Residuals {
    /// Seen minus predicted light, in units of which white is 255.
    pub intensity: Vec<f32>,
    /// Inverse of the variance by noise and model error; 0 where a pixel does not count.
    pub information: Vec<f32>,
}

impl Residuals {
    /// Makes room for `n` pixels, none of which counts yet.
    pub fn resize(&mut self, n: usize) {
        for list in [&mut self.intensity, &mut self.information] {
            list.clear();
            resize_with_room(list, n, 0.0);
        }
    }
}

dispatch! {
    /// Computes the residuals of a run at the linearisation, and their information.
    residuals, residuals_lanes,
    (pixels: &Pixels, run: &Run, appearance: &Appearance, light: &TileLight, noise: &Noise, out: &mut Residuals)
}

/// A run with all that is known of its pixels at the linearisation.
#[derive(Clone, Copy)]
pub struct RunView<'a> {
    /// All pixels of the level.
    pub pixels: &'a Pixels,
    /// The range of the run.
    pub run: &'a Run,
    /// The prediction of all pixels.
    pub appearance: &'a Appearance,
    /// The light of the run's tile.
    pub light: &'a TileLight,
    /// The residuals of all pixels.
    pub residuals: &'a Residuals,
}

/// Returns the weights, at each pixel, of the gains at the corners of its cell.
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
        let intensity = load_at::<L>(&appearance.psf_variance, k).mul_add(L::splat(light.psf_variance), load_at(&appearance.intensity, k));
        let seen = load_at::<L>(&pixels.seen, k);
        let residual = seen.sub(g.mul_add(intensity, L::splat(light.bias)));
        let (across, down) = (load_at::<L>(&appearance.across, k), load_at::<L>(&appearance.down, k));
        let steep = across.mul(across).add(down.mul(down)).mul(g).mul(g);
        let expected = g.mul_add(intensity, L::splat(light.bias)).max(L::splat(0.0));
        let variance =
            steep.mul_add(L::splat(noise.model_px * noise.model_px), expected.mul_add(L::splat(noise.per_intensity), L::splat(noise.dark)));
        let information = load_at::<L>(&pixels.counts, k).mul(one.div(variance));
        store_at(&mut out.intensity, k, residual);
        store_at(&mut out.information, k, information);
    }
}

/// Returns the columns of [`LANES`] pixels (the derivatives of the predicted light), and the gain
/// there.
#[inline(always)]
pub fn columns<L: Lanes>(pixels: &Pixels, appearance: &Appearance, light: &TileLight, k: usize) -> ([L; COLUMNS], L) {
    let corners = corner_weights::<L>(pixels, k);
    let g = gain(light, &corners);
    let psf_variance = load_at::<L>(&appearance.psf_variance, k);
    let intensity = psf_variance.mul_add(L::splat(light.psf_variance), load_at(&appearance.intensity, k));
    let mut columns = [g; COLUMNS];
    for c in 0..PSF_VARIANCE {
        columns[c] = load_at::<L>(&appearance.by_pose[c], k).mul(g);
    }
    columns[PSF_VARIANCE] = psf_variance.mul(g);
    columns[BIAS] = L::splat(1.0);
    for c in 0..4 {
        columns[GAINS + c] = corners[c].mul(intensity);
    }
    (columns, g)
}

/// Returns the residual after a step.
#[inline(always)]
pub fn less_step<L: Lanes>(mut r: L, columns: &[L; COLUMNS], step: &[f32; COLUMNS]) -> L {
    for c in 0..COLUMNS {
        r = r.sub(columns[c].mul(L::splat(step[c])));
    }
    r
}

/// Returns the robust weight of a squared whitened residual.
#[inline(always)]
pub fn weight<L: Lanes>(squared: L, weighting: &RobustWeighting) -> L {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let variance = (weighting.residual_sigma * weighting.residual_sigma) as f32;
    if weighting.is_first_pass {
        let u = squared.mul(L::splat(1.0 / (variance * TUNING.first_pass_half_weight_sigmas * TUNING.first_pass_half_weight_sigmas)));
        return one.div(one.add(u));
    }
    let u = one.sub(squared.mul(L::splat(1.0 / (variance * TUKEY * TUKEY)))).max(zero);
    u.mul(u)
}

dispatch! {
    /// Returns the cost of a run's residuals at the linearisation: the sum of Tukey's costs, in
    /// robust sigmas. It is half the sum of squares where residuals are small, and constant beyond
    /// [`TUKEY`] sigmas.
    robust_cost, robust_cost_lanes, (pixels: &Pixels, run: &Run, residuals: &Residuals, residual_sigma: f64) -> f64
}

#[inline(always)]
fn robust_cost_lanes<L: Lanes>(pixels: &Pixels, run: &Run, residuals: &Residuals, residual_sigma: f64) -> f64 {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let per_square = L::splat((residual_sigma * residual_sigma).recip() as f32 / (TUKEY * TUKEY));
    let mut sum = zero;
    for k in run.range().step_by(LANES) {
        let r = load_at::<L>(&residuals.intensity, k);
        let squared = r.mul(r).mul(load_at(&residuals.information, k));
        let u = one.sub(squared.mul(per_square)).max(zero);
        sum = sum.add(load_at::<L>(&pixels.counts, k).mul(one.sub(u.mul(u).mul(u))));
    }
    f64::from(TUKEY * TUKEY / 6.0 * total(sum))
}

/// Returns the square root of light, 0 to 255. Pixels are correlated by it: in light, highlights
/// outweigh all else, while its root is about as noisy in the dark as in the bright (Anscombe
/// 1948).
#[inline(always)]
pub fn root<L: Lanes>(light: L) -> L {
    light.max(L::splat(0.0)).mul(L::splat(FULL)).sqrt()
}

/// Returns the variance of the root of light, per variance of the light.
#[inline(always)]
pub fn root_variance_ratio<L: Lanes>(light: L) -> L {
    L::splat(0.25 * FULL).div(light.max(L::splat(MIN_ROOTED_LIGHT)))
}

/// Does the same for one light.
pub fn root_variance_ratio_of(light: f64) -> f64 {
    f64::from(0.25 * FULL) / light.max(MIN_ROOTED_LIGHT.into())
}

/// Minimum light for the variance of its root: below, the root is steeper than noise allows.
/// Raised, dark tiles seem less noisy than they are.
const MIN_ROOTED_LIGHT: f32 = 1.0;

dispatch! {
    /// Sums over the counting pixels of a run: their number, predicted, seen, predicted², predicted
    /// times seen; then, of the [`root`]s of both: predicted, seen, predicted², seen², predicted
    /// times seen.
    moments, moments_lanes, (pixels: &Pixels, run: &Run, appearance: &Appearance) -> [f64; 10]
}

#[inline(always)]
fn moments_lanes<L: Lanes>(pixels: &Pixels, run: &Run, appearance: &Appearance) -> [f64; 10] {
    let mut sums = [L::splat(0.0); 10];
    for k in run.range().step_by(LANES) {
        let c = load_at::<L>(&pixels.counts, k);
        let (p, s) = (load_at::<L>(&appearance.intensity, k).mul(c), load_at::<L>(&pixels.seen, k).mul(c));
        let (rp, rs) = (root(p), root(s));
        let terms = [c, p, s, p.mul(p), p.mul(s), rp, rs, rp.mul(rp), rs.mul(rs), rp.mul(rs)];
        for n in 0..10 {
            sums[n] = sums[n].add(terms[n]);
        }
    }
    let mut totals = [0.0; 10];
    for n in 0..10 {
        totals[n] = f64::from(total(sums[n]));
    }
    totals
}

dispatch! {
    /// Appends to `squares` the squared whitened residuals after `step`, of one group of [`LANES`]
    /// pixels in `stride`.
    squares_after, squares_after_lanes,
    (view: &RunView, step: &[f32; COLUMNS], stride: usize, squares: &mut Vec<f32>)
}

#[inline(always)]
fn squares_after_lanes<L: Lanes>(view: &RunView, step: &[f32; COLUMNS], stride: usize, squares: &mut Vec<f32>) {
    let RunView { pixels, run, appearance, light, residuals } = *view;
    for k in run.range().step_by(LANES * stride) {
        let (columns, _) = columns::<L>(pixels, appearance, light, k);
        let r = less_step(load_at(&residuals.intensity, k), &columns, step);
        let mut after = [0.0; LANES];
        r.mul(r).mul(load_at(&residuals.information, k)).store(&mut after);
        for n in 0..LANES {
            if residuals.information[k + n] > 0.0 {
                squares.push(after[n]);
            }
        }
    }
}
