//! The age of the last picture, and when it is too old.

use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use crate::capture::timestamping::monotonic_now;
use crate::frame::Timestamp;

/// Shared by the thread that reads pictures and the one that reports their absence; nanoseconds.
#[derive(Debug)]
pub struct Pulse {
    arrival_ns: AtomicI64,
    stamp_ns: AtomicI64,
    frame_time_ns: AtomicI64,
}

impl Default for Pulse {
    fn default() -> Self {
        let now = monotonic_now().ns();
        Self { arrival_ns: AtomicI64::new(now), stamp_ns: AtomicI64::new(now), frame_time_ns: AtomicI64::new(33_333_333) }
    }
}

/// Frame times without a picture after which a stale message is due. It is less than three to leave
/// time for delivery. Raised, the message is late; lowered, frames that are merely late make the
/// output stale.
const STALE_FRAME_TIMES: f64 = 2.6;

impl Pulse {
    /// Notes a picture.
    pub fn beat(&self, arrival: Timestamp, stamp: Timestamp) {
        self.arrival_ns.store(arrival.ns(), Ordering::Relaxed);
        self.stamp_ns.store(stamp.ns(), Ordering::Relaxed);
    }

    /// Sets the picture rate, per second.
    pub fn set_rate(&self, fps: f64) {
        if fps > 0.0 {
            self.frame_time_ns.store((1e9 / fps) as i64, Ordering::Relaxed);
        }
    }

    /// Returns the time until the silence is too long; `None` if it already is.
    pub fn time_left(&self, now: Timestamp) -> Option<Duration> {
        let allowed = (self.frame_time_ns.load(Ordering::Relaxed) as f64 * STALE_FRAME_TIMES) as i64;
        let left = Timestamp::from_ns(self.arrival_ns.load(Ordering::Relaxed)).after_ns(allowed).duration_since(now);
        (!left.is_zero()).then_some(left)
    }

    /// Returns the last picture's age since its exposure, milliseconds.
    pub fn age_ms(&self, now: Timestamp) -> f64 {
        now.ms_since(Timestamp::from_ns(self.stamp_ns.load(Ordering::Relaxed)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_times_out_before_three_frame_intervals() {
        let pulse = Pulse::default();
        pulse.set_rate(50.0);
        let at = Timestamp::from_ns;
        pulse.beat(at(1_000_000_000), at(990_000_000));
        assert_eq!(pulse.time_left(at(1_000_000_000)), Some(Duration::from_millis(52)));
        assert_eq!(pulse.time_left(at(1_051_999_999)), Some(Duration::from_nanos(1)));
        assert_eq!(pulse.time_left(at(1_052_000_000)), None);
        assert_eq!(pulse.age_ms(at(1_050_000_000)), 60.0);
    }
}
