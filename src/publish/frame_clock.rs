//! Determines how long ago a frame was taken.
//!
//! Frames are stamped by the monotonic clock, which stops while the machine is suspended: a frame
//! from before a suspend would look fresh afterwards. Ages are therefore measured on the boot
//! clock, which continues, and never on the wall clock, which may be stepped. A [`FrameClock`]
//! converts stamps to the boot clock; it detects suspends when the two clocks drift apart.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::clocks::{Clocks, ONE_INSTANT_NS, Reading, SystemClocks};
use super::stamps::Stamps;
use crate::frame::Timestamp;

/// Minimum change of the difference between boot and monotonic clock, nanoseconds, that counts as a
/// suspend; less is scatter of the readings. Chosen: 50 times [`ONE_INSTANT_NS`], and no machine
/// wakes so soon. Raised, short suspends are missed, and later frames appear older by them.
const MIN_SUSPEND_NS: i64 = 5_000_000;
/// Number of suspends remembered; frames are far too old before one is forgotten. Chosen, not
/// tuned. Raised, it only takes memory; lowered to one, frames from before the last suspend appear
/// younger.
const SUSPENDS: usize = 8;

/// How far the boot clock is ahead of the monotonic one, and from which monotonic instant on.
#[derive(Debug, Default)]
struct Suspends(VecDeque<(Timestamp, i64)>);

impl Suspends {
    /// Records a reading. A suspend is detected by the first reading after it, so stamps before
    /// that reading count as from before the suspend: frames may appear older, never younger than
    /// they are.
    fn note(&mut self, now: Reading) {
        let ahead_ns = now.boot.ns_since(now.monotonic);
        match self.0.back_mut() {
            None => self.0.push_back((Timestamp::MIN, ahead_ns)),
            Some((_, known)) if ahead_ns > known.saturating_add(MIN_SUSPEND_NS) => self.0.push_back((now.monotonic, ahead_ns)),
            // The next reading corrects one that was interrupted after all. Smaller differences are
            // scatter of the readings: following them would shift stamps against each other.
            Some((_, known)) if ahead_ns < known.saturating_sub(ONE_INSTANT_NS) => *known = ahead_ns,
            Some(_) => {}
        }
        if self.0.len() > SUSPENDS {
            self.0.pop_front();
        }
    }

    fn boot(&self, monotonic: Timestamp) -> Timestamp {
        let known = self.0.iter().rev().find(|(since, _)| *since < monotonic).or(self.0.front());
        monotonic.after_ns(known.map_or(0, |(_, ahead_ns)| *ahead_ns))
    }
}

/// Converts frame stamps to the boot clock. All users of the same frames' ages share one.
#[derive(Debug)]
pub struct FrameClock {
    clocks: Arc<dyn Clocks>,
    stamps: Stamps,
    memory: Mutex<Memory>,
}

#[derive(Debug, Default)]
struct Memory {
    suspends: Suspends,
    /// For a clip without a stated start: monotonic clock minus stamp, from its first sample.
    clip_offset_ns: Option<i64>,
}

/// How far a live stamp may lie in the future, nanoseconds. It may lead by half of the configured
/// exposure and readout, at most 1 s (`Shutter::MAX_S`); more means another clock. Raised,
/// stamps of a wrong clock are accepted.
const MAX_AHEAD_NS: i64 = 1_000_000_000;

impl FrameClock {
    /// Creates a clock on this machine's clocks.
    pub fn new(stamps: Stamps) -> Self {
        Self::with(Arc::new(SystemClocks), stamps)
    }

    /// Creates a clock on the given clocks.
    pub fn with(clocks: Arc<dyn Clocks>, stamps: Stamps) -> Self {
        let clock = Self { clocks, stamps, memory: Mutex::default() };
        clock.now();
        clock
    }

    fn memory(&self) -> MutexGuard<'_, Memory> {
        self.memory.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the current reading. Call it several times a second, since that is how suspends are
    /// detected.
    pub fn now(&self) -> Reading {
        // Read under the lock, so that readings are recorded in order.
        let mut memory = self.memory();
        let now = self.clocks.read();
        memory.suspends.note(now);
        now
    }

    /// Returns when the frame with this stamp was taken, on the boot clock. `work` is the
    /// processing time of its sample so far; it is used for the first sample of a clip without a
    /// stated start. `None` if the stamp cannot be on this machine's clock.
    pub fn taken(&self, stamp: Timestamp, work: Duration) -> Option<Timestamp> {
        let now = self.now();
        let mut memory = self.memory();
        let offset_ns = match &self.stamps {
            Stamps::Live if stamp.ns_since(now.monotonic) > MAX_AHEAD_NS => return None,
            Stamps::Live => 0,
            Stamps::Recorded(start) => {
                let at_first = now.monotonic.before(work).ns_since(stamp);
                start.offset_ns().unwrap_or_else(|| *memory.clip_offset_ns.get_or_insert(at_first))
            }
        };
        Some(memory.suspends.boot(stamp.after_ns(offset_ns)))
    }

