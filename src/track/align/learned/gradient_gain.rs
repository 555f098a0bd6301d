//! The gradient gain: the fraction of the predicted gradients that is real, learnt from the steps
//! of the solver.
//!
//! A gradient fitted to the samples inside a pixel passes finer detail than the pixel does. It is
//! the pixel's own gradient plus a part that scatters from pixel to pixel. That scatter counts as
//! information, so steps come out too short (regression dilution, the attenuation by a noisy
//! regressor: Fuller 1987). The ratio of the change that a step made in the prediction to the
//! change that the gradients predicted is the real fraction. With it, steps have the right length,
//! and one is often enough.

use crate::track::align::lanes::{LANES, Lanes, dispatch, load_at, resize_with_room, store_at, total};
use crate::track::align::tuning::TUNING;

/// The fraction of the sampled gradients that is the pixels' own, as learnt so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GradientGain(f64);

impl Default for GradientGain {
    fn default() -> Self {
        Self(TUNING.initial_gradient_gain)
    }
}

impl GradientGain {
    /// Returns the fraction.
    pub fn get(self) -> f64 {
        self.0
    }

    /// Learns from steps whose change was predicted with the gain as it is.
    pub fn learn(&mut self, sums: &ChangeSums) {
        if sums.predicted_squared > TUNING.min_step_change * sums.count {
            let found = sums.product / sums.predicted_squared;
            tracing::trace!(share = self.0, found, "slopes");
            self.0 = (self.0 * (1.0 + TUNING.gradient_gain_learning_rate * (found - 1.0).clamp(-0.5, 0.5)))
                .clamp(TUNING.min_gradient_gain, TUNING.max_gradient_gain);
        }
    }
}

/// Sums over pixels: their number, the squared predicted change, and predicted times real change.
/// The latter two are in squared units of light.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ChangeSums {
    /// Number of pixels that count: not saturated, not clipped to black, no padding.
    pub count: f64,
    /// Sum of the squared predicted changes.
    pub predicted_squared: f64,
    /// Sum of predicted times real change.
    pub product: f64,
}

impl ChangeSums {
    /// Adds the sums of another step.
    pub fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.predicted_squared += other.predicted_squared;
        self.product += other.product;
    }
}

/// The light of pixels before a step, and the change that the gradients predict for it.
#[derive(Debug, Default)]
pub struct PredictedChange {
    intensity: Vec<f32>,
    change: Vec<f32>,
}

impl PredictedChange {
    /// Makes room for `n` pixels, a whole number of lanes.
    pub fn resize(&mut self, n: usize) {
        resize_with_room(&mut self.intensity, n, 0.0);
        resize_with_room(&mut self.change, n, 0.0);
    }

    /// Predicts the change of the pixels of a range, whole lanes. `by_pose`: their derivatives by
    /// the pose; `step`: the change of the pose at their time, in the same order and units.
    pub fn predict(&mut self, intensity: &[f32], by_pose: &[Vec<f32>; 6], step: &[f32; 6], range: std::ops::Range<usize>) {
        self.intensity[range.clone()].copy_from_slice(&intensity[range.clone()]);
        predict_change(by_pose, step, [range.start, range.end], &mut self.change);
    }

    /// Compares the predicted change with the real one. `intensity`: the prediction after the step;
    /// `counts`: 1 for pixels that count, else 0.
    pub fn compare(&self, intensity: &[f32], counts: &[f32]) -> ChangeSums {
        let n = self.intensity.len().min(intensity.len()).min(counts.len()) / LANES * LANES;
        let [count, predicted_squared, product] = compare(self, intensity, counts, n);
        ChangeSums { count, predicted_squared, product }
    }
}

dispatch! {
    /// Computes the change that the gradients predict for the pixels of a range.
    predict_change, predict_change_lanes,
    (by_pose: &[Vec<f32>; 6], step: &[f32; 6], range: [usize; 2], out: &mut [f32])
}

#[inline(always)]
fn predict_change_lanes<L: Lanes>(by_pose: &[Vec<f32>; 6], step: &[f32; 6], range: [usize; 2], out: &mut [f32]) {
    let mut k = range[0];
    while k < range[1] {
        let mut change = L::splat(0.0);
        for c in 0..6 {
            change = load_at::<L>(&by_pose[c], k).mul_add(L::splat(step[c]), change);
        }
        store_at(out, k, change);
        k += LANES;
    }
}

dispatch! {
    /// Computes the fields of [`ChangeSums`], in their order, over the first `n` pixels.
    compare, compare_lanes, (predicted_change: &PredictedChange, intensity: &[f32], counts: &[f32], n: usize) -> [f64; 3]
}

#[inline(always)]
fn compare_lanes<L: Lanes>(predicted_change: &PredictedChange, intensity: &[f32], counts: &[f32], n: usize) -> [f64; 3] {
    let zero = L::splat(0.0);
    let mut sums = [zero; 3];
    let mut k = 0;
    while k < n {
        let counts = load_at::<L>(counts, k);
        let change = load_at::<L>(&predicted_change.change, k).mul(counts);
        let real = load_at::<L>(intensity, k).sub(load_at(&predicted_change.intensity, k));
        sums = [sums[0].add(counts), change.mul_add(change, sums[1]), change.mul_add(real, sums[2])];
        k += LANES;
    }
    let mut totals = [0.0; 3];
    for n in 0..3 {
        totals[n] = f64::from(total(sums[n]));
    }
    totals
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smaller_changes_than_predicted_lower_the_gradient_gain() {
        let n = 64;
        let by_pose: [Vec<f32>; 6] = std::array::from_fn(|c| (0..n).map(|k| ((k * (c + 3)) as f32).sin() * 50.0).collect());
        let step = [0.1, -0.05, 0.2, 0.03, 0.07, -0.1];
        let intensity: Vec<f32> = (0..n).map(|k| k as f32).collect();
        // The last lane of pixels does not count.
        let counts: Vec<f32> = (0..n).map(|k| if k < n - LANES { 1.0 } else { 0.0 }).collect();
        let mut share = GradientGain::default();
        let mut predicted_change = PredictedChange::default();
        predicted_change.resize(n);
        for _ in 0..60 {
            let applied: [Vec<f32>; 6] = std::array::from_fn(|c| by_pose[c].iter().map(|v| v * share.get() as f32).collect());
            predicted_change.predict(&intensity, &applied, &step, 0..n);
            // Eight tenths of the gradients before any gain are real. Pixels that do not count
            // change by something else.
            let after = |k: usize| {
                let change: f32 = (0..6).map(|c| by_pose[c][k] * step[c]).sum();
                intensity[k] + if k < n - LANES { 0.8 * change } else { 99.0 }
            };
            share.learn(&predicted_change.compare(&(0..n).map(after).collect::<Vec<_>>(), &counts));
        }
        assert!((share.get() - 0.8).abs() < 1e-3, "{share:?}");
    }

    #[test]
    fn a_zero_step_does_not_change_the_gradient_gain() {
        let mut share = GradientGain::default();
        share.learn(&ChangeSums { count: 1000.0, predicted_squared: 1.0, product: 0.1 });
        assert_eq!(share, GradientGain::default());
    }
}
