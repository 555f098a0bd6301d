//! Tracks a row of a clip: every row yields a sample, whatever it holds.

use crate::capture::{ClipEntry, EntryContent};
use crate::frame::Frame;
use crate::record::PoseSample;
use crate::track::{Matcher, Reason, Sighting};
use crate::tracker::{PoseRecorder, Tracker};

/// Tracks a row in the calling thread.
pub fn track_entry(tracker: &mut Tracker, row: &ClipEntry) -> PoseSample {
    let sighting = sight(&mut tracker.matcher, row);
    sample(&mut tracker.poses, &sighting, row)
}

/// Returns the matcher's result for a row, in the matcher's own time.
pub(super) fn sight(matcher: &mut Matcher, row: &ClipEntry) -> Sighting {
    match &row.content {
        EntryContent::Frame(frame) => {
            let own = matcher.own_time(row.timestamp);
            match own == frame.timestamp {
                // The same picture again yields no new measurement.
                _ if row.repeats && matcher.has_given() => matcher.look_away(row.sequence, own, Reason::Repeated),
                true => matcher.look(frame),
                false => matcher.look(&Frame { timestamp: own, ..frame.clone() }),
            }
        }
        EntryContent::Undecodable(_) => {
            let own = matcher.own_time(row.timestamp);
            matcher.look_away(row.sequence, own, Reason::Undecodable)
        }
        EntryContent::Skipped(_) => matcher.look_past(row.sequence, row.timestamp),
    }
}

/// Returns the sample for a row's sighting, with the row's stamp.
pub(super) fn sample(poses: &mut PoseRecorder, sighting: &Sighting, row: &ClipEntry) -> PoseSample {
    let sample = poses.sample(sighting, row.decode.as_secs_f64() * 1e3);
    PoseSample { timestamp: row.timestamp, ..sample }
}
