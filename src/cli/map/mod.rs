//! `stagepose map`: maps a set without pictures, from clips of walking around it (contract C13).

mod json;
mod report;
mod text;

use std::io::{self, Cursor};
use std::path::{Path, PathBuf};

use clap::Args;
use image::ImageFormat;

use super::calibrate::write_whole;
use super::failure::Failure;
use super::interrupt;
use super::learnt::LearntArguments;
use super::logging::{self, LogArguments};
use super::made_folder::MAPPED;
use super::output_file::print;
use super::spared::Spared;
use super::walk::{Clips, WalkReader, goes_on, unfinished};
use super::walk_file::WalkFile;
use crate::camera::{Calibration, CalibrationForm};
use crate::config::{LensSource, Settings};
use crate::printable::printable_lines;
use crate::survey::named_points::Click;
use crate::survey::walked::judgement::Verdict;
use crate::survey::walked::mapping::error::{MapError, MapStep};
use crate::survey::walked::mapping::map::map;
use crate::survey::walked::walk::{Walk, WalkOptions};
use crate::utc;

/// Map a set without pictures, from clips of walking around it.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  stagepose map walk --config stage.toml --output mapped\n\n\
    Put a printed poster (`stagepose poster`) or known artwork into the set: the config's [[stage.surface]], which gives the map its frame and scale. Walk for a \
    minute: from one side of the set to the other and back, nearer and farther, higher and lower, with the poster in view most of the time. Afterwards the poster can go. \
    Where the verdict is \"do not use\", nothing is written and the exit code is 1.")]
pub(super) struct MapArguments {
    /// Clips of walking around the set
    #[arg(required = true)]
    clips: Vec<PathBuf>,
    /// The config of the calibrated camera, and of what gives frame and scale: surfaces, named
    /// points
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// The folder for the mapped stage: its stage.toml, stage.map and camera.toml
    #[arg(long, short, value_name = "DIR", required_unless_present = "keyframes")]
    output: Option<PathBuf>,
    /// Write the frames that may become keyframes as pictures, CLIP-ROW.png, to click points in;
    /// without --output nothing else is done
    #[arg(long, value_name = "DIR")]
    keyframes: Option<PathBuf>,
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

/// Runs the command.
///
/// # Errors
/// Bad usage, an unreadable config or clip, a walk that yields no map, the verdict "do not use", an
/// output that cannot be written.
pub(super) fn run(arguments: &MapArguments) -> Result<(), Failure> {
    let settings = Settings::load_camera(&arguments.config)?;
    logging::start_for_trials(&arguments.log, settings.log);
    refuse_unfit(&settings)?;
    let mut spared = arguments.clips.iter().fold(Spared::default(), |spared, clip| spared.with_clip(clip));
    spared.claim_whole_files(&[("--json", &arguments.json), ("--report", &arguments.report)])?;
    arguments.keyframes.iter().try_for_each(|folder| spared.claim_folder("--keyframes", folder))?;
    arguments.output.iter().try_for_each(|folder| MAPPED.refuse_unusable(folder))?;
    interrupt::watch();
    let clips = Clips::new(&arguments.clips, arguments.fps, &settings);
    let sources = clips.open()?;
    let size = clips.size(&sources)?;
    let setup = clips.setup(&settings, size, &arguments.learnt)?;
    let options = WalkOptions { lively: false, unseen: true, named: clicked_frames(&settings, &clips)? };
    let beside = arguments
        .output
        .as_ref()
        .or(arguments.keyframes.as_ref())
        .ok_or_else(|| Failure::Usage("name a folder with --output".to_owned()))?;
    let file = WalkFile::new(beside, &arguments.clips, &setup, &format!("map {:?} {:?}", arguments.fps, options.named));
    let reader = WalkReader::new(&setup, &sources);
    let walk = reader.walk(&file, sources, || clips.open(), &options)?;
    if let (Some(folder), Ok(walk)) = (&arguments.keyframes, &walk) {
        write_pictures(walk, &clips, folder)?;
    }
    let Some(output) = &arguments.output else {
        reader.progress.finish();
        file.remove();
        return walk.map(|_| ()).map_err(|e| unfinished(&e, &file));
    };
    let show = |step: MapStep| match step {
        MapStep::Points => reader.show_words("recognising points".to_owned()),
        MapStep::Facets => reader.show_words("finding facets".to_owned()),
        MapStep::Textures(round) => reader.show_words(format!("painting facets, round {}", round + 1)),
        MapStep::HoldOut => reader.show_words("holding keyframes out".to_owned()),
        MapStep::Survey(step) => reader.show(step),
    };
    let made = walk.map_err(MapError::from).and_then(|walk| map(walk, &setup, &settings.named_points, show, &goes_on));
    reader.progress.finish();
    let made = made.map_err(|e| match e {
        MapError::Survey(e) => unfinished(&e, &file),
        e => Failure::Survey(e.to_string()),
    })?;
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
        return Err(Failure::Survey(format!("{}; nothing is written to {}", judgement.sentence(), output.display())));
    }
    let calibration = Calibration {
        model: made.survey.camera,
        uncertainty: made.survey.camera.doubt().map(|doubt| doubt.uncertainty),
        rms_px: None,
        images: None,
        date: Some(utc::date(utc::now_s())),
        form: CalibrationForm::Stagepose,
        notes: Vec::new(),
    };
    let files = settings.source.mapped(calibration.to_toml(), made.map.to_bytes()).map_err(|e| Failure::Usage(e.to_string()))?;
    MAPPED.write(output, files)
}

/// Writes the pictures that may become keyframes, named by clip and row as `seen` wants them.
fn write_pictures(walk: &Walk, clips: &Clips<'_>, folder: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(folder).map_err(Failure::output(folder))?;
    for (clip, frame) in walk.pictures() {
        let file = folder.join(format!("{}-{:06}.png", clips.name(clip), frame.sequence));
        let mut png = Cursor::new(Vec::new());
        frame.image.write_to(&mut png, ImageFormat::Png).map_err(io::Error::other).map_err(Failure::output(&file))?;
        write_whole(&file, png.get_ref())?;
    }
    Ok(())
}

/// Returns the frames in which points were clicked: the clip by its index, and the row in it.
fn clicked_frames(settings: &Settings, clips: &Clips<'_>) -> Result<Vec<(usize, u64)>, Failure> {
    let frame = |(point, click): (usize, &Click)| {
        let clip = clips.named(&click.clip).ok_or_else(|| {
            let entry = &settings.named_points.points[point].entry;
            let (file, clip) = (settings.file.display(), &click.clip);
            Failure::Usage(format!("{file}: {entry} was clicked in the clip `{clip}`, but not exactly one of the clips has that name"))
        })?;
        Ok((clip, click.sequence))
    };
    settings.named_points.clicks().map(frame).collect()
}

/// Refuses configs from which no map can be made.
fn refuse_unfit(settings: &Settings) -> Result<(), Failure> {
    if matches!(settings.lens, LensSource::Guess(..)) {
        return Err(Failure::Usage(format!(
            "{}: the camera has no calibration, and a map is only as good as its lens; calibrate it (`stagepose calibrate`) and name the \
             file as `calibration`",
            settings.file.display()
        )));
    }
    if settings.stage.has_map() {
        return Err(Failure::Usage(format!(
            "{}: its stage has a map already; map from the config with the poster",
            settings.file.display()
        )));
    }
    Ok(())
}
