//! The order of rows: every row gets the next number, and a stamp that does not follow the last one
//! is refused.
//!
//! A single wrong stamp costs only its own row. A clock that is set back and continues from there
//! starts a new sequence, so it does not cost all later rows. Clips and the live pipeline share
//! this rule, so that a recording replays as it was tracked. Clips also look at the stamps ahead,
//! so they lose no rows where a clock steps back.

use super::{ClipEntry, EntryContent};
use crate::frame::Timestamp;

/// Numbers rows and checks their stamps.
#[derive(Debug, Clone, Default)]
pub struct EntryOrder {
    next_sequence: u64,
    last_stamp: Option<Timestamp>,
    /// The number of consecutive refused rows whose stamps increase, and the last of those stamps.
    refused: Option<(usize, Timestamp)>,
}

/// Number of rows to look ahead, and number of rows that must continue from a clock that was set
/// back before it is accepted. Raised, a live camera loses more rows where its clock steps;
/// lowered, rows in the wrong order pass for a clock that was set back.
pub(super) const AHEAD: usize = 8;
/// Minimum backward step of a clock, seconds, that starts a new sequence. A smaller step loses at
/// most the frames that fit into it. Raised, larger steps lose rows; lowered, rows in the wrong
/// order pass for a clock that was set back.
const MIN_STEP_S: f64 = 1.0;

impl EntryOrder {
    /// Returns the number of the next row.
    pub fn number(&mut self) -> u64 {
        self.next_sequence += 1;
        self.next_sequence - 1
    }

    /// Returns how many rows were numbered so far.
    pub fn rows(&self) -> u64 {
        self.next_sequence
    }

    /// Returns the last accepted stamp.
    pub fn last_stamp(&self) -> Option<Timestamp> {
        self.last_stamp
    }

    /// Checks a row's stamp; `ahead` holds the stamps of the next rows, as far as they are known.
    /// Returns a sentence if the clock was set back and a new sequence begins.
    ///
    /// # Errors
    /// The reason as a sentence, if the stamp does not follow the last one, or the next rows do not
    /// follow it.
    pub fn follow(&mut self, stamp: Timestamp, ahead: &[Timestamp]) -> Result<Option<String>, String> {
        let (last, ahead) = (self.last_stamp, &ahead[..ahead.len().min(AHEAD)]);
        if last.is_none_or(|last| stamp > last) {
            if is_outlier(stamp, last, ahead) {
                return Err(format!("the time stamp {stamp} is later than those of the rows behind it"));
            }
            (self.last_stamp, self.refused) = (Some(stamp), None);
            return Ok(None);
        }
        let last = last.unwrap_or(stamp);
        let before = self.refused.filter(|(_, refused)| stamp > *refused).map_or(0, |(count, _)| count);
        self.refused = Some((before + 1, stamp));
        let goes_on = ahead.iter().scan(stamp, |at, next| (*next > *at && *next <= last).then(|| *at = *next)).count();
        let is_believed = if ahead.is_empty() { before >= AHEAD } else { ahead.len() > 2 && goes_on == ahead.len() };
        if !is_believed || last.seconds_since(stamp) < MIN_STEP_S {
            return Err(format!("the time stamp {stamp} does not follow {last}"));
        }
        (self.last_stamp, self.refused) = (Some(stamp), None);
        Ok(Some(format!("the clock steps back from {last} to {stamp}; tracking restarts there")))
    }

    /// Numbers and checks a live row, with the result that a replay of the same rows would have.
    pub fn admit(&mut self, mut row: ClipEntry) -> ClipEntry {
        row.sequence = self.number();
        match (self.follow(row.timestamp, &[]), &mut row.content) {
            (Err(reason), content) => *content = EntryContent::Skipped(reason),
            (Ok(word), EntryContent::Frame(frame)) => {
                word.iter().for_each(|word| tracing::warn!("row {}: {word}", row.sequence));
                frame.sequence = row.sequence;
            }
            (Ok(_), _) => {}
        }
        row
    }
}

/// Whether a stamp lies so far ahead that accepting its row would lose more of the following rows
/// than it is worth.
fn is_outlier(stamp: Timestamp, last: Option<Timestamp>, ahead: &[Timestamp]) -> bool {
    let mut at = last;
    let mut lost = 0;
    for next in ahead.iter().filter(|next| **next <= stamp) {
        if at.is_none_or(|at| *next > at) {
            (at, lost) = (Some(*next), lost + 1);
        }
    }
    let is_far = || last.is_some_and(|last| stamp.seconds_since(last) >= MIN_STEP_S) && ahead.iter().all(|next| *next <= stamp);
    lost >= 2 || (lost == 1 && is_far())
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_repeated_or_decreasing_stamp_skips_only_its_own_row() {
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

    /// Returns the accepted stamps, with look-ahead (as for clips) or without (as for cameras).
    fn kept(stamps: &[i64], sees_ahead: bool) -> Vec<i64> {
        let all: Vec<Timestamp> = stamps.iter().map(|t| Timestamp::from_ns(t * 33_333_333)).collect();
        let mut order = EntryOrder::default();
        let follows = |n: &usize| order.follow(all[*n], if sees_ahead { &all[n + 1..] } else { &[] }).is_ok();
        (0..all.len()).filter(follows).map(|n| stamps[n]).collect()
    }

    #[test]
    fn one_bad_stamp_costs_one_row() {
        let far = 1_000_000;
        assert_eq!(kept(&[0, 1, 2, far, 3, 4, 5, 6], true), [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(kept(&[far, 1, 2, 3, 4, 5, 6], true), [1, 2, 3, 4, 5, 6], "the first");
        assert_eq!(kept(&[0, 1, 2, 3, 4, far, 5], true), [0, 1, 2, 3, 4, 5], "the last but one");
        assert_eq!(kept(&[0, 1, far, far + 1, 2, 3, 4], true), [0, 1, 2, 3, 4], "two");
        for sees_ahead in [true, false] {
            assert_eq!(kept(&[100, 101, 0, 102, 103], sees_ahead), [100, 101, 102, 103]);
            assert_eq!(kept(&[0, 1, 2, far, far + 1, far + 2], sees_ahead), [0, 1, 2, far, far + 1, far + 2], "a pause is none");
        }
    }

    #[test]
    fn out_of_order_rows_are_skipped() {
        for sees_ahead in [true, false] {
            assert_eq!(kept(&[0, 2, 1, 3, 3, 4], sees_ahead), [0, 2, 3, 4]);
            assert_eq!(kept(&[0, 1, 2, 4, 5, 3, 6], sees_ahead), [0, 1, 2, 4, 5, 6]);
            let block: Vec<i64> = (0..5).chain(10..30).chain(5..10).chain(30..35).collect();
            assert_eq!(kept(&block, sees_ahead).len(), block.len() - 5);
        }
    }

    #[test]
    fn a_clock_set_back_starts_a_new_sequence() {
        let stepped: Vec<i64> = (100_000..100_050).chain(100..150).collect();
        assert_eq!(kept(&stepped, true), stepped);
        let kept = kept(&stepped, false);
        assert_eq!((kept.len(), kept.last()), (stepped.len() - AHEAD, Some(&149)), "a camera loses a few rows");
    }
}
