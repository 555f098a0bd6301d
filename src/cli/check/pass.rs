//! One pass over a check's clip: tracks every frame with one shutter, counts outcomes and keeps
//! some frames.

use std::path::Path;

use crate::camera::KnownShutter;
use crate::capture::{ClipOptions, EntryContent, open_clip};
use crate::cli::failure::Failure;
use crate::cli::outcome::Outcome;
use crate::cli::replay::{progress::Progress, tracker_setup};
use crate::config::Settings;
use crate::daemon::track_entry;
use crate::diagnose::Travel;
use crate::frame::{Frame, Timestamp};
use crate::record::State;
use crate::track::{LearntCamera, ModelReport, Reason};
use crate::tracker::{Tracker, TrackerSetup};

/// Minimum shares of frames followed: for a clip to count as followed, and to be called good.
/// Chosen, not tuned. Raised: for the first, more reasons are faults; for the second, more clips
/// are searched for every fault and get no readout time.
pub(super) const FOLLOWED: f64 = 0.5;
pub(super) const WELL_FOLLOWED: f64 = 0.85;
/// Minimum shares of frames for a reason to be a warning, and to be mentioned at all. Chosen, not
/// tuned: a reason in one of fifty frames says nothing about the setup. Raised, fewer lines;
/// lowered, good clips get warnings.
pub(super) const WARNING_SHARE: f64 = 0.1;
pub(super) const NOTED: f64 = 0.02;

/// Maximum rows tracked: half a minute at 30 frames per second, chosen to keep a check short.
/// Raised, faults late in a long clip are found, and the check takes longer.
const MAX_ROWS: u64 = 900;
/// Maximum number of frames kept for diagnosis; at least half as many if the clip has them. Chosen:
/// diagnosis takes 8 or 10 at even steps. Raised, more whole frames are held in memory.
const KEPT: usize = 24;
/// Pose error, one sigma as a share of the camera's distance, above which it is reported even if no
/// part of the model explains it. It equals one pixel, at a focal length of 1000, in graphics that
/// follow the camera. Chosen: twice the cost at which a named part with a fix is reported. Raised,
/// misfits go unreported; lowered, stages that are good enough are sent to a survey.
pub(super) const MIN_DOUBT: f64 = 0.001;

/// The result of a pass over the clip.
#[derive(Clone)]
pub(super) struct Pass {
    /// Width and height of its frames, pixels.
    pub size: (u32, u32),
    /// Number of rows of the whole clip, if known.
    pub rows: Option<u64>,
    /// The setup it was tracked with.
    pub setup: TrackerSetup,
    /// The outcome of its frames.
    pub outcome: Outcome,
    /// Some of the frames, at even intervals.
    pub frames: Vec<Frame>,
    /// The camera's motion.
    pub travel: Travel,
    /// How the model fits, from the poses' residuals.
    pub model: ModelReport,
    /// Frames in which each object was tracked.
    pub objects: Vec<u64>,
    /// The clip reader's notes.
    pub notes: Vec<String>,
    /// Why the clip's stamps are implausible.
    pub doubt_of_stamps: Option<String>,
    stamps: Vec<Timestamp>,
}

impl Pass {
    /// Tracks the clip as configured, but with this shutter.
    pub(super) fn over(
        settings: &Settings,
        shutter: KnownShutter,
        clip: &Path,
        fps: Option<f64>,
        learnt: LearntCamera,
    ) -> Result<Self, Failure> {
        let calibrated = settings.lens.size(&settings.camera);
        let mut source = open_clip(clip, ClipOptions { fps, calibrated, ..ClipOptions::default() })?;
        let setup = TrackerSetup { shutter, learnt, ..tracker_setup(settings, source.size(), None)? };
        let mut tracker = Tracker::new(setup.clone().as_trial())?;
        tracker.matcher.study().study_model();
        let rows = source.rows();
        let progress = Progress::start(Some(rows.unwrap_or(MAX_ROWS).min(MAX_ROWS)));
        let (mut outcome, mut kept, mut travel) = (Outcome::default(), Kept::default(), Travel::default());
        let (mut stamps, mut objects) = (Vec::new(), vec![0_u64; setup.objects.len()]);
        while outcome.frames < MAX_ROWS {
            let Some(row) = source.next_entry() else { break };
            if let EntryContent::Frame(frame) = &row.content {
                kept.offer(frame);
                stamps.push(frame.timestamp);
            }
            let sample = track_entry(&mut tracker, &row);
            outcome.add(&sample);
            for (tracked, object) in objects.iter_mut().zip(&sample.objects) {
                *tracked += u64::from(object.state == State::Tracking);
            }
            if let (State::Tracking, Some(pose)) = (sample.state, &sample.pose) {
                travel.add(sample.timestamp, pose);
            }
            progress.advance();
        }
        progress.finish();
        let (model, notes, doubt_of_stamps) = (tracker.matcher.study().model_report(), source.notes(), source.doubt_of_stamps());
        tracing::debug!(?model, ?shutter, outcome.tracked, "how the model fits");
        Ok(Self { size: source.size(), rows, setup, outcome, frames: kept.frames, travel, model, objects, notes, doubt_of_stamps, stamps })
    }

