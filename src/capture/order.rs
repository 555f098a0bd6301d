//! The order of rows: every row gets the next number, and a stamp that does not follow the last one is refused.
//!
//! Clips and the live pipeline share this rule, so that a recording replays as it was tracked.

use super::{ClipEntry, EntryContent};
use crate::frame::Timestamp;

/// Numbers rows and watches their stamps.
#[derive(Debug, Clone, Default)]
pub struct EntryOrder {
    next_sequence: u64,
    last_stamp: Option<Timestamp>,
}

impl EntryOrder {
    /// The number of the next row.
    pub fn number(&mut self) -> u64 {
        self.next_sequence += 1;
        self.next_sequence - 1
    }

    /// Rows numbered so far.
    pub fn rows(&self) -> u64 {
        self.next_sequence
    }

    /// The last stamp that followed.
    pub fn last_stamp(&self) -> Option<Timestamp> {
        self.last_stamp
    }

    /// Takes note of a row's stamp.
    ///
    /// # Errors
    /// The reason as a sentence, where it does not follow the last one.
    pub fn follow(&mut self, stamp: Timestamp) -> Result<(), String> {
        if let Some(last) = self.last_stamp
            && stamp <= last
        {
            return Err(format!("the time stamp {stamp} does not follow {last}"));
        }
        self.last_stamp = Some(stamp);
        Ok(())
    }

    /// A live row as a replay of the same rows would give it.
    pub fn admit(&mut self, mut row: ClipEntry) -> ClipEntry {
        row.sequence = self.number();
        match (self.follow(row.timestamp), &mut row.content) {
            (Err(reason), content) => *content = EntryContent::Skipped(reason),
            (Ok(()), EntryContent::Frame(frame)) => frame.sequence = row.sequence,
            (Ok(()), _) => {}
        }
        row
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_stamp_that_stands_still_or_goes_back_is_skipped_and_costs_only_itself() {
        let row = |ns| ClipEntry {
            sequence: 77,
            timestamp: Timestamp::from_ns(ns),
            content: EntryContent::Undecodable("dark".into()),
            decode: Duration::ZERO,
            repeats: false,
            received: None,
        };
        let mut order = EntryOrder::default();
        let rows: Vec<ClipEntry> = [10, 10, 5, 11].map(|t| order.admit(row(t))).into();
        assert_eq!(rows.iter().map(|r| r.sequence).collect::<Vec<_>>(), [0, 1, 2, 3]);
        let skipped: Vec<bool> = rows.iter().map(|r| matches!(r.content, EntryContent::Skipped(_))).collect();
        assert_eq!(skipped, [false, true, true, false]);
    }
}
