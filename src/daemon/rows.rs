//! What becomes of a row of a clip: every row has its sample, whatever it holds.

use crate::capture::{Row, RowContent};
use crate::record::PoseSample;
use crate::track::{Matcher, Reason, Sighting};
use crate::tracker::Tracker;

/// Tracks a row in the calling thread.
pub fn track_row(tracker: &mut Tracker, row: &Row) -> PoseSample {
    let sighting = sight(&mut tracker.matcher, row);
    tracker.poses.sample(&sighting, row.decode.as_secs_f64() * 1e3)
}

/// What the matcher makes of a row.
pub(super) fn sight(matcher: &mut Matcher, row: &Row) -> Sighting {
    match &row.content {
        RowContent::Frame(frame) => matcher.look(frame),
        RowContent::Undecodable(_) => matcher.look_away(row.sequence, row.timestamp_ns, Reason::Undecodable),
        RowContent::Skipped(_) => matcher.look_past(row.sequence, row.timestamp_ns),
    }
}