    /// Returns the stamp on the clip's own clock, for formats that send both.
    pub fn recorded(&self, stamp: Timestamp) -> Option<Timestamp> {
        matches!(self.stamps, Stamps::Recorded(_)).then_some(stamp)
    }
}

#[cfg(test)]
mod tests {
    use super::super::clocks::stepped::{START, SteppedClocks};
    use super::super::stamps::ClipStart;
    use super::*;

    fn age_ms(clock: &FrameClock, stamp: Timestamp) -> i64 {
        clock.now().boot.ns_since(clock.taken(stamp, Duration::ZERO).unwrap()) / 1_000_000
    }

    #[test]
    fn a_suspend_ages_only_the_frames_before_it() {
        let clocks = SteppedClocks::new();
        let clock = FrameClock::with(Arc::new(clocks.clone()), Stamps::Live);
        let before = START.monotonic.after_ns(-20_000_000);
        assert_eq!(age_ms(&clock, before), 20);
        clocks.suspend_ms(3_600_000);
        assert_eq!(age_ms(&clock, before), 3_600_020);
        clocks.advance_ms(100);
        assert_eq!(age_ms(&clock, START.monotonic.after_ns(70_000_000)), 30);
        assert_eq!(age_ms(&clock, before), 3_600_120);
    }

    #[test]
    fn a_stepped_wall_clock_changes_no_age() {
        let clocks = SteppedClocks::new();
        let clock = FrameClock::with(Arc::new(clocks.clone()), Stamps::Live);
        for step_ms in [7_200_000, -86_400_000] {
            clocks.step_wall_ms(step_ms);
            assert_eq!(age_ms(&clock, START.monotonic.after_ns(-20_000_000)), 20);
        }
    }

    #[test]
    fn one_old_frame_or_foreign_stamp_shifts_no_clock() {
        let clocks = SteppedClocks::new();
        let clock = FrameClock::with(Arc::new(clocks.clone()), Stamps::Live);
        assert_eq!(age_ms(&clock, START.monotonic.after_ns(-11_000_000_000)), 11_000);
        assert_eq!(age_ms(&clock, START.monotonic.after_ns(-30_000_000)), 30);
        assert_eq!(clock.taken(START.unix, Duration::ZERO), None);
        assert_eq!(age_ms(&clock, START.monotonic.after_ns(-30_000_000)), 30);
    }

    #[test]
    fn clip_time_starts_at_its_beginning_or_first_sample() {
        let clocks = SteppedClocks::new();
        let unsaid = FrameClock::with(Arc::new(clocks.clone()), Stamps::Recorded(ClipStart::default()));
        let next = Timestamp::from_ns(8_000);
        assert_eq!(unsaid.taken(Timestamp::from_ns(7_000), Duration::from_nanos(1_000)), Some(START.boot.after_ns(-1_000)));
        assert_eq!(unsaid.taken(next, Duration::from_nanos(9_000)), Some(START.boot));
        assert_eq!((unsaid.recorded(next), FrameClock::new(Stamps::Live).recorded(next)), (Some(next), None));
    }

    fn reading(monotonic_ns: i64, boot_ns: i64) -> Reading {
        Reading { monotonic: Timestamp::from_ns(monotonic_ns), boot: Timestamp::from_ns(boot_ns), unix: Timestamp::default() }
    }

    #[test]
    fn a_torn_clock_reading_is_corrected_by_the_next_one() {
        let mut suspends = Suspends::default();
        suspends.note(reading(1_000_000_000, 1_000_000_000));
        suspends.note(reading(1_000_000_000, 3_500_000_000));
        suspends.note(reading(3_600_000_000, 3_600_000_000));
        let stamp = Timestamp::from_seconds(3.59);
        assert_eq!(suspends.boot(stamp), stamp);
    }

    #[test]
    fn jitter_of_clock_readings_shifts_no_stamp() {
        let mut suspends = Suspends::default();
        suspends.note(reading(1_000_000_000, 2_000_000_000));
        let stamp = Timestamp::from_seconds(1.5);
        let before = suspends.boot(stamp);
        for late_ns in [30_000, 90_000, 0, 60_000] {
            suspends.note(reading(1_600_000_000 + late_ns, 2_600_000_000));
            assert_eq!(suspends.boot(stamp), before);
        }
    }
}
