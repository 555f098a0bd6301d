//! Access to the machine's three clocks, injected so that tests can step them.

use std::fmt;

use nix::time::{ClockId, clock_gettime};

use crate::frame::Timestamp;

/// The three clocks at one instant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reading {
    /// `CLOCK_MONOTONIC`: the clock of camera stamps. It stops during a suspend.
    pub monotonic: Timestamp,
    /// `CLOCK_BOOTTIME`: the same, but it continues during a suspend.
    pub boot: Timestamp,
    /// `CLOCK_REALTIME`: the time of day, which may be stepped.
    pub unix: Timestamp,
}

/// A source of time.
pub trait Clocks: Send + Sync + fmt::Debug {
    /// Reads all three clocks.
    fn read(&self) -> Reading;
}

/// This machine's clocks.
#[derive(Debug, Clone, Copy, Default)]
pub struct SystemClocks;

/// Maximum duration, nanoseconds, of reading the three clocks for the readings to count as one
/// instant. A process stopped between two readings would see a suspend that never happened; only
/// then do they take longer than a few microseconds. Raised, a frame's age may be too small by that
/// much.
pub(super) const ONE_INSTANT_NS: i64 = 100_000;
/// Maximum number of attempts to do so, of which the shortest is used (chosen: a busy machine
/// rarely interrupts two in a row). Raised, a frame waits longer where it does.
const TRIES: usize = 20;

impl Clocks for SystemClocks {
    fn read(&self) -> Reading {
        let once = || {
            let before = read(ClockId::CLOCK_MONOTONIC);
            let (boot, unix) = (read(ClockId::CLOCK_BOOTTIME), read(ClockId::CLOCK_REALTIME));
            let monotonic = read(ClockId::CLOCK_MONOTONIC);
            (monotonic.ns_since(before), Reading { monotonic, boot, unix })
        };
        let mut best = once();
        for _ in 1..TRIES {
            if best.0 <= ONE_INSTANT_NS {
                break;
            }
            let next = once();
            best = if next.0 < best.0 { next } else { best };
        }
        best.1
    }
}

fn read(clock: ClockId) -> Timestamp {
    // Linux always has these clocks; if one failed, 0 would be a stamp like any other.
    clock_gettime(clock).map(|t| Timestamp::from_ns(t.tv_sec() * 1_000_000_000 + t.tv_nsec())).unwrap_or_default()
}

#[cfg(test)]
pub(crate) mod stepped {
    //! Clocks that a test steps.
    use std::sync::{Arc, Mutex};

    use super::*;

    pub(crate) const START: Reading = Reading {
        monotonic: Timestamp::from_ns(50_000_000_000),
        boot: Timestamp::from_ns(60_000_000_000),
        unix: Timestamp::from_ns(1_700_000_000_000_000_000),
    };

    /// Stand still until they are moved.
    #[derive(Debug, Clone)]
    pub(crate) struct SteppedClocks(Arc<Mutex<Reading>>);

    impl SteppedClocks {
        pub(crate) fn new() -> Self {
            Self(Arc::new(Mutex::new(START)))
        }

        fn change(&self, by: impl FnOnce(&mut Reading)) {
            by(&mut self.0.lock().unwrap());
        }

        /// Lets time pass.
        pub(crate) fn advance_ms(&self, ms: i64) {
            let ns = ms * 1_000_000;
            self.change(|r| (r.monotonic, r.boot, r.unix) = (r.monotonic.after_ns(ns), r.boot.after_ns(ns), r.unix.after_ns(ns)));
        }

        /// Suspends the machine.
        pub(crate) fn suspend_ms(&self, ms: i64) {
            let ns = ms * 1_000_000;
            self.change(|r| (r.boot, r.unix) = (r.boot.after_ns(ns), r.unix.after_ns(ns)));
        }

        /// Sets the time of day.
        pub(crate) fn step_wall_ms(&self, ms: i64) {
            self.change(|r| r.unix = r.unix.after_ns(ms * 1_000_000));
        }
    }

    impl Clocks for SteppedClocks {
        fn read(&self) -> Reading {
            *self.0.lock().unwrap()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_system_clocks_run() {
        let (first, second) = (SystemClocks.read(), SystemClocks.read());
        assert!(first.monotonic > Timestamp::default() && second.monotonic >= first.monotonic && second.boot >= first.boot);
    }
}
