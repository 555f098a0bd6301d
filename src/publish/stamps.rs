//! Where the stamps of frames come from, and how far frames are apart.

use std::collections::VecDeque;
use std::sync::{Arc, OnceLock};

use super::clocks::{Clocks, SystemClocks};

/// Where a source's stamps come from.
#[derive(Debug, Clone)]
pub enum Stamps {
    /// A camera on this machine: nanoseconds of CLOCK_MONOTONIC.
    Live,
    /// A clip: nanoseconds since anything. The clip is sent as if its first frame had been taken when the clip began.
    Recorded(ClipStart),
}

/// When a clip began to be played. Whoever plays it says so; failing that it is when the work on its first frame began.
#[derive(Debug, Clone, Default)]
pub struct ClipStart {
    /// Monotonic clock minus stamp, nanoseconds.
    offset_ns: Arc<OnceLock<i64>>,
}

impl ClipStart {
    /// The frame of this stamp is handed out now. Only the first call counts.
    pub fn begin(&self, stamp_ns: i64) {
        self.offset_ns.get_or_init(|| SystemClocks.read().monotonic_ns.saturating_sub(stamp_ns));
    }

    /// Monotonic clock minus stamp, once it has begun.
    pub(super) fn offset_ns(&self) -> Option<i64> {
        self.offset_ns.get().copied()
    }
}

/// How far frames are apart, from their stamps as they come.
#[derive(Debug, Clone, Default)]
pub(super) struct Pace {
    last_ns: Option<i64>,
    steps_ns: VecDeque<i64>,
}

/// Steps whose median is the interval. A single long one, after a stall or a dropped frame, does not move it.
const STEPS: usize = 9;
/// With fewer, what the source says of itself counts.
const FEW_STEPS: usize = 3;
/// Rates that cameras have; a measured one near them is meant to be them.
const USUAL_HZ: [f64; 9] = [15.0, 24.0, 25.0, 30.0, 50.0, 60.0, 90.0, 120.0, 240.0];

impl Pace {
    /// Takes the next stamp, which is later than the last one.
    pub fn follow(&mut self, stamp_ns: i64) {
        let Some(last_ns) = self.last_ns.replace(stamp_ns) else { return };
        if self.steps_ns.len() == STEPS {
            self.steps_ns.pop_front();
        }
        self.steps_ns.push_back(stamp_ns.saturating_sub(last_ns).max(1));
    }

    /// The usual step between frames, once there were a few.
    pub fn interval_ns(&self) -> Option<i64> {
        if self.steps_ns.len() < FEW_STEPS {
            return None;
        }
        let mut steps: Vec<i64> = self.steps_ns.iter().copied().collect();
        steps.sort_unstable();
        steps.get(steps.len() / 2).copied()
    }

    /// Frames per second.
    pub fn rate_hz(&self) -> Option<f64> {
        let hz = 1e9 / self.interval_ns()? as f64;
        let usual = USUAL_HZ.into_iter().find(|usual| (hz / usual - 1.0).abs() < 0.02);
        Some(usual.unwrap_or((hz * 10.0).round() / 10.0).clamp(0.1, 1e4))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::publish::frame_clock::FrameClock;

    #[test]
    fn a_played_clip_counts_from_when_its_first_frame_was_handed_out() {
        let start = ClipStart::default();
        start.begin(7_000);
        start.begin(1_000_000_000);
        let begun = start.offset_ns().unwrap() + 7_000;
        let clock = FrameClock::new(Stamps::Recorded(start));
        let now = clock.now();
        // However late its sample comes; the two clocks are not read at quite the same instant.
        let taken_ns = clock.taken_ns(7_000, 0).unwrap();
        assert!((taken_ns - (begun + now.boot_ns - now.monotonic_ns)).abs() < 1_000_000);
    }

    #[test]
    fn the_pace_is_that_of_the_stamps() {
        let mut pace = Pace::default();
        assert_eq!((pace.rate_hz(), pace.interval_ns()), (None, None));
        (0..50).for_each(|k| pace.follow(k * 16_683_350));
        assert_eq!((pace.rate_hz(), pace.interval_ns()), (Some(60.0), Some(16_683_350)));
        // A stall is no rate.
        pace.follow(49 * 16_683_350 + 5_000_000_000);
        assert_eq!(pace.rate_hz(), Some(60.0));
    }
}
