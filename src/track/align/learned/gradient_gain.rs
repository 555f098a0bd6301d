//! How steep the prediction really is, learnt from steps.
//!
//! A slope over the samples inside a pixel lets finer detail through than the pixel does: it is the pixel's own slope and something beside
//! it, which scatters from pixel to pixel. That scatter counts as information, and steps come out too short (the dilution of a
//! regression whose regressor is noisy: Fuller 1987). What a step changed in the prediction, over what its slopes predicted, is
//! the share of the slopes that is real; with it steps are as long as they should be, and one of them is often enough.

use crate::track::align::lanes::{LANES, Lanes, dispatch, load_at, resize_with_room, store_at, total};

/// The share that slopes are begun with, and the least and most it may become. Learnt are 0.97 of the usual on d-handheld and 0.8 on the
/// steepest views of d-steep; the bounds lie beyond, against frames that mislead. A share that is too large makes steps too short, too
/// small too long.
const USUAL: f64 = 0.95;
const LEAST: f64 = 0.7;
const MOST: f64 = 1.1;
/// Share of the difference to a frame's estimate that is taken over each frame: a memory of some ten frames. Chosen, not tuned. Raised, the
/// share follows single frames; lowered, steps stay too short or too long for longer when the view changes.
const FOLLOWS: f64 = 0.2;
/// Least mean squared change of a step that is learnt from, grey levels²: a tenth of a level. Chosen: of smaller changes the rounding of
/// texels to whole levels is a large part. Raised, slow cameras never learn the share.
const MIN_CHANGE: f64 = 0.01;

/// The share of the slopes over samples that is the pixels' own, as learnt so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GradientGain(f64);

impl Default for GradientGain {
    fn default() -> Self {
        Self(USUAL)
    }
}

impl GradientGain {
    /// The share.
    pub fn get(self) -> f64 {
        self.0
    }

    /// Learns from a step whose change was predicted with the gain as it is.
    pub fn learn(&mut self, sums: &ChangeSums) {
        if sums.predicted_squared > MIN_CHANGE * sums.count {
            let found = sums.product / sums.predicted_squared;
            tracing::trace!(share = self.0, found, "slopes");
            self.0 = (self.0 * (1.0 + FOLLOWS * (found - 1.0).clamp(-0.5, 0.5))).clamp(LEAST, MOST);
        }
    }
}

/// Sums over pixels: their number, the predicted change squared, and that times the real one.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ChangeSums {
    /// Pixels that tell something.
    pub count: f64,
    /// Of the change that the slopes predict.
    pub predicted_squared: f64,
    /// Of the predicted and the real change.
    pub product: f64,
}

impl ChangeSums {
    /// Adds those of another step.
    pub fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.predicted_squared += other.predicted_squared;
        self.product += other.product;
    }
}

/// The grey of pixels before a step, and the change that the slopes predict.
#[derive(Debug, Default)]
pub struct PredictedChange {
    intensity: Vec<f32>,
    change: Vec<f32>,
}

impl PredictedChange {
    /// Makes room for `n` pixels.
    pub fn resize(&mut self, n: usize) {
        resize_with_room(&mut self.intensity, n, 0.0);
        resize_with_room(&mut self.change, n, 0.0);
    }

    /// Predicts the pixels of a range. `by_pose`: their derivatives; `step`: the change of pose at their time.
    pub fn predict(&mut self, intensity: &[f32], by_pose: &[Vec<f32>; 6], step: &[f32; 6], range: std::ops::Range<usize>) {
        self.intensity[range.clone()].copy_from_slice(&intensity[range.clone()]);
        predict_change(by_pose, step, [range.start, range.end], &mut self.change);
    }

    /// What became of that. `grey`: after the step; `counts`: 1 for pixels that tell something.
    pub fn compare(&self, intensity: &[f32], counts: &[f32]) -> ChangeSums {
        let n = self.intensity.len().min(intensity.len()).min(counts.len()) / LANES * LANES;
        let [count, predicted_squared, product] = compare(self, intensity, counts, n);
        ChangeSums { count, predicted_squared, product }
    }
}

dispatch! {
    /// The change that slopes predict for the pixels of a range.
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
    /// The sums over the first `n` pixels.
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
    fn steps_that_change_less_than_predicted_flatten_the_slopes() {
        let n = 64;
        let by_pose: [Vec<f32>; 6] = std::array::from_fn(|c| (0..n).map(|k| ((k * (c + 3)) as f32).sin() * 50.0).collect());
        let step = [0.1, -0.05, 0.2, 0.03, 0.07, -0.1];
        let intensity: Vec<f32> = (0..n).map(|k| k as f32).collect();
        // The last lane of pixels tells nothing.
        let counts: Vec<f32> = (0..n).map(|k| if k < n - LANES { 1.0 } else { 0.0 }).collect();
        let mut share = GradientGain::default();
        let mut predicted_change = PredictedChange::default();
        predicted_change.resize(n);
        for _ in 0..60 {
            let applied: [Vec<f32>; 6] = std::array::from_fn(|c| by_pose[c].iter().map(|v| v * share.get() as f32).collect());
            predicted_change.predict(&intensity, &applied, &step, 0..n);
            // Eight tenths of the slopes as they are without any share are real; where nothing is told, all is other.
            let after = |k: usize| {
                let change: f32 = (0..6).map(|c| by_pose[c][k] * step[c]).sum();
                intensity[k] + if k < n - LANES { 0.8 * change } else { 99.0 }
            };
            share.learn(&predicted_change.compare(&(0..n).map(after).collect::<Vec<_>>(), &counts));
        }
        assert!((share.get() - 0.8).abs() < 1e-3, "{share:?}");
    }

    #[test]
    fn a_step_of_nothing_tells_nothing() {
        let mut share = GradientGain::default();
        share.learn(&ChangeSums { count: 1000.0, predicted_squared: 1.0, product: 0.1 });
        assert_eq!(share, GradientGain::default());
    }
}
