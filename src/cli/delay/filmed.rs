//! Measures a camera's rotations over a clip, or reads them from a log.

use std::path::Path;

use nalgebra::UnitQuaternion;

use crate::capture::{ClipEntry, EntryContent};
use crate::cli::clip_rows::{self, RowCount};
use crate::cli::failure::Failure;
use crate::cli::pose_log;
use crate::cli::replay::tracker_setup;
use crate::config::Settings;
use crate::daemon::{learnt_of_clip, track_entry, utc_ahead_of_clip_ns};
use crate::delay::{Panorama, RowMean, Turn, Turns};
use crate::frame::Timestamp;
use crate::record::State;
use crate::track::LearntCamera;
use crate::tracker::{Tracker, TrackerSetup};

/// Readout of a rolling shutter of unknown readout, seconds: the usual webcam's. Raised, delays of
/// cameras that film detail only above or below the middle are less certain.
pub(super) const USUAL_READOUT_S: f64 = 0.02;
/// How exactly a tracked pose is that of the stamp's instant, one sigma, seconds: by what delays
/// between rendered clips are off beyond their noise (`benches/delay.py`: tracked, slower). Raised,
/// sigmas of good clips are too large.
const INSTANT_SIGMA_S: f64 = 2e-5;

/// How rotations were measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Means {
    /// From tracked poses.
    Poses,
    /// From each picture to the next.
    Pictures,
    /// By another tracker.
    Log,
}

/// The rotations of a camera.
pub(super) struct Filmed {
    pub turns: Turns,
    pub means: Means,
    /// The clip or log, for messages.
    pub name: String,
    /// The instant from which times are counted.
    pub origin: Timestamp,
    /// Number of frames or lines, and of those with a pose or a rotation.
    pub rows: usize,
    pub measured: usize,
    /// Where in the pictures rotations were seen, and the readout, if it is known.
    row_mean: RowMean,
    readout_s: Option<f64>,
}

impl Filmed {
    /// Returns how long after the stamp the rows were read in which rotations were seen, and the
    /// sigma of it, seconds. Poses are those of the middle row, and logs those of their stamps.
    pub fn row_delay_s(&self) -> (f64, f64) {
        match self.means {
            Means::Poses => return (0.0, INSTANT_SIGMA_S),
            Means::Log => return (0.0, 0.0),
            Means::Pictures => {}
        }
        let share = self.row_mean.share();
        self.readout_s.map_or((0.0, share.abs() * USUAL_READOUT_S), |readout_s| (share * readout_s, 0.0))
    }

    /// Says in a sentence what was found.
    pub fn seen(&self) -> String {
        let Self { rows, measured, name, .. } = self;
        match self.means {
            Means::Poses => format!("{name}: {measured} of {rows} frames show the stage"),
            Means::Pictures => format!("{name}: {measured} rotations between {rows} frames"),
            Means::Log => format!("{name}: {measured} poses"),
        }
    }

    /// Says what to do if there is nothing.
    pub fn hint(&self) -> &'static str {
        match self.means {
            Means::Poses => "`stagepose check --clip CLIP --config FILE` says why",
            Means::Pictures => "film something with detail, in light",
            Means::Log => "give the log of a tracker that moved",
        }
    }
}

/// Measures a clip: tracks it if the config has a stage and a calibration, otherwise compares
/// successive pictures: a guessed lens turns shifts of the camera into rotations of its poses.
/// Times are counted from `origin`, by default the first stamp.
pub(super) fn clip_turns(settings: &Settings, clip: &Path, origin: Option<Timestamp>) -> Result<Filmed, Failure> {
    if clip == Path::new("-") {
        return Err(Failure::Usage("a clip is -; the clips of both cameras must be files or folders".to_owned()));
    }
    if settings.stage.surfaces.is_empty() || settings.lens.calibration_file().is_none() {
        return Ok(pass(settings, clip, origin, |setup| Ok(Measuring::of_pictures(setup)))?.filmed(settings, clip));
    }
    let mut learnt = learnt_of_clip(clip).unwrap_or_else(|reason| {
        tracing::warn!("{reason}");
        LearntCamera::default()
    });
    let first = pass(settings, clip, origin, |setup| Measuring::of_poses(setup, learnt))?;
    let Measuring::Poses(tracker, _) = &first.measuring else { return Ok(first.filmed(settings, clip)) };
    let is_known = settings.shutter.readout_s.is_some() || learnt.readout.is_some();
    learnt = tracker.learnt();
    if is_known || learnt.readout.is_none() {
        return Ok(first.filmed(settings, clip));
    }
    // The first poses were measured before the shutter was known.
    Ok(pass(settings, clip, origin, |setup| Measuring::of_poses(setup, learnt))?.filmed(settings, clip))
}

