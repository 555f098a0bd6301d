//! Clocks that a test advances.

use std::sync::{Arc, Mutex};

use stagepose::Timestamp;
use stagepose::diagnostics::publish::{Clocks, Reading};

#[derive(Debug, Clone)]
pub struct SteppedClocks(Arc<Mutex<Reading>>);

impl SteppedClocks {
    pub fn new() -> Self {
        let [monotonic, boot, unix] = [50_000_000_000, 60_000_000_000, 1_700_000_000_000_000_000].map(Timestamp::from_ns);
        Self(Arc::new(Mutex::new(Reading { monotonic, boot, unix })))
    }

    pub fn advance_ms(&self, ms: i64) {
        let (mut reading, ns) = (self.0.lock().unwrap(), ms * 1_000_000);
        let Reading { monotonic, boot, unix } = &mut *reading;
        [monotonic, boot, unix].into_iter().for_each(|at| *at = at.after_ns(ns));
    }
}

impl Clocks for SteppedClocks {
    fn read(&self) -> Reading {
        *self.0.lock().unwrap()
    }
}
