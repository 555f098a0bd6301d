//! A clip at the pace of its stamps: a row is handed out when it is due.

use std::time::{Duration, Instant};

use crate::capture::{ClipEntry, FrameSource};
use crate::cli::interrupt;
use crate::publish::ClipStart;

pub(super) struct Paced {
    source: Box<dyn FrameSource>,
    /// When the first row was handed out, and its stamp.
    start: Option<(Instant, i64)>,
    /// Who sends what comes of it wants to know too.
    begun: ClipStart,
}

impl Paced {
    pub fn new(source: Box<dyn FrameSource>, begun: ClipStart) -> Self {
        Self { source, start: None, begun }
    }
}

/// Time from the first stamp to this one; stamps that do not follow wait for nothing.
fn due_after(first_ns: i64, stamp_ns: i64) -> Duration {
    Duration::from_nanos(u64::try_from(stamp_ns.saturating_sub(first_ns)).unwrap_or(0))
}

impl FrameSource for Paced {
    fn next_entry(&mut self) -> Option<ClipEntry> {
        let row = self.source.next_entry()?;
        let (begun, first_ns) = *self.start.get_or_insert_with(|| (Instant::now(), row.timestamp_ns));
        self.begun.begin(first_ns);
        let due = due_after(first_ns, row.timestamp_ns);
        loop {
            if interrupt::is_interrupted() {
                return None;
            }
            let left = due.saturating_sub(begun.elapsed());
            if left.is_zero() {
                return Some(row);
            }
            // Short naps, so that Ctrl-C is heard in a pause of the clip.
            std::thread::sleep(left.min(Duration::from_millis(50)));
        }
    }

    fn size(&self) -> (u32, u32) {
        self.source.size()
    }

    fn rows(&self) -> Option<u64> {
        self.source.rows()
    }
}

#[cfg(test)]
mod tests {
    use super::due_after;

    #[test]
    fn rows_are_due_by_their_stamps_and_never_in_the_past() {
        assert_eq!(due_after(1_000, 34_000).as_nanos(), 33_000);
        assert_eq!(due_after(1_000, 500).as_nanos(), 0);
        assert_eq!(due_after(i64::MIN, i64::MAX).as_nanos(), i64::MAX as u128);
    }
}
