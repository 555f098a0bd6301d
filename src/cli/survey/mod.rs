//! `stagepose survey`: measures the stage as it hangs and the actual lens, from clips of walking
//! around (contract C11).

mod folder;
mod json;
mod report;
mod text;

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::calibrate::write_whole;
use super::failure::Failure;
use super::interrupt;
use super::learnt::LearntArguments;
use super::logging::{self, LogArguments};
use super::made_folder::SURVEYED;
use super::output_file::print;
use super::spared::Spared;
use super::walk::{Clips, WalkReader, frames, goes_on, unfinished};
use super::walk_file::WalkFile;
use crate::config::Settings;
use crate::printable::printable_lines;
use crate::survey::walked::judgement::Verdict;
use crate::survey::walked::stage::{SurveyOptions, survey};
use crate::survey::walked::walk::WalkOptions;
use crate::utc;

/// Measure the stage as it hangs and the actual lens, from clips of walking around.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  stagepose survey walk --config stage.toml --output surveyed\n\n\
    Walk for half a minute: past the stage from one side to the other and back, nearer and farther, the camera a little higher and lower, so that every part is seen \
    from two sides. People may be in the way now and then. Where the verdict is \"do not use\", nothing is written and the exit code is 1.")]
pub(super) struct SurveyArguments {
    /// Clips of walking around the stage
    #[arg(required = true)]
    clips: Vec<PathBuf>,
    /// The config of the camera and the stage
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// The folder for the surveyed stage: its stage.toml, camera.toml, shapes and pictures
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
    /// Whether to `keep` the lens and the shutter as they are, or to `refine` them too
    #[arg(long, value_enum, default_value_t = Lens::Keep)]
    lens: Lens,
    /// Write everything as JSON
    #[arg(long, value_name = "OUT.json")]
    json: Option<PathBuf>,
    /// Write a report with figures, one HTML file
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Frames per second of clips without stamps
    #[arg(long, value_name = "N", value_parser = super::replay::frames_per_second)]
    fps: Option<f64>,
    #[command(flatten)]
    learnt: LearntArguments,
    #[command(flatten)]
    log: LogArguments,
}

/// What to do with the lens and the shutter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Lens {
    /// Keep them as they are
    Keep,
    /// Estimate them too
    Refine,
}

/// Runs the command.
///
/// # Errors
/// Bad usage, an unreadable config or clip, a walk that determines no stage, the verdict "do not
/// use", an output that cannot be written.
pub(super) fn run(arguments: &SurveyArguments) -> Result<(), Failure> {
    let settings = Settings::load(&arguments.config)?;
    logging::start_for_trials(&arguments.log, settings.log);
    let mut spared = arguments.clips.iter().fold(Spared::default(), |spared, clip| spared.with_clip(clip));
    spared.claim_whole_files(&[("--json", &arguments.json), ("--report", &arguments.report)])?;
    SURVEYED.refuse_unusable(&arguments.output)?;
    interrupt::watch();
    if settings.stage.has_map() {
        return Err(Failure::Usage(
            "the config's stage has a map, which is surveyed already; map the set again (`stagepose map`)".to_owned(),
        ));
    }
    let clips = Clips::new(&arguments.clips, arguments.fps, &settings);
    let sources = clips.open()?;
    let size = clips.size(&sources)?;
    let setup = clips.setup(&settings, size, &arguments.learnt)?;
    let options =
        SurveyOptions { refines_lens: arguments.lens == Lens::Refine, constraints: settings.measured.clone(), ..SurveyOptions::default() };
    let file = WalkFile::new(&arguments.output, &arguments.clips, &setup, &format!("{:?} {:?}", arguments.lens, arguments.fps));
    let reader = WalkReader::new(&setup, &sources);
    let walk = reader.walk(&file, sources, || clips.open(), &WalkOptions { lively: options.refines_lens, ..WalkOptions::default() })?;
    // Clips that could be read twice can be read once more; otherwise the survey continues with
    // what it has.
    let again = || clips.open().unwrap_or_default().into_iter().map(frames);
    let made = walk.and_then(|walk| survey(walk, again, &setup, options, |step| reader.show(step), &goes_on));
    reader.progress.finish();
    let made = made.map_err(|e| unfinished(&e, &file))?;
    file.remove();
    let judgement = made.judge();
    print(printable_lines(&text::text(&made, &judgement)).as_bytes())?;
    if let Some(file) = &arguments.json {
        write_whole(file, json::text(&made, &judgement))?;
    }
    if let Some(file) = &arguments.report {
        write_whole(file, report::html(&made, &judgement, &utc::report_date()))?;
    }
    if judgement.verdict == Verdict::DoNotUse {
        return Err(Failure::Survey(format!("{}; nothing is written to {}", judgement.sentence(), arguments.output.display())));
    }
    let files = folder::files(&settings, &made).map_err(Failure::output(&arguments.output))?;
    SURVEYED.write(&arguments.output, files)
}
