//! How long a memory a motion bears: several filters side by side, each with a memory four times as long as the one before.
//!
//! A long memory calms, but lags where the motion is no parabola any more. Each filter is believed until the measurements contradict it:
//! until its innovations, or their mean over a third of its memory, are greater than noise allows. Then it is replaced by the next
//! shorter one and grows from there. The longest memory is thus always the longest one that the measurements allow. No filter is fed
//! with what another one told, and none with its own success: nothing but the measurements decides.

use nalgebra::Vector3;

use super::fading::{Fading, Unknown};
use super::place::Place;

/// How many filters: with [`RATIO`] and [`LONGEST_S`] the shortest memory is 0.5 ms, below every frame
/// interval. Raised, shorter ones are added that no camera needs, and each costs its update.
const COUNT: usize = 6;
/// How much longer each memory is than the one before. Lowered, more filters are needed; raised, the choice is coarse.
const RATIO: f64 = 4.0;
/// The longest memory, seconds. At rest the scatter falls with its root; a drift slower than it can follow
/// is found out in time. Raised, that takes longer, and the pose lags until then.
const LONGEST_S: f64 = 0.5;
/// Squared innovations so far beyond their mean of 1 contradict a filter. By chance less than one in a
/// hundred thousand is; measured noise is neither quite normal nor quite without memory, and with 7 a still
/// camera's filters are thrown away every second. Raised, lags last longer.
const CONTRADICTION: f64 = 10.0;
/// Over this share of the memory innovations are averaged: a lag shows in their mean long before it shows in one of
/// them. Raised, it shows surer and later; lowered, the mean says little more than one of them.
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

    /// Takes a measurement; `shortest_s` is the shortest memory that makes sense.
    pub fn update(&mut self, step_s: f64, shortest_s: f64, measured: &P, variance: f64) {
        let mut memory_s = LONGEST_S / RATIO.powi(COUNT as i32 - 1);
        let mut shorter: Option<Fading<P>> = None;
        for (filter, doubt) in &mut self.filters {
            let in_sigmas = match shorter {
                // The first has nothing to fall back to and is as quick as it may be.
                None => filter.update(step_s, shortest_s.min(LONGEST_S), measured, variance),
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

    /// The estimate with the longest memory that the measurements allow.
    pub fn best(&self) -> &Fading<P> {
        &self.filters[COUNT - 1].0
    }
}

impl Doubt {
    /// Takes an innovation; whether it or the mean is more than noise allows. `step` is in units of the mean's time constant.
    fn contradicts(&mut self, step: f64, in_sigmas: &Vector3<f64>) -> bool {
        self.count += 1.0;
        let share = (1.0 - (-step).exp()).max(self.count.recip());
        self.mean += (in_sigmas - self.mean) * share;
        // Of independent innovations that many are in the mean.
        let many = (2.0 - share) / share;
        (self.mean.norm_squared() * many).max(in_sigmas.norm_squared()) / 3.0 > CONTRADICTION
    }
}
