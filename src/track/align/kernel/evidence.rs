//! What each run of pixels shows at the solution: how well it agrees, how far off its patch lies, and what it says of the blur.

use super::columns::{COLUMNS, PSF_VARIANCE};
use super::normal::{RobustWeighting, RunView, columns, less_step, weight};
use crate::track::align::lanes::{LANES, Lanes, dispatch, load_at, total};

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
    /// Looks at a run again after `step`.
    evidence, evidence_lanes,
    (view: &RunView, step: &[f32; COLUMNS], weighting: &RobustWeighting) -> RunEvidence
}

#[inline(always)]
pub fn evidence_lanes<L: Lanes>(view: &RunView, step: &[f32; COLUMNS], weighting: &RobustWeighting) -> RunEvidence {
    let RunView { pixels, run, appearance, light, residuals } = *view;
    let zero = L::splat(0.0);
    let mut sums = [zero; 22];
    for k in run.range().step_by(LANES) {
        let (columns, g) = columns::<L>(pixels, appearance, light, k);
        let r = less_step(load_at::<L>(&residuals.intensity, k), &columns, step);
        let counts = load_at::<L>(&pixels.counts, k);
        let seen = load_at::<L>(&pixels.seen, k).mul(counts);
        let predicted = seen.sub(r.mul(counts));
        let information = load_at::<L>(&residuals.information, k);
        let robust = weight(r.mul(r).mul(information), weighting).mul(counts);
        let w = robust.mul(information);
        let inlier = robust.sub(L::splat(0.5)).mul(L::splat(1e9)).max(zero).min(L::splat(1.0));
        let (across, down) = (load_at::<L>(&appearance.across, k).mul(g), load_at::<L>(&appearance.down, k).mul(g));
        let steep = across.mul(across).add(down.mul(down)).max(L::splat(1.0));
        let (psf_variance, sharper) = (columns[PSF_VARIANCE], load_at::<L>(&appearance.sharper, k).mul(g));
        let variance = counts.div(information.max(L::splat(1e-9)));
        let (u, v) = (load_at::<L>(&pixels.place[0], k), load_at::<L>(&pixels.place[1], k));
        let (wa, wd, ws, wx) = (w.mul(across), w.mul(down), w.mul(psf_variance), w.mul(sharper));
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
            ws.mul(psf_variance),
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
