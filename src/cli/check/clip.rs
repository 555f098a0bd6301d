//! The clip of a check: tracked as `replay` would, counted, and diagnosed by what its frames show.

use std::path::Path;

use crate::capture::{ClipOptions, EntryContent, open_clip};
use crate::cli::failure::Failure;
use crate::cli::outcome::Outcome;
use crate::cli::replay::{progress::Progress, tracker_setup};
use crate::config::Settings;
use crate::daemon::track_entry;
use crate::diagnose::{Finding, Grade, Travel, corners_begun_at_top_left, of_clip, of_shutter};
use crate::frame::{Frame, Timestamp};
use crate::record::State;
use crate::track::{ModelNews, ModelReport, Part, Reason};
use crate::tracker::{Tracker, TrackerSetup};

/// Rows that are tracked at most: half a minute at 30 frames a second, chosen so that a check stays short. Raised, faults late in a long
/// clip are seen, and the check takes longer.
const MOST_ROWS: u64 = 900;
/// Frames that are kept for trying, at least half as many where the clip has them. Chosen: what tries them takes 8 or 10 at even steps.
/// Raised, more whole frames are held in memory.
const KEPT: usize = 24;
/// Share of the frames that must be followed for a clip to count as followed, and to be called good. Chosen, not tuned. The first raised,
/// more reasons are faults; the second, more clips are searched for every fault and get no readout time.
pub(super) const FOLLOWED: f64 = 0.5;
pub(super) const WELL_FOLLOWED: f64 = 0.85;
/// Share of the frames from which a reason is a warning, and from which it is named at all. Chosen, not tuned: a reason of one frame in
/// fifty says nothing of the setup. Raised, fewer lines; lowered, good clips get warnings.
const TOLD: f64 = 0.1;
const NOTED: f64 = 0.02;

/// What a clip showed.
pub(super) struct Examined {
    /// Width and height of its frames, pixels.
    pub size: (u32, u32),
    /// The clip itself, in words.
    pub line: String,
    /// How many frames were found, followed and given.
    pub counts: String,
    /// What is to be said, worst first.
    pub findings: Vec<Finding>,
    /// Share of the frames in which the stage is followed.
    pub followed: f64,
    /// Whether what poses leave displaced is worth no word.
    pub is_as_modelled: bool,
}

/// Frames at even intervals from a clip of unknown length: whenever there are too many, every other one is dropped.
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

