//! How long ago a frame was taken.
//!
//! Frames are stamped by the monotonic clock, which stands still while the machine is suspended: a frame from before a suspend would look
//! fresh after it. Ages are therefore counted on the boot clock, which goes on, and never on the wall clock, which may be stepped. A
//! [`FrameClock`] leads from stamps to that clock; it notices suspends by the two clocks drifting apart.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::clocks::{Clocks, ONE_INSTANT_NS, Reading, SystemClocks};
use super::stamps::Stamps;
use crate::frame::Timestamp;

/// The boot clock less the monotonic one changes by suspends alone; less than this is the reading's own scatter, nanoseconds. Chosen: 50
/// times [`ONE_INSTANT_NS`], and no machine wakes so soon. Raised, short suspends are overlooked, by which later frames count as older.
const SHORTEST_SUSPEND_NS: i64 = 5_000_000;
/// Suspends remembered; frames are long too old before they are forgotten. Chosen, not tuned. Raised, only memory; lowered to one, frames
/// from before the last suspend count as younger.
const SUSPENDS: usize = 8;

/// How far the boot clock is ahead of the monotonic one, from which monotonic instant on.
#[derive(Debug, Default)]
struct Suspends(VecDeque<(Timestamp, i64)>);

impl Suspends {
    /// Takes note of a reading. A suspend is known from the first one after it on: what was stamped before that counts as from before
    /// the suspend, which makes it older, never younger than it is.
    fn note(&mut self, now: Reading) {
        let ahead_ns = now.boot.ns_since(now.monotonic);
        match self.0.back_mut() {
            None => self.0.push_back((Timestamp::MIN, ahead_ns)),
            Some((_, known)) if ahead_ns > known.saturating_add(SHORTEST_SUSPEND_NS) => self.0.push_back((now.monotonic, ahead_ns)),
            // A reading that was torn apart after all is put right by the next one. Less is the scatter of readings: following it would
            // shift stamps against each other.
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

/// Leads from the stamps of frames to the boot clock. Everybody who judges ages of the same frames shares one.
#[derive(Debug)]
pub struct FrameClock {
    clocks: Arc<dyn Clocks>,
    stamps: Stamps,
    memory: Mutex<Memory>,
}

#[derive(Debug, Default)]
struct Memory {
    suspends: Suspends,
    /// Of a clip that nobody has said the beginning of: monotonic clock minus stamp, from its first sample.
    clip_offset_ns: Option<i64>,
}

/// A live stamp may lie ahead by what is assumed of exposure and readout: half of each, 1 s at most (`Shutter::LONGEST_S`). Further
/// ahead it is of another clock, nanoseconds. Raised, stamps of a wrong clock are believed.
const MOST_AHEAD_NS: i64 = 1_000_000_000;

impl FrameClock {
    /// With this machine's clocks.
    pub fn new(stamps: Stamps) -> Self {
        Self::with(Arc::new(SystemClocks), stamps)
    }

    /// With clocks of the caller's.
    pub fn with(clocks: Arc<dyn Clocks>, stamps: Stamps) -> Self {
        let clock = Self { clocks, stamps, memory: Mutex::default() };
        clock.now();
        clock
    }

    fn memory(&self) -> MutexGuard<'_, Memory> {
        self.memory.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Now. It is to be asked several times a second: that is how suspends are noticed.
    pub fn now(&self) -> Reading {
        // Read under the lock, so that notes are taken in their order.
        let mut memory = self.memory();
        let now = self.clocks.read();
        memory.suspends.note(now);
        now
    }

    /// When the frame of a stamp was taken, on the boot clock. `work` is how long its sample has been worked on, which counts for the
    /// first one of a clip whose beginning nobody has said. None where the stamp cannot be of this machine's clock.
    pub fn taken(&self, stamp: Timestamp, work: Duration) -> Option<Timestamp> {
        let now = self.now();
        let mut memory = self.memory();
        let offset_ns = match &self.stamps {
            Stamps::Live if stamp.ns_since(now.monotonic) > MOST_AHEAD_NS => return None,
            Stamps::Live => 0,
            Stamps::Recorded(start) => {
                let at_first = now.monotonic.before(work).ns_since(stamp);
                start.offset_ns().unwrap_or_else(|| *memory.clip_offset_ns.get_or_insert(at_first))
            }
        };
        Some(memory.suspends.boot(stamp.after_ns(offset_ns)))
    }

    /// The stamp as a clip has it, for formats that want both.
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
    fn a_suspend_makes_frames_from_before_it_old_and_those_after_it_not() {
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
    fn one_old_frame_shifts_nothing_and_a_stamp_of_another_clock_is_none() {
        let clocks = SteppedClocks::new();
        let clock = FrameClock::with(Arc::new(clocks.clone()), Stamps::Live);
        assert_eq!(age_ms(&clock, START.monotonic.after_ns(-11_000_000_000)), 11_000);
        assert_eq!(age_ms(&clock, START.monotonic.after_ns(-30_000_000)), 30);
        assert_eq!(clock.taken(START.unix, Duration::ZERO), None);
        assert_eq!(age_ms(&clock, START.monotonic.after_ns(-30_000_000)), 30);
    }

    #[test]
    fn a_clip_counts_from_its_beginning_or_from_its_first_sample() {
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
    fn a_torn_reading_is_put_right_by_the_next_one() {
        let mut suspends = Suspends::default();
        suspends.note(reading(1_000_000_000, 1_000_000_000));
        suspends.note(reading(1_000_000_000, 3_500_000_000));
        suspends.note(reading(3_600_000_000, 3_600_000_000));
        let stamp = Timestamp::from_seconds(3.59);
        assert_eq!(suspends.boot(stamp), stamp);
    }

    #[test]
    fn the_scatter_of_readings_shifts_no_stamp() {
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
