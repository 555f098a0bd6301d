//! The clip of a check: tracked as `replay` would, counted, and diagnosed by what its frames show.

use std::path::Path;

use super::pass::{FOLLOWED, LEAST_DOUBT, NOTED, Pass, TOLD, WELL_FOLLOWED};
use super::readout::Readout;
use crate::cli::failure::Failure;
use crate::cli::outcome::Outcome;
use crate::config::{LensSource, Settings};
use crate::diagnose::{Finding, Grade, Shown, Travel, corners_begun_at_top_left, of_clip, of_shutter};
use crate::track::{LearntCamera, ModelNews, ModelReport, Part, Reason, ReferenceKind};
use crate::tracker::TrackerSetup;

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
    /// What the clip tells of the shutter, where that was asked already.
    pub shutter: Option<Vec<String>>,
}

/// Tracks a clip and finds out why what is not followed is not.
pub(super) fn examine(settings: &Settings, clip: &Path, fps: Option<f64>, learnt: LearntCamera) -> Result<Examined, Failure> {
    let as_configured = Pass::over(settings, settings.shutter, clip, fps, learnt)?;
    // What rows of a rolling shutter are displaced by looks like another lens, another shape and another layout, and those are asked
    // only once it is none of it.
    let readout = Readout::that_helps(settings, &as_configured, clip, fps)?;
    let (mut findings, shutter, pass) = match readout {
        Some(readout) => (vec![readout.finding(&as_configured)], Some(readout.lines), readout.pass),
        None => (Vec::new(), None, as_configured.clone()),
    };
    findings.extend(of_pass(&pass, settings));
    if let Some(frame_s) = pass.frame_interval_s().filter(|_| pass.doubt_of_stamps.is_none()) {
        findings.extend(settings.safety.note_on_rate(1.0 / frame_s).map(Finding::warning));
        findings.extend(of_shutter(&settings.shutter.or_zero(), frame_s));
    }
    findings.extend(of_rate(clip, fps));
    findings.extend(pass.notes.iter().filter(|note| Some(*note) != pass.doubt_of_stamps.as_ref()).map(Finding::note));
    findings.extend(pass.doubt_of_stamps.as_ref().map(Finding::fault));
    let Pass { outcome, rows, size, .. } = &as_configured;
    let of_rows = match rows {
        Some(rows) if *rows > outcome.frames => format!("the first {} of {rows} frames", outcome.frames),
        _ => format!("{} frames", outcome.frames),
    };
    Ok(Examined {
        size: *size,
        line: format!("{}: {of_rows} of {} x {} pixels", clip.display(), size.0, size.1),
        counts: format!(
            "the picture is found in {} of {} frames, followed in {}, its pose given in {}",
            outcome.recognised(),
            outcome.frames,
            outcome.followed(),
            outcome.tracked
        ),
        findings,
        followed: as_configured.followed(),
        is_as_modelled: as_configured.is_as_modelled(),
        shutter,
    })
}

/// What a pass over the clip says of the stage, the lens and the camera's way.
fn of_pass(pass: &Pass, settings: &Settings) -> Vec<Finding> {
    let Pass { setup, outcome, frames, travel, model, objects, .. } = pass;
    let share = pass.followed();
    let is_small = share >= FOLLOWED && !model.parts.is_empty() && model.parts.iter().all(|news| news.part.is_small());
    let guess = match settings.lens {
        LensSource::Guess(guess, _) => Some(guess),
        LensSource::Calibration(_) => None,
    };
    let mut findings = of_clip(&Shown { setup, frames, is_followed: share >= WELL_FOLLOWED, is_explained: is_small, travel, guess });
    findings.extend(of_model(model, &findings));
    // A lens or a layout that is named explains why no pose fits, too.
    let has_cause = findings.iter().any(|f| f.grade == Grade::Fault || (is_small && f.grade == Grade::Doubt));
    if !outcome.awaits_a_second_frame() {
        findings.extend(of_reasons(outcome, has_cause, setup));
    }
    // Where something graver was found, that is why.
    if outcome.tracked == 0 && outcome.frames > 0 && !findings.iter().any(|f| matches!(f.grade, Grade::Fault | Grade::Doubt)) {
        findings.push(of_no_pose(outcome.frames));
    }
    findings.extend(setup.objects.iter().zip(objects).filter_map(|(object, tracked)| of_object(&object.name, *tracked, outcome.tracked)));
    findings.extend(travel.findings(&settings.stage));
    findings.extend(of_roll(travel, setup));
    findings
}

/// A clip that gave no pose shows nothing good, however short it is.
fn of_no_pose(frames: u64) -> Finding {
    Finding::warning(match frames {
        1 => "the clip is one picture, which has no frame after it that confirms its pose: check a clip of two seconds or more".to_owned(),
        n => format!("none of the clip's {n} frames has a pose: check a clip of two seconds or more that shows the stage"),
    })
}

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
fn of_reasons(outcome: &Outcome, has_cause: bool, setup: &TrackerSetup) -> Vec<Finding> {
    let frames = outcome.frames;
    let share = |n: u64| n as f64 / frames.max(1) as f64;
    let told = outcome.reasons().into_iter().filter(|(reason, n)| match reason {
        // A find waits a frame for the next one.
        Reason::Unconfirmed => share(*n) > 1.0 - FOLLOWED && frames > 2,
        _ => share(*n) >= NOTED || *n == frames,
    });
    told.map(|(reason, n)| {
        let says = format!("in {n} of {frames} frames {}", reason.says());
        let is_explained = has_cause
            && matches!(reason, Reason::NoPoseFits | Reason::Covered | Reason::NotRecognised | Reason::Uncertain | Reason::LensMoved);
        let says = if is_explained { says } else { format!("{says}: {}", mend(reason, setup)) };
        match share(n) {
            _ if is_explained => Finding::note(says),
            s if s > 1.0 - FOLLOWED => Finding::fault(says),
            s if s >= TOLD => Finding::warning(says),
            _ => Finding::note(says),
        }
    })
    .collect()
}

/// What to do about a reason. Corners that were read off a photograph are likelier a pixel off than a lens is moved, and look the same.
fn mend(reason: Reason, setup: &TrackerSetup) -> String {
    let photograph = setup.stage.surfaces.iter().find(|surface| matches!(surface.kind, ReferenceKind::Photograph { .. }));
    match (reason, photograph) {
        (Reason::LensMoved, Some(surface)) => format!(
            "its corners may be off by a pixel or two, which looks the same: read corners_px of {} again, to half a pixel, in the enlarged \
             photograph; only where they are right, {}",
            surface.name,
            reason.mend()
        ),
        _ => reason.mend().to_owned(),
    }
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
    use super::*;

    #[test]
    fn a_rate_that_nobody_gave_is_told() {
        assert!(of_rate(Path::new("walk.mjpeg"), None).is_some());
        assert!(of_rate(Path::new("walk.mjpeg"), Some(25.0)).is_none());
        assert!(of_rate(Path::new("walk.y4m"), None).is_none());
    }
}
