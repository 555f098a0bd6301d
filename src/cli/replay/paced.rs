//! A clip at the pace of its stamps: each row is returned when it is due.

use std::time::Instant;

use crate::capture::{ClipEntry, FrameSource};
use crate::cli::interrupt;
use crate::frame::Timestamp;
use crate::publish::ClipStart;

pub(super) struct Paced {
    source: Box<dyn FrameSource>,
    /// When the first row was returned, and its stamp.
    start: Option<(Instant, Timestamp)>,
    /// Shared with the outputs, which need the clip's start time.
    begun: ClipStart,
}

impl Paced {
    pub fn new(source: Box<dyn FrameSource>, begun: ClipStart) -> Self {
        Self { source, start: None, begun }
    }
}

impl FrameSource for Paced {
    fn next_entry(&mut self) -> Option<ClipEntry> {
        let row = self.source.next_entry()?;
        let (begun, first) = *self.start.get_or_insert_with(|| (Instant::now(), row.timestamp));
        self.begun.begin(first);
        // Stamps that go back do not wait.
        interrupt::wait_until(begun, row.timestamp.duration_since(first)).then_some(row)
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
    use super::*;
    use crate::capture::EntryContent;

    /// Rows with these stamps, in milliseconds.
    struct Rows(std::array::IntoIter<i64, 4>);

    impl FrameSource for Rows {
        fn next_entry(&mut self) -> Option<ClipEntry> {
            let timestamp = Timestamp::from_ns(self.0.next()? * 1_000_000);
            let content = EntryContent::Undecodable("dark".to_owned());
            Some(ClipEntry::new(0, timestamp, content))
        }

        fn size(&self) -> (u32, u32) {
            (1, 1)
        }

        fn rows(&self) -> Option<u64> {
            None
        }
    }

    #[test]
    fn no_row_is_handed_out_before_it_is_due() {
        // Stamps may start anywhere and may go back.
        let stamps = [7_000, 7_030, 6_000, 7_080];
        let mut paced = Paced::new(Box::new(Rows(stamps.into_iter())), ClipStart::default());
        let begun = Instant::now();
        for stamp in stamps {
            let row = paced.next_entry().expect("a row");
            assert_eq!(row.timestamp, Timestamp::from_ns(stamp * 1_000_000));
            assert!(begun.elapsed() >= row.timestamp.duration_since(Timestamp::from_seconds(7.0)));
        }
        assert!(paced.next_entry().is_none());
    }
}
