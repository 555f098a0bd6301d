//! `stagepose compare`: relates the points of two pictures and finds how the camera moved between
//! them (contract C10).

mod choice;
mod json;
mod pictures;
mod text;

use std::cell::Cell;
use std::path::PathBuf;

use clap::Args;

use super::calibrate::write_whole;
use super::failure::Failure;
use super::interrupt;
use super::output_file::print;
use super::replay::progress::Progress;
use super::spared::Spared;
use crate::compare::{CompareOptions, Step, compare, report};
use crate::features::two_views::Share;
use crate::printable::printable_lines;
use crate::utc;
pub(super) use choice::FeatureArguments;
pub(super) use pictures::read_picture;

/// Compare two pictures: relate their points, and find how the camera moved.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:\n  stagepose compare before.png after.png --camera camera.toml --report compare.html\n  stagepose \
                        compare backdrop.jpg photo.jpg --detector asift --json relation.json\n\nExample:\n  stagepose compare a.png \
                        b.png\n\nWithout --camera the result is a fundamental matrix and a homography between the pixels. With it, it \
                        also has the essential matrix and the camera's motion; two pictures do not determine its length, which \
                        --baseline-m gives.")]
pub(super) struct CompareArguments {
    /// The first picture
    a: PathBuf,
    /// The second picture
    b: PathBuf,
    /// Calibration of the camera that took A, and also B unless --camera-b is given
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Calibration of the camera that took B
    #[arg(long, value_name = "FILE", requires = "camera")]
    camera_b: Option<PathBuf>,
    #[command(flatten)]
    features: FeatureArguments,
    /// Maximum distance of an inlier match from its epipolar line, pixels; the homography's noise
    /// is estimated, up to 2.5 times this
    #[arg(long, value_name = "PX", default_value_t = CompareOptions::default().threshold_px)]
    threshold_px: f64,
    /// How far the camera moved, metres: sets the length of the translation
    #[arg(long, value_name = "M", requires = "camera")]
    baseline_m: Option<f64>,
    /// Seed of the random samples: the same seed gives the same result
    #[arg(long, value_name = "N", default_value_t = CompareOptions::default().seed)]
    seed: u64,
    /// Write everything as JSON
    #[arg(long, value_name = "OUT.json")]
    json: Option<PathBuf>,
    /// Write a report with figures, one HTML file
    #[arg(long, value_name = "OUT.html")]
    report: Option<PathBuf>,
}

/// Progress units per step: finer than the bar's columns. Raised, nothing visible changes.
const PARTS: u64 = 100;

/// Runs the command. Unrelated pictures are a success: the answer is that there is no relation.
///
/// # Errors
/// Bad usage, a picture or calibration that is unreadable or does not fit, an output that cannot be
/// written, an interrupt.
pub(super) fn run(arguments: &CompareArguments) -> Result<(), Failure> {
    let options = options_of(arguments)?;
    refuse_unwritable(arguments)?;
    let [a, b] = pictures::views(arguments)?;
    interrupt::watch();
    let progress = Progress::with(Some(PARTS * Step::ALL.len() as u64), ["{bar:32} {msg}", "{spinner} {msg}"]);
    let made = compare(&a.view(), &b.view(), &options, &going_on(&progress));
    progress.finish();
    let Some(made) = made else {
        return Err(Failure::Comparison("interrupted; nothing is written".to_owned()));
    };
    print(printable_lines(&text::text(&made, &a, &b, arguments)).as_bytes())?;
    if let Some(file) = &arguments.json {
        write_whole(file, json::text(&made))?;
    }
    if let Some(file) = &arguments.report {
        let names = [&arguments.a, &arguments.b].map(|path| path.display().to_string());
        write_whole(file, report::html(&made, [&a.picture, &b.picture], [&names[0], &names[1]], &utc::report_date()))?;
    }
    Ok(())
}

/// Returns a callback that shows the progress and returns false after Ctrl-C.
fn going_on(progress: &Progress) -> impl Fn(Step, Share) -> bool {
    let shown = Cell::new(None);
    move |step, share| {
        // It is called at every keypoint; usually there is nothing new to show.
        if shown.replace(Some((step, share))) != Some((step, share)) {
            let before = Step::ALL.iter().position(|s| *s == step).unwrap_or(0) as u64;
            let parts = if share.of > 1 { format!(", view {} of {}", share.done + 1, share.of) } else { String::new() };
            let done = PARTS * before + PARTS * share.done as u64 / share.of.max(1) as u64;
            progress.at(done, format!("{}{parts}", step.words()));
        }
        !interrupt::is_interrupted()
    }
}

fn options_of(arguments: &CompareArguments) -> Result<CompareOptions, Failure> {
    let positive = |flag: &str, value: f64| {
        let sentence = || Failure::Usage(format!("--{flag} is {value}; give a number above 0"));
        if value.is_finite() && value > 0.0 { Ok(value) } else { Err(sentence()) }
    };
    Ok(CompareOptions {
        features: arguments.features.settings()?,
        matching: arguments.features.matching()?,
        threshold_px: positive("threshold-px", arguments.threshold_px)?,
        baseline_m: arguments.baseline_m.map(|m| positive("baseline-m", m)).transpose()?,
        seed: arguments.seed,
    })
}

/// Checks before the work, not after it, that the outputs' folders exist and that no output
/// overwrites an input.
fn refuse_unwritable(arguments: &CompareArguments) -> Result<(), Failure> {
    let mut spared = Spared::default()
        .with_files([&arguments.a, &arguments.b], "one of the pictures")
        .with_files(arguments.camera.iter().chain(&arguments.camera_b), "a calibration");
    spared.claim_whole_files(&[("--json", &arguments.json), ("--report", &arguments.report)])
}