    /// Returns the share of frames in which the stage is followed.
    pub(super) fn followed(&self) -> f64 {
        self.outcome.followed() as f64 / self.outcome.frames.max(1) as f64
    }

    /// Returns the share of frames whose pose is reported.
    pub(super) fn reported_share(&self) -> f64 {
        self.outcome.tracked as f64 / self.outcome.frames.max(1) as f64
    }

    /// Whether the poses' residuals are too small to mention and no frames were lost to a moved
    /// lens.
    pub(super) fn is_as_modelled(&self) -> bool {
        let moved: u64 = self.outcome.reasons().into_iter().filter(|(reason, _)| *reason == Reason::LensMoved).map(|(_, n)| n).sum();
        let is_moved = moved as f64 > NOTED * self.outcome.frames as f64;
        self.model.parts.is_empty() && self.model.doubt_share < MIN_DOUBT && !is_moved
    }

    /// Whether an unconfigured readout time may be the cause of a misfit: the picture is
    /// recognised, but poses are missing or misplaced.
    pub(super) fn may_lack_readout(&self) -> bool {
        let recognised = self.outcome.recognised() as f64 / self.outcome.frames.max(1) as f64;
        recognised >= FOLLOWED && (!self.is_as_modelled() || self.reported_share() < WELL_FOLLOWED)
    }

    /// Returns the median interval between frames, seconds; intervals of rows out of order are
    /// skipped.
    pub(super) fn frame_interval_s(&self) -> Option<f64> {
        interval_s(&self.stamps)
    }
}

fn interval_s(stamps: &[Timestamp]) -> Option<f64> {
    let mut steps: Vec<f64> = stamps.windows(2).map(|w| w[1].seconds_since(w[0])).filter(|step_s| *step_s > 0.0).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied()
}

/// Keeps frames at even intervals from a clip of unknown length: when there are too many, it drops
/// every second one.
#[derive(Default)]
struct Kept {
    frames: Vec<Frame>,
    seen: usize,
    step: usize,
}

impl Kept {
    fn offer(&mut self, frame: &Frame) {
        self.step = self.step.max(1);
        if self.seen.is_multiple_of(self.step) {
            self.frames.push(frame.clone());
        }
        self.seen += 1;
        if self.frames.len() > KEPT {
            let mut index = 0;
            self.frames.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.step *= 2;
        }
    }
}

#[cfg(test)]
mod tests {
    use image::GrayImage;

    use super::*;

    #[test]
    fn kept_frames_are_spread_over_the_clip() {
        let mut kept = Kept::default();
        for sequence in 0..500 {
            kept.offer(&Frame { image: GrayImage::new(1, 1), timestamp: Timestamp::default(), sequence });
        }
        let numbers: Vec<u64> = kept.frames.iter().map(|f| f.sequence).collect();
        assert!((KEPT / 2..=KEPT).contains(&numbers.len()) && numbers[0] == 0 && *numbers.last().unwrap() > 450, "{numbers:?}");
        assert!(numbers.windows(2).all(|w| w[1] - w[0] == numbers[1]), "{numbers:?}");
    }

    #[test]
    fn the_interval_is_that_of_most_frames() {
        let stamps = [0, 40_000_000, 80_000_000, 80_000_000, 900_000_000, 940_000_000].map(Timestamp::from_ns);
        assert_eq!(interval_s(&stamps), Some(0.04));
        assert_eq!(interval_s(&stamps[..1]), None);
    }
}
