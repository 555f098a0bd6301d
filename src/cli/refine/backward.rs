//! Tracks backward in time through rows in which the camera was not found: from the first row after
//! a gap in which it was. What comes into view late, or is found late, is then followed back to
//! where it can no longer be seen.

use std::collections::VecDeque;

use crate::camera::KnownShutter;
use crate::capture::{EntryContent, FrameSource};
use crate::cli::failure::Failure;
use crate::cli::interrupt;
use crate::frame::{Frame, Timestamp};
use crate::record::{PoseSample, State};
use crate::track::LearntCamera;
use crate::tracker::{Tracker, TrackerSetup};

/// Frames of a gap that are kept, the last ones. Raised, more of long gaps is searched, and more
/// memory is used (2 MB for a frame of 1920 x 1080).
const MAX_GAP_FRAMES: usize = 100;
/// Time between two gaps in the tracker's own time, seconds, so that it does not expect the camera
/// where the other gap left it. Lowered, it may.
const PAUSE_S: f64 = 10.0;
/// Tracked rows after a gap that are tracked again first, so that the motion is known where the gap
/// ends. Raised, gaps cost more.
const LEAD_ROWS: usize = 4;

/// Replaces the samples of rows without a pose by what tracking backward finds in them. `source`:
/// the clip once more, from its first row.
///
/// # Errors
/// When the setup cannot become a tracker, or the user interrupted the command.
pub fn find_missing(samples: &mut [PoseSample], mut source: Box<dyn FrameSource>, setup: TrackerSetup) -> Result<(), Failure> {
    if samples.iter().all(|sample| sample.state == State::Tracking) {
        return Ok(());
    }
    let mut tracker: Option<Backward> = None;
    let setup = reversed(setup, samples.last().map_or(LearntCamera::default(), |sample| sample.learnt));
    // The last rows with frames: those of a gap, then the first tracked ones after it.
    let mut kept: VecDeque<(usize, Frame)> = VecDeque::new();
    let mut lead = 0;
    let mut row = 0;
    while let Some(entry) = source.next_entry() {
        if interrupt::is_interrupted() {
            return Err(Failure::Interrupted);
        }
        let Some(sample) = samples.get(row) else { break };
        let is_tracked = sample.state == State::Tracking;
        if let EntryContent::Frame(frame) = entry.content
            && !(is_tracked && kept.is_empty())
        {
            kept.push_back((row, frame));
            lead = if is_tracked { lead + 1 } else { 0 };
        }
        row += 1;
        let is_last = samples.get(row).is_none();
        if lead == LEAD_ROWS || lead > 0 && is_last {
            let tracker = match &mut tracker {
                Some(tracker) => tracker,
                None => tracker.insert(Backward { tracker: Tracker::new(setup.clone())?, now: Timestamp::default() }),
            };
            tracker.track(samples, &mut kept);
            lead = 0;
        }
        while kept.len() > MAX_GAP_FRAMES + lead {
            kept.pop_front();
        }
    }
    Ok(())
}

/// A tracker whose time runs on from gap to gap, while the frames of each come from the last to the
/// first.
struct Backward {
    tracker: Tracker,
    now: Timestamp,
}

impl Backward {
    /// Tracks the kept rows from the last to the first.
    fn track(&mut self, samples: &mut [PoseSample], kept: &mut VecDeque<(usize, Frame)>) {
        let (start, last) = (self.now, kept.back().map_or(self.now, |(_, frame)| frame.timestamp));
        while let Some((row, frame)) = kept.pop_back() {
            self.now = start.after_s(last.seconds_since(frame.timestamp));
            let Ok(found) = self.tracker.track(&Frame { timestamp: self.now, ..frame }) else { continue };
            let own = &mut samples[row];
            if own.state != State::Tracking && found.state == State::Tracking {
                *own = PoseSample { sequence: own.sequence, timestamp: own.timestamp, learnt: own.learnt, ..found };
            }
        }
        self.now = self.now.after_s(PAUSE_S);
    }
}

/// Returns the setup of a camera whose time runs backward: its rows are read from the last to the
/// first.
fn reversed(setup: TrackerSetup, learnt: LearntCamera) -> TrackerSetup {
    let readout_s = setup.shutter.readout_s.or(learnt.readout.map(|readout| readout.seconds));
    let exposure_s = setup.shutter.exposure_s.or(learnt.exposure.map(|exposure| exposure.seconds));
    let shutter = KnownShutter { readout_s: readout_s.map(|readout_s| -readout_s), exposure_s };
    let learnt = LearntCamera { readout: None, exposure: None, ..learnt };
    TrackerSetup { shutter, learnt, ..setup }
}
