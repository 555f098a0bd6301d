//! What each run of pixels shows at the solution: how well it agrees with the prediction, how far
//! its patch is displaced, and what its blur says about the exposure.

use super::columns::{COLUMNS, PSF_VARIANCE};
use super::normal::{RobustWeighting, RunView, columns, less_step, root, root_variance_ratio, weight};
use crate::track::align::lanes::{LANES, Lanes, dispatch, load_at, total};

/// What a run shows at the solution, for the verdict and for correspondences. r is the residual
/// (seen minus predicted light) and w its robust weight times its information.
#[derive(Debug, Clone, Copy, Default)]
pub struct RunEvidence {
    /// Number of pixels that are neither saturated, clipped to black, nor padding.
    pub count: f64,
    /// Number of these with a robust weight above one half.
    pub inliers: f64,
    /// Sum over the inliers of the squared residual divided by the squared gradient (at least 1),
    /// pixels².
    pub squared_px: f64,
    /// Sums over the pixels, of the [`root`]s of light: seen, predicted, seen², predicted², seen
    /// times predicted.
    pub moments: [f64; 5],
    /// Sum of the noise variance of the roots.
    pub noise: f64,
    /// Sums of w times across², across down, down², across r, down r, where across and down are the
    /// gradients of the predicted frame per pixel of the level.
    pub shift: [f64; 5],
    /// Sums of v, v column, v row, where v is w times the squared gradient (at least 1): the place
    /// of the patch.
    pub place: [f64; 3],
    /// Sums of w times p², p s, s², p r, s r, where p is the derivative by the point spread and s
    /// the sharpening (see `Appearance::sharper`).
    pub blur: [f64; 5],
}

dispatch! {
    /// Evaluates a run after `step` (in the columns of its tile).
    evidence, evidence_lanes,
    (view: &RunView, step: &[f32; COLUMNS], weighting: &RobustWeighting) -> RunEvidence
}

/// Does the work of [`evidence`], for one type of lanes.
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
        let variance = counts.div(information.max(L::splat(1e-9))).mul(root_variance_ratio(seen));
        let (root_seen, root_predicted) = (root(seen), root(predicted));
        let (u, v) = (load_at::<L>(&pixels.place[0], k), load_at::<L>(&pixels.place[1], k));
        let (wa, wd, ws, wx) = (w.mul(across), w.mul(down), w.mul(psf_variance), w.mul(sharper));
        let terms = [
            counts,
            inlier,
            r.mul(r).mul(inlier).div(steep),
            root_seen,
            root_predicted,
            root_seen.mul(root_seen),
            root_predicted.mul(root_predicted),
            root_seen.mul(root_predicted),
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
