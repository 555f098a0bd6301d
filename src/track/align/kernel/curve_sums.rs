//! What the pixels of a frame say about the camera's curve: their residuals, as a function of grey.

use nalgebra::{Matrix2, SMatrix, SVector};

use super::columns::COLUMNS;
use super::normal::{RobustWeighting, RunView, columns, less_step, weight};
use crate::light::CameraCurve;
use crate::light::camera_curve::{KNOTS, knots_at};
use crate::track::align::lanes::{LANES, Lanes, dispatch, load_at};
use crate::track::align::learned::camera_curve::CurveSums;

impl CurveSums {
    /// Adds the residuals of a run after `step`, without what a gain and a bias of the run explain.
    /// `curve`: that of the camera, by which its greys were decoded.
    pub fn add(&mut self, view: &RunView, step: &[f32; COLUMNS], weighting: &RobustWeighting, curve: &CameraCurve) {
        let mut sums = RunSums::default();
        let mut pixels = PixelLanes::default();
        for k in view.run.range().step_by(LANES) {
            weighted(view, step, weighting, k, &mut pixels);
            for ((light, residual), w) in pixels.light.iter().zip(&pixels.residual).zip(&pixels.weight) {
                if *w > 0.0 {
                    sums.add(*light, *residual, f64::from(*w), curve);
                }
            }
        }
        if let Some((by_each_other, by_correction)) = sums.beyond_gain_and_bias() {
            self.by_each_other += by_each_other;
            self.by_correction += by_correction;
        }
    }
}

/// Predicted light, residual and weight of a group of pixels.
#[derive(Default)]
pub(in crate::track::align) struct PixelLanes {
    light: [f32; LANES],
    residual: [f32; LANES],
    weight: [f32; LANES],
}

dispatch! {
    /// Computes the predicted light, the residual and the weight of the group of pixels from `k`
    /// on, after `step`.
    weighted, weighted_lanes,
    (view: &RunView, step: &[f32; COLUMNS], weighting: &RobustWeighting, k: usize, out: &mut PixelLanes)
}

#[inline(always)]
fn weighted_lanes<L: Lanes>(view: &RunView, step: &[f32; COLUMNS], weighting: &RobustWeighting, k: usize, out: &mut PixelLanes) {
    let RunView { pixels, appearance, light, residuals, .. } = *view;
    let (columns, _) = columns::<L>(pixels, appearance, light, k);
    let r = less_step(load_at::<L>(&residuals.intensity, k), &columns, step);
    let information = load_at::<L>(&residuals.information, k);
    let w = weight(r.mul(r).mul(information), weighting).mul(information).mul(load_at(&pixels.counts, k));
    load_at::<L>(&pixels.seen, k).sub(r).store(&mut out.light);
    r.store(&mut out.residual);
    w.store(&mut out.weight);
}

/// Weighted sums over a run: of the nuisances (1 and the light), the knots' weights, and the
/// correction that is asked for.
#[derive(Default)]
struct RunSums {
    nuisances: Matrix2<f64>,
    knots: SMatrix<f64, KNOTS, KNOTS>,
    both: SMatrix<f64, KNOTS, 2>,
    nuisances_by_correction: SVector<f64, 2>,
    knots_by_correction: SVector<f64, KNOTS>,
}

impl RunSums {
    fn add(&mut self, light: f32, residual: f32, w: f64, curve: &CameraCurve) {
        let knots = knots_at(curve.grey_of(light)).map(|(knot, weight)| (knot, f64::from(weight)));
        // The correction in use is part of the light seen; a residual asks for less of it.
        let in_use: f64 = knots.iter().map(|(knot, weight)| weight * f64::from(curve.bend()[*knot])).sum();
        let (correction, nuisances) = (in_use - f64::from(residual), SVector::<f64, 2>::new(1.0, f64::from(light)));
        self.nuisances += nuisances * nuisances.transpose() * w;
        self.nuisances_by_correction += nuisances * (w * correction);
        for (i, a) in knots {
            for (j, b) in knots {
                self.knots[(i, j)] += w * a * b;
            }
            self.both[(i, 0)] += w * a * nuisances[0];
            self.both[(i, 1)] += w * a * nuisances[1];
            self.knots_by_correction[i] += w * a * correction;
        }
    }

    /// Returns the sums of the knots after the nuisances are eliminated; `None` where the run shows
    /// one light only.
    fn beyond_gain_and_bias(&self) -> Option<(SMatrix<f64, KNOTS, KNOTS>, SVector<f64, KNOTS>)> {
        let inverse = self.nuisances.try_inverse().filter(|inverse| inverse.iter().all(|v| v.is_finite()))?;
        let by = self.both * inverse;
        Some((self.knots - by * self.both.transpose(), self.knots_by_correction - by * self.nuisances_by_correction))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_gain_and_a_bias_explain_is_left_out() {
        let curve = CameraCurve::default();
        let mut sums = RunSums::default();
        // The residual of a gain that is a tenth too small and a bias that is 3 too large.
        (0..=250).for_each(|light| sums.add(light as f32, 0.1 * light as f32 - 3.0, 1.0, &curve));
        let (_, by_correction) = sums.beyond_gain_and_bias().expect("more than one light");
        assert!(by_correction.norm() < 1e-3 * sums.knots_by_correction.norm(), "{by_correction}");
    }

    #[test]
    fn the_correction_that_residuals_ask_for_is_found() {
        let truth = CameraCurve::default().with_bend(&[1.0, 3.0, 6.0, 10.0, 8.0, 4.0, 2.0]);
        let curve = CameraCurve::default();
        let mut sums = RunSums::default();
        // Seen by the wrong curve minus the light that is there.
        for grey in 1..250usize {
            let (seen, light) = (curve.light()[grey], truth.light()[grey]);
            sums.add(light, seen - light, 1.0, &curve);
        }
        let (by_each_other, by_correction) = sums.beyond_gain_and_bias().expect("more than one light");
        // A gain and a bias are free, so compare what they cannot explain.
        let expected = by_each_other * SVector::from(truth.bend().map(f64::from));
        assert!((by_correction - expected).norm() < 0.15 * expected.norm(), "{by_correction} {expected}");
    }

    #[test]
    fn a_run_of_one_light_says_nothing() {
        let mut sums = RunSums::default();
        (0..20).for_each(|_| sums.add(100.0, 1.0, 1.0, &CameraCurve::default()));
        assert!(sums.beyond_gain_and_bias().is_none_or(|(sums, _)| sums.norm() < 1e-6));
    }
}