/// A clip, read from its first row to its last.
struct Pass {
    measuring: Measuring,
    origin: Timestamp,
    rows: usize,
}

/// Reads a clip; `make` starts to measure, given the setup for its pictures.
fn pass(
    settings: &Settings,
    clip: &Path,
    mut origin: Option<Timestamp>,
    make: impl FnOnce(TrackerSetup) -> Result<Measuring, Failure>,
) -> Result<Pass, Failure> {
    let mut source = clip_rows::open(settings, clip, None)?;
    let mut measuring = make(tracker_setup(settings, source.size(), None)?)?;
    let mut count = RowCount::default();
    while let Some(row) = source.next_entry() {
        count.add(&row)?;
        measuring.take(&row, *origin.get_or_insert(row.timestamp));
    }
    Ok(Pass { measuring, origin: origin.unwrap_or_default(), rows: count.finish(clip)? })
}

impl Pass {
    fn filmed(self, settings: &Settings, clip: &Path) -> Filmed {
        let Self { measuring, origin, rows } = self;
        let (means, measured, row_mean, turns) = match measuring {
            Measuring::Poses(_, poses) => (Means::Poses, poses.len(), RowMean::default(), Turns::of_orientations(origin, poses)),
            Measuring::Pictures(panorama, turns) => (Means::Pictures, turns.len(), panorama.rows(), Turns::new(turns)),
        };
        Filmed { turns, means, name: clip.display().to_string(), origin, rows, measured, row_mean, readout_s: settings.shutter.readout_s }
    }
}

/// A clip that is being measured.
enum Measuring {
    /// The tracker, and its poses so far.
    Poses(Box<Tracker>, Vec<(Timestamp, UnitQuaternion<f64>)>),
    /// The rotations from picture to picture so far.
    Pictures(Box<Panorama>, Vec<Turn>),
}

impl Measuring {
    fn of_poses(setup: TrackerSetup, learnt: LearntCamera) -> Result<Self, Failure> {
        // Objects say nothing about the camera's rotation.
        let tracker = Tracker::new(TrackerSetup { learnt, objects: Vec::new(), ..setup })?;
        Ok(Self::Poses(Box::new(tracker), Vec::new()))
    }

    fn of_pictures(setup: TrackerSetup) -> Self {
        Self::Pictures(Box::new(Panorama::new(setup.camera, setup.mask)), Vec::new())
    }

    fn take(&mut self, row: &ClipEntry, origin: Timestamp) {
        match self {
            Self::Poses(tracker, poses) => {
                let sample = track_entry(tracker, row);
                let measured = sample.measurement.filter(|_| sample.state == State::Tracking);
                poses.extend(measured.map(|measured| (row.timestamp, measured.pose.rotation)));
            }
            Self::Pictures(panorama, turns) => {
                let EntryContent::Frame(frame) = &row.content else { return };
                turns.extend(panorama.take(row.timestamp.seconds_since(origin), &frame.image));
            }
        }
    }
}

/// Reads the log of another tracker. Stamps in UTC are converted to the clip's clock, which a
/// recording states in its `clip.toml`.
pub(super) fn log_turns(file: &Path, clip: &Path, origin: Timestamp) -> Result<Filmed, Failure> {
    let name = file.display().to_string();
    let log = pose_log::read(file, Failure::Delay)?;
    let mut rows = log.rows;
    if log.is_utc {
        let ahead_ns = utc_ahead_of_clip_ns(clip).ok_or_else(|| {
            Failure::Delay(format!(
                "{name}: its stamps are UTC, and {} has no clip.toml that says how its clock relates to UTC; record the clip with \
                 `stagepose record`",
                clip.display()
            ))
        })?;
        rows.iter_mut().for_each(|row| row.at = row.at.after_ns(ahead_ns.saturating_neg()));
    }
    let measured = rows.len();
    let turns = Turns::of_orientations(origin, rows.into_iter().map(|row| (row.at, row.rotation)));
    Ok(Filmed { turns, means: Means::Log, name, origin, rows: measured, measured, row_mean: RowMean::default(), readout_s: None })
}
