//! Examines a check's clip: tracks it as `replay` would, counts the frames, and diagnoses what they
//! show.

use std::path::Path;

use super::pass::{FOLLOWED, MIN_DOUBT, NOTED, Pass, WARNING_SHARE, WELL_FOLLOWED};
use super::readout::Readout;
use crate::cli::failure::Failure;
use crate::cli::outcome::Outcome;
use crate::config::{LensSource, Settings};
use crate::diagnose::{Finding, Grade, Shown, Travel, corners_begun_at_top_left, of_clip, of_shutter};
use crate::track::{LearntCamera, ModelNews, ModelReport, Part, Reason, ReferenceKind};
use crate::tracker::TrackerSetup;

/// What became of a clip's frames.
pub(super) struct FrameCounts {
    /// All frames that were read.
    pub all: u64,
    /// Those in which the stage's picture was found.
    pub found: u64,
    /// Those in which it was found or followed.
    pub followed: u64,
    /// Those with a pose.
    pub given: u64,
}

/// What a clip showed.
pub(super) struct Examined {
    /// Width and height of its frames, pixels.
    pub size: (u32, u32),
    /// A description of the clip.
    pub line: String,
    /// How many frames were recognised, tracked and reported, in words.
    pub counts: String,
    /// The same, and the residual.
    pub frames: FrameCounts,
    /// The findings, worst first.
    pub findings: Vec<Finding>,
    /// Share of the frames in which the stage is followed.
    pub followed: f64,
    /// Whether the poses' residuals are too small to mention.
    pub is_as_modelled: bool,
    /// What the clip says about the shutter, if that has been estimated already.
    pub shutter: Option<Vec<String>>,
}

/// Tracks a clip and diagnoses the frames that are not followed.
pub(super) fn examine(settings: &Settings, clip: &Path, fps: Option<f64>, learnt: LearntCamera) -> Result<Examined, Failure> {
    let as_configured = Pass::over(settings, settings.shutter, clip, fps, learnt)?;
    // Rolling-shutter displacements look like another lens, shape or layout. So try the readout
    // first, and blame the others only if it does not help.
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
        frames: FrameCounts { all: outcome.frames, found: outcome.recognised(), followed: outcome.followed(), given: outcome.tracked },
        findings,
        followed: as_configured.followed(),
        is_as_modelled: as_configured.is_as_modelled(),
        shutter,
    })
}

/// Returns what a pass over the clip says about the stage, the lens and the camera's motion.
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
    // A named lens or layout fault also explains why no pose fits.
    let has_cause = findings.iter().any(|f| f.grade == Grade::Fault || (is_small && f.grade == Grade::Doubt));
    // Blame the lens last.
    let has_doubt = findings.iter().any(|f| matches!(f.grade, Grade::Fault | Grade::Doubt));
    if !outcome.awaits_a_second_frame() {
        findings.extend(of_reasons(outcome, [has_cause, has_doubt], setup));
    }
    // A graver finding already explains it.
    if outcome.tracked == 0 && outcome.frames > 0 && !findings.iter().any(|f| matches!(f.grade, Grade::Fault | Grade::Doubt)) {
        findings.push(of_no_pose(outcome.frames));
    }
    findings.extend(setup.objects.iter().zip(objects).filter_map(|(object, tracked)| of_object(&object.name, *tracked, outcome.tracked)));
    findings.extend(travel.findings(&settings.stage));
    findings.extend(of_roll(travel, setup));
    findings
}

/// Returns the warning for a clip without any pose, however short: it confirms nothing.
fn of_no_pose(frames: u64) -> Finding {
    Finding::warning(match frames {
        1 => "the clip is one picture, and no later frame confirms its pose: check a clip of two seconds or more".to_owned(),
        n => format!("none of the clip's {n} frames has a pose: check a clip of two seconds or more that shows the stage"),
    })
}

/// Minimum number of different views for saying that no part of the model explains the residuals.
/// Fewer show much the same however many frames there are, and some residuals of a single frame
/// never fit any part. Chosen, not tuned. Raised, only long walks are judged.
const MIN_VIEWS: usize = 4;

