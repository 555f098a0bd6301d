//! CPU time of a thread, to measure a tracker's times.

use std::time::Duration;

use nix::time::ClockId;

use crate::compute_clock::ComputeClock;

/// Returns the clock for [`TrackerSetup::clock`](crate::TrackerSetup::clock): the calling thread's
/// CPU time, or zero if the system does not provide it.
pub fn thread_clock() -> ComputeClock {
    ComputeClock::new(|| ClockId::CLOCK_THREAD_CPUTIME_ID.now().map_or(Duration::ZERO, Duration::from))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleep_does_not_count() {
        let watch = thread_clock().start();
        std::thread::sleep(Duration::from_millis(50));
        assert!(watch.elapsed() < Duration::from_millis(40));
        let mut sum = 0u64;
        while watch.elapsed() < Duration::from_millis(5) {
            sum = sum.wrapping_add(1);
        }
        assert!(sum > 0);
    }
}
