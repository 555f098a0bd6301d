//! What becomes of a row of a clip: every row has its sample, whatever it holds.

use crate::capture::{ClipEntry, EntryContent};
use crate::record::PoseSample;
use crate::track::{Matcher, Reason, Sighting};
use crate::tracker::Tracker;

/// Tracks a row in the calling thread.
pub fn track_entry(tracker: &mut Tracker, row: &ClipEntry) -> PoseSample {
    let sighting = sight(&mut tracker.matcher, row);
    tracker.poses.sample(&sighting, row.decode.as_secs_f64() * 1e3)
}

/// What the matcher makes of a row.
pub(super) fn sight(matcher: &mut Matcher, row: &ClipEntry) -> Sighting {
    match &row.content {
        // Of the same picture nothing new can be measured.
        EntryContent::Frame(_) if row.repeats && matcher.has_given() => matcher.look_away(row.sequence, row.timestamp, Reason::Repeated),
        EntryContent::Frame(frame) => matcher.look(frame),
        EntryContent::Undecodable(_) => matcher.look_away(row.sequence, row.timestamp, Reason::Undecodable),
        EntryContent::Skipped(_) => matcher.look_past(row.sequence, row.timestamp),
    }
}
