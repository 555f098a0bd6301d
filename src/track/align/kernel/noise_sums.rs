//! What the pixels of a frame say about the camera's noise: their squared residuals, as a function
//! of light and gradient. [`NoiseSums`] are the sums of that linear fit.

use crate::track::align::tuning::TUNING;
use nalgebra::{Matrix3, Vector3};

use super::columns::COLUMNS;
use super::normal::{RobustWeighting, RunView, columns, less_step};
use crate::track::align::lanes::{LANES, Lanes, dispatch, load_at, total};
use crate::track::align::learned::noise::NoiseSums;

/// Variance of a standard normal distribution that is cut off at three sigmas, as
/// `max_squared_noise_residual` does.
pub const TRUNCATED_VARIANCE: f64 = 0.9733;

impl NoiseSums {
    /// Adds the residuals of a run after `step`.
    pub fn add(&mut self, view: &RunView, step: &[f32; COLUMNS], weighting: &RobustWeighting) {
        let [aa, ag, as_, gg, gs, ss, ra, rg, rs] = noise_sums(view, step, weighting).map(f64::from);
        self.by_each_other += Matrix3::new(aa, ag, as_, ag, gg, gs, as_, gs, ss);
        self.by_squared += Vector3::new(ra, rg, rs) / TRUNCATED_VARIANCE;
    }
}

dispatch! {
    /// Sums over a run after `step`, weighted by the squared inverse of the variance: products of
    /// 1, light and squared gradient with each other (six), and with the squared residual (three).
    noise_sums, noise_sums_lanes,
    (view: &RunView, step: &[f32; COLUMNS], weighting: &RobustWeighting) -> [f32; 9]
}

/// Does the work of [`noise_sums`], for one type of lanes.
#[inline(always)]
pub fn noise_sums_lanes<L: Lanes>(view: &RunView, step: &[f32; COLUMNS], weighting: &RobustWeighting) -> [f32; 9] {
    let RunView { pixels, run, appearance, light, residuals } = *view;
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let largest = L::splat(TUNING.max_squared_noise_residual * (weighting.residual_sigma * weighting.residual_sigma) as f32);
    let mut sums = [zero; 9];
    for k in run.range().step_by(LANES * weighting.stride) {
        let (columns, g) = columns::<L>(pixels, appearance, light, k);
        let r = less_step(load_at::<L>(&residuals.intensity, k), &columns, step);
        let information = load_at::<L>(&residuals.information, k);
        let squared = r.mul(r);
        // 1 where the residual is small enough to be noise and the pixel counts, else 0.
        let is_noise = largest.sub(squared.mul(information)).mul(L::splat(1e9)).max(zero).min(one).mul(load_at(&pixels.counts, k));
        let w = information.mul(information).mul(is_noise);
        let intensity = load_at::<L>(&pixels.seen, k).sub(r).max(zero);
        let (across, down) = (load_at::<L>(&appearance.across, k).mul(g), load_at::<L>(&appearance.down, k).mul(g));
        let steep = across.mul(across).add(down.mul(down));
        let (wg, ws) = (w.mul(intensity), w.mul(steep));
        let terms = [w, wg, ws, wg.mul(intensity), wg.mul(steep), ws.mul(steep), w.mul(squared), wg.mul(squared), ws.mul(squared)];
        for n in 0..9 {
            sums[n] = sums[n].add(terms[n]);
        }
    }
    let mut totals = [0.0; 9];
    for n in 0..9 {
        totals[n] = total(sums[n]);
    }
    totals
}
