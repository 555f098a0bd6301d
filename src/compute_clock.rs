//! How long a piece of work kept its thread busy: processor time, so that waiting, and what else the machine does
//! meanwhile, does not count.

use std::time::Duration;

use nix::time::ClockId;

/// Started with the work, in the thread that does it.
#[derive(Debug, Clone, Copy)]
pub struct ComputeClock {
    start: Duration,
}

impl ComputeClock {
    /// Starts now.
    pub fn start() -> Self {
        Self { start: thread_time() }
    }

    /// Processor time of this thread since the start.
    pub fn elapsed(&self) -> Duration {
        thread_time().saturating_sub(self.start)
    }

    /// The same in milliseconds.
    pub fn elapsed_ms(&self) -> f64 {
        self.elapsed().as_secs_f64() * 1e3
    }
}

/// Processor time of the calling thread; zero where the system does not tell.
fn thread_time() -> Duration {
    ClockId::CLOCK_THREAD_CPUTIME_ID.now().map_or(Duration::ZERO, Duration::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleep_does_not_count() {
        let clock = ComputeClock::start();
        std::thread::sleep(Duration::from_millis(50));
        assert!(clock.elapsed() < Duration::from_millis(40));
        let mut sum = 0u64;
        while clock.elapsed() < Duration::from_millis(5) {
            sum = sum.wrapping_add(1);
        }
        assert!(sum > 0);
    }
}
