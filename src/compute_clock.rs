//! Measures how long work kept its thread busy. The core reads no clock itself: whoever builds a
//! tracker passes one in.

use std::time::Duration;

/// A clock that is read before and after a piece of work, on the thread that does it.
#[derive(Debug, Clone, Copy)]
pub struct ComputeClock {
    now: fn() -> Duration,
}

impl ComputeClock {
    /// Reads `now`, preferably the CPU time of the calling thread, so that waiting and other
    /// processes do not count.
    pub fn new(now: fn() -> Duration) -> Self {
        Self { now }
    }

    pub(crate) fn start(self) -> Stopwatch {
        Stopwatch { clock: self, start: (self.now)() }
    }
}

impl Default for ComputeClock {
    /// A clock that never advances: all work takes no time.
    fn default() -> Self {
        Self { now: || Duration::ZERO }
    }
}

/// A running measurement.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stopwatch {
    clock: ComputeClock,
    start: Duration,
}

impl Stopwatch {
    /// Time since the start.
    pub fn elapsed(&self) -> Duration {
        (self.clock.now)().saturating_sub(self.start)
    }

    /// Time since the start, milliseconds.
    pub fn elapsed_ms(&self) -> f64 {
        self.elapsed().as_secs_f64() * 1e3
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    static MILLISECONDS: AtomicU64 = AtomicU64::new(100);

    #[test]
    fn a_stopwatch_reports_the_advance_of_its_clock() {
        let clock = ComputeClock::new(|| Duration::from_millis(MILLISECONDS.load(Ordering::Relaxed)));
        let watch = clock.start();
        MILLISECONDS.store(142, Ordering::Relaxed);
        assert_eq!(watch.elapsed_ms(), 42.0);
        // Setting the clock back does not give negative times.
        MILLISECONDS.store(7, Ordering::Relaxed);
        assert_eq!(watch.elapsed_ms(), 0.0);
        assert_eq!(ComputeClock::default().start().elapsed(), Duration::ZERO);
    }
}