/// Names the part of the stage or lens that is not as configured, from the poses' residuals.
/// Returns nothing if there is a graver finding.
fn of_model(model: &ModelReport, findings: &[Finding]) -> Vec<Finding> {
    if findings.iter().any(|f| matches!(f.grade, Grade::Fault | Grade::Doubt)) {
        return Vec::new();
    }
    let ModelReport { parts, left_px, doubt_mm, doubt_share, views } = model;
    if parts.is_empty() && *doubt_share >= MIN_DOUBT {
        let seen = format!("the stage appears {left_px:.2} px (rms) from where its poses put it, so they may be {doubt_mm:.1} mm off");
        let walk = "film it while walking past, from both sides, near and far; check that clip, or survey the stage with it";
        return vec![match *views >= MIN_VIEWS {
            true => Finding::warning(format!(
                "{seen}, and no constant error of the stage or lens explains that; moving cloth would: keep draughts off it or weigh it \
                 down. If nothing moves: {walk}"
            )),
            false => Finding::note(format!("{seen}; the clip's views are too alike to tell why: {walk}")),
        }];
    }
    let grade = |news: &ModelNews| match news.part {
        // Hanging cloth has folds. It is tracked, but less accurately than it could be.
        Part::Shape { .. } => Finding::warning(news.text()),
        _ => Finding::doubt(news.text()),
    };
    parts.iter().map(grade).collect()
}

/// Returns the reasons for frames that were not tracked. If a fault already explains why no pose
/// fits, its fix is stated there only.
fn of_reasons(outcome: &Outcome, [has_cause, has_doubt]: [bool; 2], setup: &TrackerSetup) -> Vec<Finding> {
    let frames = outcome.frames;
    let share = |n: u64| n as f64 / frames.max(1) as f64;
    let reported = outcome.reasons().into_iter().filter(|(reason, n)| match reason {
        // Each acquisition waits one frame for confirmation.
        Reason::Unconfirmed => share(*n) > 1.0 - FOLLOWED && frames > 2,
        _ => share(*n) >= NOTED || *n == frames,
    });
    reported
        .map(|(reason, n)| {
            let message = format!("in {n} of {frames} frames {}", reason.message());
            let is_explained = match reason {
                Reason::NoPoseFits | Reason::Covered | Reason::NotRecognised | Reason::Uncertain => has_cause,
                Reason::LensMoved => has_doubt,
                _ => false,
            };
            let message = if is_explained { message } else { format!("{message}: {}", hint(reason, setup)) };
            match share(n) {
                _ if is_explained => Finding::note(message),
                s if s > 1.0 - FOLLOWED => Finding::fault(message),
                s if s >= WARNING_SHARE => Finding::warning(message),
                _ => Finding::note(message),
            }
        })
        .collect()
}

/// Returns the fix for a reason. Corners read off a photograph are more likely a pixel off than the
/// lens moved, and look the same.
fn hint(reason: Reason, setup: &TrackerSetup) -> String {
    let photograph = setup.stage.surfaces.iter().find(|surface| matches!(surface.kind, ReferenceKind::Photograph { .. }));
    match (reason, photograph) {
        (Reason::LensMoved, Some(surface)) => format!(
            "its corners may be off by a pixel or two, which looks the same: read corners_px of {} again, to half a pixel, in the \
             enlarged photograph; only if they are right, {}",
            surface.name,
            reason.hint()
        ),
        _ => reason.hint().to_owned(),
    }
}

/// Returns how often an object was tracked among the frames in which the stage was.
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

/// Notes a rolled camera. A camera that hangs upside down tracks well; so does one whose reference
/// picture was given upside down.
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
        "according to its poses the camera is {turned} (rolled by {roll:.0} degrees): that is right if it is mounted so, and nothing \
         needs fixing; otherwise {name} is {turned}: turn the picture's file, or begin corners_px at the corner that is the top left one \
         on the stage{line}"
    )))
}

/// Warns if a clip has no stamps and no rate was given.
fn of_rate(clip: &Path, fps: Option<f64>) -> Option<Finding> {
    let is_stream = clip.extension().is_some_and(|e| e.eq_ignore_ascii_case("mjpeg") || e.eq_ignore_ascii_case("mjpg"));
    let has_none = if clip.is_dir() { !clip.join("timestamps.csv").is_file() } else { is_stream };
    (has_none && fps.is_none()).then(|| {
        Finding::warning(
            "the clip has no stamps, so 30 frames a second are assumed: give its rate with --fps, to check and to replay, or speeds, blur \
             and shutter will be wrong",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_assumed_frame_rate_is_reported() {
        assert!(of_rate(Path::new("walk.mjpeg"), None).is_some());
        assert!(of_rate(Path::new("walk.mjpeg"), Some(25.0)).is_none());
        assert!(of_rate(Path::new("walk.y4m"), None).is_none());
    }
}
