//! Measures the camera's pose in every row of a clip of still views.

use std::path::Path;

use crate::camera::CameraModel;
use crate::capture::{ClipEntry, EntryContent, FrameSource};
use crate::cli::clip_rows::{self, RowCount};
use crate::cli::failure::Failure;
use crate::cli::replay::tracker_setup;
use crate::config::Settings;
use crate::daemon::track_entry;
use crate::frame::{Frame, Timestamp};
use crate::mount::View;
use crate::record::State;
use crate::track::TrackerSettings;
use crate::tracker::{Tracker, TrackerSetup};

/// Maximum rows of a clip that is taken for single pictures, and how often the tracker is shown
/// each of them, because it reports no pose until another frame confirms it. Chosen: the first is
/// two seconds of film; raised, short films are solved as stills. The second is more than the two
/// that a confirmed pose needs; raised, it only takes longer.
const MAX_STILLS: u64 = 60;
const TIMES_SHOWN: u64 = 4;
/// Interval at which stills are shown to the tracker, nanoseconds: a webcam's at 30 frames per
/// second. Nothing moves, so the value matters little.
const PACE_NS: i64 = 33_333_333;
/// Interval from one still to the next, nanoseconds. The rig was carried meanwhile, so a pose
/// elsewhere is not a jump; lowered, it may be taken for one.
const CARRIED_NS: i64 = 10_000_000_000;

/// The measurements of a clip.
pub(super) struct Measured {
    /// The camera, scaled to the size of the clip's pictures.
    pub camera: CameraModel,
    /// The pose in every row, without the calibration's share of the covariance; `None` if the
    /// stage was not found.
    pub rows: Vec<Option<View>>,
}

/// Tracks a clip from its first row to its last.
pub(super) fn measure(settings: &Settings, clip: &Path) -> Result<Measured, Failure> {
    if clip == Path::new("-") {
        return Err(Failure::Usage("--clip is -; the clips of both cameras must be files or folders".to_owned()));
    }
    let mut source = clip_rows::open(settings, clip, None)?;
    let setup = tracker_setup(settings, source.size(), None)?;
    let camera = setup.camera;
    // Objects say nothing about the mount.
    let settings = TrackerSettings { adds_lens_doubt: false, ..setup.settings };
    let setup = TrackerSetup { settings, objects: Vec::new(), ..setup };
    let (first, is_stills) = beginning(source.as_mut());
    let mut tracker = Tracker::new(setup)?;
    let (mut rows, mut count) = (Vec::new(), RowCount::default());
    for row in first.into_iter().chain(std::iter::from_fn(|| source.next_entry())) {
        count.add(&row)?;
        rows.push(if is_stills { still(&mut tracker, &row, rows.len()) } else { view(&mut tracker, &row) });
    }
    count.finish(clip)?;
    Ok(Measured { camera, rows })
}

/// Returns the rows that had to be read to tell whether the clip is one of single pictures, and the
/// answer.
fn beginning(source: &mut dyn FrameSource) -> (Vec<ClipEntry>, bool) {
    if let Some(rows) = source.rows() {
        return (Vec::new(), rows <= MAX_STILLS);
    }
    let first: Vec<ClipEntry> = std::iter::from_fn(|| source.next_entry()).take(MAX_STILLS as usize + 1).collect();
    let is_stills = first.len() as u64 <= MAX_STILLS;
    (first, is_stills)
}

/// Tracks a row of a film.
fn view(tracker: &mut Tracker, row: &ClipEntry) -> Option<View> {
    let sample = track_entry(tracker, row);
    let measured = sample.measurement.filter(|_| sample.state == State::Tracking)?;
    Some(View { pose: measured.pose, covariance: measured.covariance })
}

/// Tracks a single picture: shows it until it could be confirmed; the last result counts.
fn still(tracker: &mut Tracker, row: &ClipEntry, index: usize) -> Option<View> {
    let EntryContent::Frame(frame) = &row.content else { return None };
    let mut last = None;
    for k in 0..TIMES_SHOWN {
        let sequence = index as u64 * TIMES_SHOWN + k;
        let timestamp = Timestamp::from_ns(index as i64 * CARRIED_NS + k as i64 * PACE_NS);
        let shown = Frame { image: frame.image.clone(), sequence, timestamp };
        // A picture of another size yields nothing.
        last = tracker.track(&shown).ok().and_then(|sample| sample.measurement.filter(|_| sample.state == State::Tracking));
    }
    last.map(|measured| View { pose: measured.pose, covariance: measured.covariance })
}
