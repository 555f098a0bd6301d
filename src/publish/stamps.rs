//! Which instants stamps are: on this machine's monotonic clock, and in Unix time.

use nix::time::{ClockId, clock_gettime};

/// Where a source's stamps come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stamps {
    /// A camera on this machine: nanoseconds of CLOCK_MONOTONIC.
    Live,
    /// A clip: nanoseconds since anything. The clip is sent as if its first frame had been taken when its work began.
    Recorded,
}

/// An instant on both clocks, nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Instants {
    pub monotonic_ns: i64,
    pub unix_ns: i64,
}

/// Now, on both clocks.
pub(super) fn now() -> Instants {
    Instants { monotonic_ns: read(ClockId::CLOCK_MONOTONIC), unix_ns: read(ClockId::CLOCK_REALTIME) }
}

fn read(clock: ClockId) -> i64 {
    // Linux has both clocks always; where one fails, 0 is a stamp like any other.
    clock_gettime(clock).map_or(0, |t| t.tv_sec() * 1_000_000_000 + t.tv_nsec())
}

/// Turns stamps into instants.
#[derive(Debug, Clone, Copy)]
pub(super) struct StampClock {
    stamps: Stamps,
    /// Monotonic clock minus stamp; of a clip known from the first stamp on.
    offset_ns: Option<i64>,
}

/// A live stamp further from now than this is not of this machine's monotonic clock.
const PLAUSIBLE_NS: i64 = 10_000_000_000;

impl StampClock {
    pub fn new(stamps: Stamps) -> Self {
        Self { stamps, offset_ns: (stamps == Stamps::Live).then_some(0) }
    }

    /// The instant of a stamp; `work_ns` is how long this first sample has been worked on.
    pub fn instants(&mut self, stamp_ns: i64, work_ns: i64, now: Instants) -> Instants {
        if self.stamps == Stamps::Live && (now.monotonic_ns.saturating_sub(stamp_ns)).abs() > PLAUSIBLE_NS && self.offset_ns == Some(0) {
            tracing::warn!("the camera's stamps are not of the monotonic clock; ages and times of day count from the first frame's arrival");
            self.offset_ns = None;
        }
        let offset = *self.offset_ns.get_or_insert(now.monotonic_ns.saturating_sub(work_ns).saturating_sub(stamp_ns));
        let monotonic_ns = stamp_ns.saturating_add(offset);
        let age = now.monotonic_ns.saturating_sub(monotonic_ns);
        Instants { monotonic_ns, unix_ns: now.unix_ns.saturating_sub(age) }
    }

    /// The stamp as a clip has it, for formats that want both.
    pub fn recorded(&self, stamp_ns: i64) -> Option<i64> {
        (self.stamps == Stamps::Recorded).then_some(stamp_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_become_times_of_day() {
        let now = Instants { monotonic_ns: 50_000_000_000, unix_ns: 1_700_000_000_000_000_000 };
        let mut live = StampClock::new(Stamps::Live);
        let at = live.instants(49_960_000_000, 0, now);
        assert_eq!(at, Instants { monotonic_ns: 49_960_000_000, unix_ns: 1_699_999_999_960_000_000 });
        assert_eq!(live.recorded(5), None);

        let mut clip = StampClock::new(Stamps::Recorded);
        assert_eq!(clip.instants(7_000, 1_000, now).monotonic_ns, 49_999_999_000);
        assert_eq!(clip.instants(8_000, 9_000, now).monotonic_ns, 50_000_000_000);
        assert_eq!(clip.recorded(8_000), Some(8_000));
    }

    #[test]
    fn a_camera_with_a_clock_of_its_own_is_noticed() {
        let now = Instants { monotonic_ns: 50_000_000_000, unix_ns: 1_700_000_000_000_000_000 };
        let mut live = StampClock::new(Stamps::Live);
        assert_eq!(live.instants(i64::MAX / 2, 0, now).monotonic_ns, now.monotonic_ns);
    }
}