/// Tracks a clip and finds out why what is not followed is not.
pub(super) fn examine(settings: &Settings, clip: &Path, fps: Option<f64>) -> Result<Examined, Failure> {
    let mut source = open_clip(clip, ClipOptions { fps, calibrated: settings.lens.size(&settings.camera), ..ClipOptions::default() })?;
    let (width, height) = source.size();
    let total = source.rows();
    let setup = tracker_setup(settings, (width, height), None)?;
    let mut tracker = Tracker::new(setup.clone().as_trial())?;
    tracker.matcher.study_model();
    let progress = Progress::start(Some(total.unwrap_or(MOST_ROWS).min(MOST_ROWS)));
    let (mut outcome, mut kept, mut travel) = (Outcome::default(), Kept::default(), Travel::default());
    let mut stamps = Vec::new();
    let mut objects = vec![0_u64; setup.objects.len()];
    while outcome.frames < MOST_ROWS {
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
    let share = outcome.followed() as f64 / outcome.frames.max(1) as f64;
    let model = tracker.matcher.model_report();
    tracing::debug!(?model, share, "how the model fits");
    let is_small = share >= FOLLOWED && !model.parts.is_empty() && model.parts.iter().all(|news| news.part.is_small());
    let mut findings = of_clip(&setup, &kept.frames, share >= WELL_FOLLOWED, is_small, &travel);
    // A lens that was moved while rows are compared from frame to frame is no shutter either.
    let moved = outcome.reasons().into_iter().filter(|(reason, _)| matches!(reason, Reason::LensMoved)).map(|(_, n)| n).sum::<u64>();
    let is_moved = moved as f64 > NOTED * outcome.frames as f64;
    let is_as_modelled = model.parts.is_empty() && model.doubt_share < LEAST_DOUBT && !is_moved;
    findings.extend(of_model(&model, &findings));
    // A lens or a layout that is named explains why no pose fits, too.
    let has_cause = findings.iter().any(|f| f.grade == Grade::Fault || (is_small && f.grade == Grade::Doubt));
    findings.extend(of_reasons(&outcome, has_cause));
    findings.extend(setup.objects.iter().zip(&objects).filter_map(|(object, tracked)| of_object(&object.name, *tracked, outcome.tracked)));
    findings.extend(travel.findings(&settings.stage));
    findings.extend(of_roll(&travel, &setup));
    if let Some(frame_s) = frame_interval_s(&stamps) {
        findings.extend(settings.safety.note_on_rate(1.0 / frame_s).map(Finding::warning));
        findings.extend(of_shutter(&settings.shutter, frame_s));
    }
    findings.extend(of_rate(clip, fps));
    findings.extend(source.notes().iter().map(Finding::note));
    let rows = match total {
        Some(rows) if rows > outcome.frames => format!("the first {} of {rows} frames", outcome.frames),
        _ => format!("{} frames", outcome.frames),
    };
    Ok(Examined {
        size: (width, height),
        line: format!("{}: {rows} of {width} x {height} pixels", clip.display()),
        counts: format!(
            "the picture is found in {} of {} frames, followed in {}, its pose given in {}",
            outcome.recognised(),
            outcome.frames,
            outcome.followed(),
            outcome.tracked
        ),
        findings,
        followed: share,
        is_as_modelled,
    })
}

/// How far poses may be off, one sigma and as a share of the camera's distance, for it to be told where no part of the model explains it: a pixel in what follows the camera at a focal
/// length of 1000. Chosen: twice what a part must cost that has a name and a mend. Raised, what does not fit goes unsaid; lowered, stages that are good enough are to be surveyed.
const LEAST_DOUBT: f64 = 0.001;
/// Views that differ from which on it may be said that no part explains them; fewer show much the same, however many frames they have, and some of what one frame shows
/// always fits no part. Chosen, not tuned. Raised, only long walks are judged.
const LEAST_VIEWS: usize = 4;

/// Which part of the stage or the lens is not as told, by what poses leave of the tiles' displacements; where something graver was found, that comes first.
fn of_model(model: &ModelReport, findings: &[Finding]) -> Vec<Finding> {
    if findings.iter().any(|f| matches!(f.grade, Grade::Fault | Grade::Doubt)) {
        return Vec::new();
    }
    let ModelReport { parts, left_px, doubt_mm, doubt_share, views } = model;
    if parts.is_empty() && *doubt_share >= LEAST_DOUBT {
        let seen =
            format!("the stage is seen {left_px:.2} px (rms) from where its poses have it, so that they may be {doubt_mm:.1} mm off");
        let walk = "walk past it, to both sides and near and far, and check that clip, or survey the stage by it";
        return vec![match *views >= LEAST_VIEWS {
            true => Finding::warning(format!(
                "{seen}, and no part that stays as it is explains that; cloth that moves would: keep draughts from it or weigh it down. If nothing moves: {walk}"
            )),
            false => Finding::note(format!("{seen}; the clip's views are too alike to tell why: {walk}")),
        }];
    }
    let grade = |news: &ModelNews| match news.part {
        // Cloth hangs in folds, and is tracked, less well than it could be.
        Part::Shape { .. } => Finding::warning(news.text()),
        _ => Finding::doubt(news.text()),
    };
    parts.iter().map(grade).collect()
}

/// The reasons of the frames that were not tracked. Where a fault was found that explains why no pose fits, that one has the mend.
fn of_reasons(outcome: &Outcome, has_cause: bool) -> Vec<Finding> {
    let frames = outcome.frames;
    let share = |n: u64| n as f64 / frames.max(1) as f64;
    let told = outcome.reasons().into_iter().filter(|(reason, n)| match reason {
        // A find waits a frame for the next one.
        Reason::Unconfirmed => share(*n) > 1.0 - FOLLOWED && frames > 2,
        _ => share(*n) >= NOTED || *n == frames,
    });
    told.map(|(reason, n)| {
        let says = format!("in {n} of {frames} frames {}", reason.says());
        let is_explained = has_cause && matches!(reason, Reason::NoPoseFits | Reason::Covered | Reason::NotRecognised | Reason::Uncertain);
        let says = if is_explained { says } else { format!("{says}: {}", reason.mend()) };
        match share(n) {
            _ if is_explained => Finding::note(says),
            s if s > 1.0 - FOLLOWED => Finding::fault(says),
            s if s >= TOLD => Finding::warning(says),
            _ => Finding::note(says),
        }
    })
    .collect()
}

/// How often an object was tracked, of the frames in which the stage was.
fn of_object(name: &str, tracked: u64, frames: u64) -> Option<Finding> {
    match (tracked, frames) {
        (_, 0) => None,
        (0, _) => Some(Finding::warning(format!(
            "object {name}: it is tracked in none of the {frames} frames that have a pose: if the clip shows it, check its picture and size_m; \
             if not, show it, near and turned to the camera"
        ))),
        _ => Some(Finding::note(format!("object {name}: it is tracked in {tracked} of the {frames} frames that have a pose"))),
    }
}

/// A camera that hangs upside down tracks as well as any; so does one whose picture was given upside down.
fn of_roll(travel: &Travel, setup: &TrackerSetup) -> Option<Finding> {
    let roll = travel.roll_deg()?;
    let surface = setup.stage.surfaces.first()?;
    let name = &surface.name;
    let line = corners_begun_at_top_left(surface).map_or_else(String::new, |line| format!(": {line}"));
    let turned = match roll.abs() {
        r if r > 150.0 => "upside down",
        r if (60.0..120.0).contains(&r) => "on its side",
        _ => return None,
    };
    Some(Finding::doubt(format!(
        "by its poses the camera hangs {turned} (rolled by {roll:.0} degrees): that is right if it is mounted so, and nothing is to be mended; if it \
         is not, {name} is {turned}: turn the picture's file, or begin corners_px at the corner that is the top left one on the stage{line}"
    )))
}

/// The median time between two frames, seconds; rows that are out of order are skipped, with their intervals.
fn frame_interval_s(stamps: &[Timestamp]) -> Option<f64> {
    let mut steps: Vec<f64> = stamps.windows(2).map(|w| w[1].seconds_since(w[0])).filter(|step_s| *step_s > 0.0).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied()
}

/// A clip without stamps is played at a rate that nobody gave.
fn of_rate(clip: &Path, fps: Option<f64>) -> Option<Finding> {
    let is_stream = clip.extension().is_some_and(|e| e.eq_ignore_ascii_case("mjpeg") || e.eq_ignore_ascii_case("mjpg"));
    let has_none = if clip.is_dir() { !clip.join("timestamps.csv").is_file() } else { is_stream };
    (has_none && fps.is_none()).then(|| {
        Finding::warning(
            "the clip has no stamps, so that 30 frames a second are assumed: give its rate with --fps, to check and to replay, or speeds, blur and \
             the shutter come out wrong",
        )
    })
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
        assert_eq!(frame_interval_s(&stamps), Some(0.04));
        assert_eq!(frame_interval_s(&stamps[..1]), None);
    }

    #[test]
    fn a_rate_that_nobody_gave_is_told() {
        assert!(of_rate(Path::new("walk.mjpeg"), None).is_some());
        assert!(of_rate(Path::new("walk.mjpeg"), Some(25.0)).is_none());
        assert!(of_rate(Path::new("walk.y4m"), None).is_none());
    }
}
