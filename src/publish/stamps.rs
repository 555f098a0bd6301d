//! The origin of frame stamps, and the interval between frames.

use std::collections::VecDeque;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use super::clocks::{Clocks, SystemClocks};
use crate::frame::Timestamp;

/// The clock of a source's stamps.
#[derive(Debug, Clone)]
pub enum Stamps {
    /// A camera on this machine: CLOCK_MONOTONIC.
    Live,
    /// A clip, with any epoch. It is sent as if its first frame had been taken when the clip
    /// started.
    Recorded(ClipStart),
}

/// When a clip started to play, as stated by its player; otherwise the time at which work on its
/// first frame began.
#[derive(Debug, Clone, Default)]
pub struct ClipStart {
    /// Monotonic clock minus stamp, nanoseconds.
    offset_ns: Arc<OnceLock<i64>>,
}

impl ClipStart {
    /// States that the frame with this stamp is delivered now. Only the first call counts.
    pub fn begin(&self, stamp: Timestamp) {
        self.offset_ns.get_or_init(|| SystemClocks.read().monotonic.ns_since(stamp));
    }

    /// Returns monotonic clock minus stamp, nanoseconds, once the clip has started.
    pub(super) fn offset_ns(&self) -> Option<i64> {
        self.offset_ns.get().copied()
    }
}

/// Estimates the interval between frames from their stamps.
#[derive(Debug, Clone, Default)]
pub(super) struct Pace {
    last: Option<Timestamp>,
    steps: VecDeque<Duration>,
}

/// Number of steps whose median is the interval. Up to four outliers, such as a stall or dropped
/// frames, do not change it. Raised, a new rate is noticed later.
const STEPS: usize = 9;
/// Minimum number of steps for an estimate: the fewest of which a median tolerates one outlier.
/// With fewer, the source's stated rate is used. Raised, a wrongly stated rate is used for longer.
const FEW_STEPS: usize = 3;
/// Common camera rates, frames per second; a measured rate within 2 % is rounded to them.
const USUAL_HZ: [f64; 9] = [15.0, 24.0, 25.0, 30.0, 50.0, 60.0, 90.0, 120.0, 240.0];

impl Pace {
    /// Adds the next stamp, which must be later than the last one.
    pub fn follow(&mut self, stamp: Timestamp) {
        let Some(last) = self.last.replace(stamp) else { return };
        if self.steps.len() == STEPS {
            self.steps.pop_front();
        }
        self.steps.push_back(stamp.duration_since(last).max(Duration::from_nanos(1)));
    }

    /// Returns the median step between frames, once there are enough.
    pub fn interval(&self) -> Option<Duration> {
        if self.steps.len() < FEW_STEPS {
            return None;
        }
        let mut steps: Vec<Duration> = self.steps.iter().copied().collect();
        steps.sort_unstable();
        steps.get(steps.len() / 2).copied()
    }

    /// Returns the rate, frames per second.
    pub fn rate_hz(&self) -> Option<f64> {
        let hz = 1e9 / self.interval()?.as_nanos() as f64;
        let usual = USUAL_HZ.into_iter().find(|usual| (hz / usual - 1.0).abs() < 0.02);
        Some(usual.unwrap_or((hz * 10.0).round() / 10.0).clamp(0.1, 1e4))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::publish::frame_clock::FrameClock;

    #[test]
    fn clip_time_starts_when_the_first_frame_is_delivered() {
        let start = ClipStart::default();
        let first = Timestamp::from_ns(7_000);
        start.begin(first);
        start.begin(Timestamp::from_seconds(1.0));
        let begun = first.after_ns(start.offset_ns().unwrap());
        let clock = FrameClock::new(Stamps::Recorded(start));
        let now = clock.now();
        // However late its sample comes; the two clocks are not read at exactly the same instant.
        let taken = clock.taken(first, Duration::ZERO).unwrap();
        assert!(taken.ns_since(begun.after_ns(now.boot.ns_since(now.monotonic))).abs() < 1_000_000);
    }

    #[test]
    fn the_pace_follows_the_stamps() {
        let mut pace = Pace::default();
        assert_eq!((pace.rate_hz(), pace.interval()), (None, None));
        (0..50).for_each(|k| pace.follow(Timestamp::from_ns(k * 16_683_350)));
        assert_eq!((pace.rate_hz(), pace.interval()), (Some(60.0), Some(Duration::from_nanos(16_683_350))));
        // A stall does not change the rate.
        pace.follow(Timestamp::from_ns(49 * 16_683_350 + 5_000_000_000));
        assert_eq!(pace.rate_hz(), Some(60.0));
    }
}
