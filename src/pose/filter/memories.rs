//! Finds how long a memory the motion allows: several filters in parallel, each with a memory four
//! times as long as the previous.
//!
//! A long memory smooths but lags when the motion stops being a parabola. Each filter is trusted
//! until the measurements contradict it: until its innovations, or their mean over a third of its
//! memory, exceed what noise allows. Then it is replaced by the next shorter one and continues from
//! there. So the longest memory is always the longest that the measurements allow. No filter is fed
//! another's output or its own success; only the measurements decide.

use nalgebra::Vector3;

use super::fading::{Fading, Unknown};
use super::place::Place;

/// Number of filters: with [`RATIO`] and [`MAX_S`] the shortest memory is 0.5 ms, below every
/// frame interval. Raised, unnecessary shorter ones are added, each at the cost of its update.
const COUNT: usize = 6;
/// Ratio of each memory to the previous one. Lowered, more filters are needed; raised, the choice
/// is coarse.
const RATIO: f64 = 4.0;
/// The longest memory, seconds. At rest the scatter falls with its root; a drift too slow for it to
/// follow is detected eventually. Raised, that takes longer, and the pose lags until then.
const MAX_S: f64 = 0.5;
/// Squared innovation, relative to its mean of 1, that contradicts a filter. By chance fewer than
/// one in a hundred thousand exceeds it; but measured noise is neither quite normal nor quite
/// white, and at 7 a still camera's filters are replaced every second. Raised, lags last longer.
const CONTRADICTION: f64 = 10.0;
/// Fraction of the memory over which innovations are averaged: a lag shows in their mean long
/// before it shows in a single one. Raised, detection is more reliable and later; lowered, the mean
/// says little more than one innovation.
const MEAN_OVER: f64 = 1.0 / 3.0;

#[derive(Debug, Clone)]
pub(super) struct Memories<P> {
    /// From the shortest memory to the longest.
    filters: [(Fading<P>, Doubt); COUNT],
}

/// The mean innovation of a filter, in standard deviations.
#[derive(Debug, Clone, Copy, Default)]
struct Doubt {
    mean: Vector3<f64>,
    count: f64,
}

impl<P: Place> Memories<P> {
    pub fn at_rest(place: P, variance: f64, unknown: &Unknown) -> Self {
        Self { filters: std::array::from_fn(|_| (Fading::at_rest(place, variance, unknown), Doubt::default())) }
    }

    /// Takes a measurement; `shortest_s` is the shortest useful memory.
    pub fn update(&mut self, step_s: f64, shortest_s: f64, measured: &P, variance: f64) {
        let mut memory_s = MAX_S / RATIO.powi(COUNT as i32 - 1);
        let mut shorter: Option<Fading<P>> = None;
        for (filter, doubt) in &mut self.filters {
            let in_sigmas = match shorter {
                // The first filter has none to fall back to, so it uses the shortest useful memory.
                None => filter.update(step_s, shortest_s.min(MAX_S), measured, variance),
                Some(_) => filter.update(step_s, memory_s.max(shortest_s), measured, variance),
            };
            let is_contradicted = doubt.contradicts(step_s / (MEAN_OVER * memory_s), &in_sigmas);
            if let Some(shorter) = shorter.filter(|_| is_contradicted) {
                (*filter, *doubt) = (shorter, Doubt::default());
            }
            shorter = Some(filter.clone());
            memory_s *= RATIO;
        }
    }

    /// Returns the estimate with the longest memory that the measurements allow.
    pub fn best(&self) -> &Fading<P> {
        &self.filters[COUNT - 1].0
    }
}

impl Doubt {
    /// Takes an innovation; returns whether it or the mean exceeds what noise allows. `step` is in
    /// units of the mean's time constant.
    fn contradicts(&mut self, step: f64, in_sigmas: &Vector3<f64>) -> bool {
        self.count += 1.0;
        let share = (1.0 - (-step).exp()).max(self.count.recip());
        self.mean += (in_sigmas - self.mean) * share;
        // Effective number of independent innovations in the mean.
        let many = (2.0 - share) / share;
        (self.mean.norm_squared() * many).max(in_sigmas.norm_squared()) / 3.0 > CONTRADICTION
    }
}
