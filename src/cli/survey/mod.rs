//! `stagepose survey`: measures the stage as it hangs and the actual lens, from clips of walking
//! around (contract C11).

mod folder;
mod json;
mod report;
mod text;
mod walk_file;

use std::cell::Cell;
use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::calibrate::write_whole;
use super::failure::Failure;
use super::interrupt;
use super::learnt::LearntArguments;
use super::logging::{self, LogArguments};
use super::output_file::print;
use super::replay::progress::Progress;
use super::replay::tracker_setup;
use super::spared::Spared;
use crate::capture::{ClipOptions, EntryContent, FrameSource, open_clip};
use crate::config::Settings;
use crate::frame::Frame;
use crate::printable::printable_lines;
use crate::survey::walked::judgement::Verdict;
use crate::survey::walked::progress::{SurveyError, SurveyStep};
use crate::survey::walked::stage::{Survey, SurveyOptions, survey};
use crate::survey::walked::walk::Walk;
use crate::tracker::TrackerSetup;
use crate::utc;
use walk_file::WalkFile;

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
    folder::refuse_unusable(&arguments.output)?;
    interrupt::watch();
    let calibrated = settings.lens.size(&settings.camera);
    let open =
        |clip: &PathBuf| open_clip(clip, ClipOptions { fps: arguments.fps, calibrated, ..ClipOptions::default() }).map_err(Failure::from);
    let open_all = || arguments.clips.iter().map(open).collect::<Result<Vec<_>, _>>();
    let sources = open_all()?;
    for (clip, source) in arguments.clips.iter().zip(&sources) {
        source.notes().iter().for_each(|note| tracing::warn!("{}: {note}", clip.display()));
    }
    let size = sources[0].size();
    if let Some((clip, source)) = arguments.clips.iter().zip(&sources).find(|(_, source)| source.size() != size) {
        let (w, h) = source.size();
        return Err(Failure::Usage(format!(
            "{}: its frames have {w} x {h} pixels, those of the first clip {} x {}; survey one camera at a time",
            clip.display(),
            size.0,
            size.1
        )));
    }
    let mut setup = TrackerSetup { objects: Vec::new(), ..tracker_setup(&settings, size, None)? };
    let (learnt, _) = arguments.learnt.of(&arguments.clips[0])?;
    setup.shutter.readout_s = setup.shutter.readout_s.or(learnt.readout.map(|readout| readout.seconds));
    let total = sources.iter().map(|source| source.rows()).sum::<Option<u64>>();
    let options = SurveyOptions { refines_lens: arguments.lens == Lens::Refine, constraints: settings.measured.clone() };
    let file = WalkFile::new(&arguments.output, &arguments.clips, &setup, &format!("{:?} {:?}", arguments.lens, arguments.fps));
    let work = Work {
        setup: &setup,
        frames_read: Cell::new(0),
        progress: Progress::with(total, ["{bar:32} {pos}/{len} frames {msg}", "{spinner} {pos} frames {msg}"]),
    };
    let walk = match work.recalled(&file, sources) {
        Ok(None) => work.taken_in(&file, open_all()?, options.refines_lens),
        Ok(Some(walk)) => Ok(walk),
        Err(e) => Err(e),
    };
    // Clips that could be read twice can be read once more; otherwise the survey continues with
    // what it has.
    let made = walk.and_then(|walk| work.survey(walk, || open_all().unwrap_or_default(), options));
    work.progress.finish();
    let made = made.map_err(|e| match e {
        SurveyError::Interrupted if file.is_there() => {
            Failure::Survey(format!("{e}. The clips have been read: run the same command again to continue from there"))
        }
        e => Failure::Survey(e.to_string()),
    })?;
    file.remove();
    let judgement = made.judge();
    print(printable_lines(&text::text(&made, &judgement)).as_bytes())?;
    if let Some(file) = &arguments.json {
        write_whole(file, json::text(&made, &judgement))?;
    }
    if let Some(file) = &arguments.report {
        let date = utc::date_and_time(utc::now_s()).replace('T', " ").replace('Z', " UTC");
        write_whole(file, report::html(&made, &judgement, &date))?;
    }
    if judgement.verdict == Verdict::DoNotUse {
        return Err(Failure::Survey(format!("{}; nothing is written to {}", judgement.sentence(), arguments.output.display())));
    }
    folder::write(&arguments.output, &settings, &made)
}

/// A survey in progress.
struct Work<'a> {
    setup: &'a TrackerSetup,
    frames_read: Cell<u64>,
    progress: Progress,
}

impl Work<'_> {
    /// Returns the walk left by an interrupted run, with its clips' pictures.
    fn recalled(&self, file: &WalkFile, sources: Vec<Box<dyn FrameSource>>) -> Result<Option<Walk>, SurveyError> {
        let Some(record) = file.read() else { return Ok(None) };
        tracing::info!("an interrupted survey has already read the clips; continuing from there");
        let clips = sources.into_iter().map(frames);
        Walk::recall(&record, clips, &self.setup.stage, |step| self.show(step), &goes_on)
    }

    /// Reads the walk from the clips and stores it, so that an interrupted survey need not read
    /// them again.
    fn taken_in(&self, file: &WalkFile, sources: Vec<Box<dyn FrameSource>>, wants_lively: bool) -> Result<Walk, SurveyError> {
        // It is another command's, or does not fit its clips.
        file.remove();
        self.frames_read.set(0);
        let clips = sources.into_iter().map(frames);
        let walk = Walk::take_in(clips, self.setup, wants_lively, |step| self.show(step), &goes_on)?;
        file.keep(walk.record());
        Ok(walk)
    }

    fn survey(&self, walk: Walk, open: impl FnOnce() -> Vec<Box<dyn FrameSource>>, options: SurveyOptions) -> Result<Survey, SurveyError> {
        survey(walk, || open().into_iter().map(frames), self.setup, options, |step| self.show(step), &goes_on)
    }

    fn show(&self, step: SurveyStep) {
        match step {
            SurveyStep::Frame => {
                self.frames_read.set(self.frames_read.get() + 1);
                self.progress.advance();
            }
            SurveyStep::Again(number) => self.progress.at(self.frames_read.get(), format!("second pass, frame {number}")),
            SurveyStep::Round(round) => self.progress.at(self.frames_read.get(), format!("adjusting, round {}", round + 1)),
        }
    }
}

fn goes_on() -> bool {
    !interrupt::is_interrupted()
}

/// Returns a clip's readable frames.
fn frames(mut source: Box<dyn FrameSource>) -> impl Iterator<Item = Frame> {
    std::iter::from_fn(move || source.next_entry()).filter_map(|row| match row.content {
        EntryContent::Frame(frame) => Some(frame),
        _ => None,
    })
}
