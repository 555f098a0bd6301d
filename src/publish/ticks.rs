//! The ticks of an output with a fixed rate.
//!
//! Free-running ticks begin when the output does. Ticks on the clock lie on the frames of SMPTE ST
//! 2059-1: at whole multiples of the frame time since 1970 in TAI. All machines whose clocks agree
//! then tick together, which is the nearest thing to genlock that a webcam can have.

use std::time::Duration;

use super::clocks::Reading;
use super::settings::{FixedRate, TickPhase};
use crate::frame::Timestamp;

/// The ticks of one output; instants are on the boot clock.
#[derive(Debug)]
pub(super) struct Ticks {
    rate: FixedRate,
    phase: TickPhase,
    begun: Timestamp,
    /// TAI minus UTC, seconds.
    tai_offset_s: i64,
    /// The next tick.
    next: u64,
    /// The tick whose number is 0.
    zeroth: u64,
}

impl Ticks {
    /// Starts now.
    pub fn new(rate: FixedRate, phase: TickPhase, tai_offset_s: i64, now: Reading) -> Self {
        let mut ticks = Self { rate, phase, begun: now.boot, tai_offset_s, next: 0, zeroth: 0 };
        if phase == TickPhase::Clock {
            ticks.next = rate.tick_at(ticks.elapsed(now)) + 1;
            ticks.zeroth = ticks.next;
        }
        ticks
    }

    /// Returns the time since tick 0 of the phase.
    fn elapsed(&self, now: Reading) -> Duration {
        match self.phase {
            TickPhase::FreeRunning => now.boot.duration_since(self.begun),
            TickPhase::Clock => now.unix.after_ns(self.tai_offset_s * 1_000_000_000).duration_since(Timestamp::default()),
        }
    }

    /// Returns the time until the next tick.
    pub fn wait(&self, now: Reading) -> Duration {
        self.rate.tick(self.next).saturating_sub(self.elapsed(now))
    }

    /// Returns the number and the instant of the tick that is due, if one is. Late ticks are
    /// skipped instead of sent in a burst.
    pub fn due(&mut self, now: Reading) -> Option<(u64, Timestamp)> {
        let elapsed = self.elapsed(now);
        let latest = self.rate.tick_at(elapsed);
        // The clock was set back: its ticks come again, and their numbers rise on.
        if self.next > latest + 1 {
            self.zeroth = self.zeroth.saturating_sub(self.next - (latest + 1));
            self.next = latest + 1;
        }
        if latest < self.next {
            return None;
        }
        self.next = latest + 1;
        let late = elapsed.saturating_sub(self.rate.tick(latest));
        Some((latest.saturating_sub(self.zeroth), now.boot.before(late)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::clocks::Clocks;
    use super::super::clocks::stepped::SteppedClocks;
    use super::*;

    const RATES: [FixedRate; 2] = [FixedRate { ticks: 50, per_s: 1 }, FixedRate { ticks: 30_000, per_s: 1001 }];

    /// Returns the ticks of two seconds of looks every millisecond.
    fn ticks_of(ticks: &mut Ticks, clocks: &SteppedClocks) -> Vec<(u64, Timestamp)> {
        let mut found = Vec::new();
        for _ in 0..2_002 {
            clocks.advance_ms(1);
            found.extend(ticks.due(clocks.read()));
        }
        found
    }

    #[test]
    fn ticks_on_the_clock_are_whole_frames_of_tai() {
        for rate in RATES {
            let clocks = SteppedClocks::new();
            clocks.step_wall_ms(123);
            let mut ticks = Ticks::new(rate, TickPhase::Clock, 37, clocks.read());
            let found = ticks_of(&mut ticks, &clocks);
            assert!((found.len() as f64 - 2.002 * rate.hz()).abs() < 1.01);
            for (k, (number, at)) in found.iter().enumerate() {
                let now = clocks.read();
                let tai_ns = now.unix.after_ns(at.ns_since(now.boot) + 37_000_000_000).ns();
                let tai = Duration::from_nanos(tai_ns.unsigned_abs());
                assert_eq!(rate.tick(rate.tick_at(tai)), tai);
                assert_eq!(*number, k as u64);
            }
        }
    }

    #[test]
    fn free_running_ticks_begin_with_the_output() {
        let clocks = SteppedClocks::new();
        let begun = clocks.read().boot;
        let found = ticks_of(&mut Ticks::new(RATES[0], TickPhase::FreeRunning, 37, clocks.read()), &clocks);
        assert!(found.iter().all(|(number, at)| at.ns_since(begun) == *number as i64 * 20_000_000));
        assert_eq!(found.len(), 101);
    }

    #[test]
    fn a_clock_that_is_set_stops_no_ticks() {
        for step_ms in [-3_600_000, 3_600_000] {
            let clocks = SteppedClocks::new();
            let mut ticks = Ticks::new(RATES[0], TickPhase::Clock, 37, clocks.read());
            let before = ticks_of(&mut ticks, &clocks);
            clocks.step_wall_ms(step_ms);
            let after = ticks_of(&mut ticks, &clocks);
            assert!(after.len() >= 99, "{step_ms}: {} ticks", after.len());
            assert!(after[0].0 > before[before.len() - 1].0, "numbers rise");
        }
    }
}
