//! Clocks that a test steps.

use std::sync::{Arc, Mutex};

use stagepose::diagnostics::publish::{Clocks, Reading};

#[derive(Debug, Clone)]
pub struct SteppedClocks(Arc<Mutex<Reading>>);

impl SteppedClocks {
    pub fn new() -> Self {
        let start = Reading { monotonic_ns: 50_000_000_000, boot_ns: 60_000_000_000, unix_ns: 1_700_000_000_000_000_000 };
        Self(Arc::new(Mutex::new(start)))
    }

    pub fn advance_ms(&self, ms: i64) {
        let (mut reading, ns) = (self.0.lock().unwrap(), ms * 1_000_000);
        reading.monotonic_ns += ns;
        reading.boot_ns += ns;
        reading.unix_ns += ns;
    }
}

impl Clocks for SteppedClocks {
    fn read(&self) -> Reading {
        *self.0.lock().unwrap()
    }
}
