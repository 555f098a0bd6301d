//! How steep the prediction really is, learnt from steps.
//!
//! A slope over the looks inside a pixel lets finer detail through than the pixel does: it is the pixel's own slope and something beside
//! it, which scatters from pixel to pixel. That scatter counts as information, and steps come out too short (the dilution of a
//! regression whose regressor is noisy: Fuller 1987). What a step changed in the prediction, over what its slopes foretold, is
//! the share of the slopes that is real; with it steps are as long as they should be, and one of them is often enough.

use super::lanes::{LANES, Lanes, dispatch, load_at, store_at, total};

/// The share that slopes are begun with, and the least and most it may become.
const USUAL: f64 = 0.95;
const LEAST: f64 = 0.7;
const MOST: f64 = 1.1;
/// It follows what a step shows by this.
const FOLLOWS: f64 = 0.2;
/// A step must foretell a mean squared change of so many grey levels to tell anything.
const LEAST_CHANGE: f64 = 0.01;

/// The share of the slopes over looks that is the pixels' own, as learnt so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SlopeShare(f64);

impl Default for SlopeShare {
    fn default() -> Self {
        Self(USUAL)
    }
}

impl SlopeShare {
    /// The share.
    pub fn get(self) -> f64 {
        self.0
    }

    /// Learns from a step that was foretold with the share as it is.
    pub fn learn(&mut self, sums: &ChangeSums) {
        if sums.foretold_squared > LEAST_CHANGE * sums.count {
            let found = sums.product / sums.foretold_squared;
            tracing::trace!(share = self.0, found, "slopes");
            self.0 = (self.0 * (1.0 + FOLLOWS * (found - 1.0).clamp(-0.5, 0.5))).clamp(LEAST, MOST);
        }
    }
}

/// Sums over pixels: their number, the foretold change squared, and that times the real one.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ChangeSums {
    /// Pixels that tell something.
    pub count: f64,
    /// Of the change that the slopes foretold.
    pub foretold_squared: f64,
    /// Of the foretold and the real change.
    pub product: f64,
}

impl ChangeSums {
    /// Adds those of another step.
    pub fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.foretold_squared += other.foretold_squared;
        self.product += other.product;
    }
}

/// The grey of pixels before a step, and the change that the slopes foretell.
#[derive(Debug, Default)]
pub struct Foretold {
    grey: Vec<f32>,
    change: Vec<f32>,
}

impl Foretold {
    /// Makes room for `n` pixels.
    pub fn resize(&mut self, n: usize) {
        self.grey.resize(n, 0.0);
        self.change.resize(n, 0.0);
    }

    /// Foretells the pixels of a range. `by_pose`: their derivatives; `step`: the change of pose at their time.
    pub fn foretell(&mut self, grey: &[f32], by_pose: &[Vec<f32>; 6], step: &[f32; 6], range: std::ops::Range<usize>) {
        self.grey[range.clone()].copy_from_slice(&grey[range.clone()]);
        foretell(by_pose, step, [range.start, range.end], &mut self.change);
    }

    /// What became of that. `grey`: after the step; `counts`: 1 for pixels that tell something.
    pub fn compare(&self, grey: &[f32], counts: &[f32]) -> ChangeSums {
        let n = self.grey.len().min(grey.len()).min(counts.len()) / LANES * LANES;
        let [count, foretold_squared, product] = compare(self, grey, counts, n);
        ChangeSums { count, foretold_squared, product }
    }
}

dispatch! {
    /// The change that slopes foretell for the pixels of a range.
    foretell, foretell_avx2, foretell_lanes,
    (by_pose: &[Vec<f32>; 6], step: &[f32; 6], range: [usize; 2], out: &mut [f32])
}

#[inline(always)]
fn foretell_lanes<L: Lanes>(by_pose: &[Vec<f32>; 6], step: &[f32; 6], range: [usize; 2], out: &mut [f32]) {
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
    compare, compare_avx2, compare_lanes, (foretold: &Foretold, grey: &[f32], counts: &[f32], n: usize) -> [f64; 3]
}

#[inline(always)]
fn compare_lanes<L: Lanes>(foretold: &Foretold, grey: &[f32], counts: &[f32], n: usize) -> [f64; 3] {
    let zero = L::splat(0.0);
    let mut sums = [zero; 3];
    let mut k = 0;
    while k < n {
        let counts = load_at::<L>(counts, k);
        let change = load_at::<L>(&foretold.change, k).mul(counts);
        let real = load_at::<L>(grey, k).sub(load_at(&foretold.grey, k));
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
    fn steps_that_change_less_than_foretold_flatten_the_slopes() {
        let n = 64;
        let by_pose: [Vec<f32>; 6] = std::array::from_fn(|c| (0..n).map(|k| ((k * (c + 3)) as f32).sin() * 50.0).collect());
        let step = [0.1, -0.05, 0.2, 0.03, 0.07, -0.1];
        let grey: Vec<f32> = (0..n).map(|k| k as f32).collect();
        // The last lane of pixels tells nothing.
        let counts: Vec<f32> = (0..n).map(|k| if k < n - LANES { 1.0 } else { 0.0 }).collect();
        let mut share = SlopeShare::default();
        let mut foretold = Foretold::default();
        foretold.resize(n);
        for _ in 0..60 {
            let applied: [Vec<f32>; 6] = std::array::from_fn(|c| by_pose[c].iter().map(|v| v * share.get() as f32).collect());
            foretold.foretell(&grey, &applied, &step, 0..n);
            // Eight tenths of the slopes as they are without any share are real; where nothing is told, all is other.
            let after = |k: usize| {
                let change: f32 = (0..6).map(|c| by_pose[c][k] * step[c]).sum();
                grey[k] + if k < n - LANES { 0.8 * change } else { 99.0 }
            };
            share.learn(&foretold.compare(&(0..n).map(after).collect::<Vec<_>>(), &counts));
        }
        assert!((share.get() - 0.8).abs() < 1e-3, "{share:?}");
    }

    #[test]
    fn a_step_of_nothing_tells_nothing() {
        let mut share = SlopeShare::default();
        share.learn(&ChangeSums { count: 1000.0, foretold_squared: 1.0, product: 0.1 });
        assert_eq!(share, SlopeShare::default());
    }
}
