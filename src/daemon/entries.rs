//! Tracks a row of a clip: every row yields a sample, whatever it holds.

use crate::capture::{ClipEntry, EntryContent};
use crate::frame::Frame;
use crate::record::PoseSample;
use crate::track::{BodyTracker, FrameObservation, Reason};
use crate::tracker::{PoseRecorder, Tracker};

/// Tracks a row in the calling thread.
pub fn track_entry(tracker: &mut Tracker, row: &ClipEntry) -> PoseSample {
    let observation = sight(&mut tracker.matcher, row);
    sample(&mut tracker.poses, &observation, row)
}

/// Returns the matcher's result for a row, in the matcher's own time.
pub(super) fn sight(matcher: &mut BodyTracker, row: &ClipEntry) -> FrameObservation {
    match &row.content {
        EntryContent::Frame(frame) => {
            let own = matcher.own_time(row.timestamp);
            match own == frame.timestamp {
                // The same picture again yields no new measurement.
                _ if row.repeats && matcher.has_reported() => matcher.miss_frame(row.sequence, own, Reason::Repeated),
                true => matcher.track_frame(frame),
                false => matcher.track_frame(&Frame { timestamp: own, ..frame.clone() }),
            }
        }
        EntryContent::Undecodable(_) => {
            let own = matcher.own_time(row.timestamp);
            matcher.miss_frame(row.sequence, own, Reason::Undecodable)
        }
        EntryContent::Skipped(_) => matcher.skip_row(row.sequence, row.timestamp),
    }
}

/// Returns the sample for a row's observation, with the row's stamp.
pub(super) fn sample(poses: &mut PoseRecorder, observation: &FrameObservation, row: &ClipEntry) -> PoseSample {
    let sample = poses.sample(observation, row.decode.as_secs_f64() * 1e3);
    PoseSample { timestamp: row.timestamp, ..sample }
}
