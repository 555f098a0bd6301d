//! `freeze`: measures where a camera stands, for a config in which it does not move.

use std::path::PathBuf;

use super::clip_rows::{self, RowCount};
use super::failure::Failure;
use super::interrupt;
use super::learnt::LearntArguments;
use super::logging::{self, LogArguments};
use super::output_file::print;
use super::replay::progress::Progress;
use super::replay::{frames_per_second, tracker_setup};
use crate::config::Settings;
use crate::daemon::track_entry;
use crate::mount::{StandingRow, View, standing};
use crate::record::PoseSample;
use crate::tracker::{Tracker, TrackerSetup};

/// Measure where a fixed camera stands, and print the lines for its config.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose freeze clip --config stage.toml >> fixed.toml\n\n\
    Film the stage for a few seconds from where the camera will stand, without touching it. With the printed [camera.pose] the camera's \
    pose is taken as known: objects are tracked with no surface of the stage in view, and where the stage is seen, it is only checked \
    that the camera was not moved.")]
pub(super) struct FreezeArguments {
    /// The clip
    clip: PathBuf,
    /// The config of the camera and the stage
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Frames per second of a clip without stamps
    #[arg(long, value_name = "N", value_parser = frames_per_second)]
    fps: Option<f64>,
    #[command(flatten)]
    learnt: LearntArguments,
    #[command(flatten)]
    log: LogArguments,
}

pub(super) fn run(arguments: &FreezeArguments) -> Result<(), Failure> {
    let settings = Settings::load(&arguments.config)?;
    logging::start(&arguments.log, settings.log);
    settings.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    interrupt::watch();
    let mut source = clip_rows::open(&settings, &arguments.clip, arguments.fps)?;
    let (learnt, _) = arguments.learnt.of(&arguments.clip)?;
    // What the config says of the pose is what is measured anew.
    let setup = TrackerSetup { learnt, fixed: None, ..tracker_setup(&settings, source.size(), None)? };
    let progress = Progress::start(source.rows());
    let (mut tracker, mut rows, mut measured) = (Tracker::new(setup)?, RowCount::default(), Vec::new());
    while let Some(row) = source.next_entry() {
        rows.add(&row)?;
        measured.extend(standing_row(&track_entry(&mut tracker, &row)));
        progress.advance();
    }
    progress.finish();
    rows.finish(&arguments.clip)?;
    let view = standing(&measured).map_err(|why| Failure::Standing(format!("{}: {why}", arguments.clip.display())))?;
    print(lines(&view).as_bytes())
}

fn standing_row(sample: &PoseSample) -> Option<StandingRow> {
    let m = sample.measurement.as_ref()?;
    Some(StandingRow { view: View { pose: m.pose, covariance: m.covariance }, common: m.common })
}

/// Returns the section for the config.
fn lines(view: &View) -> String {
    let sigma = |at: usize| view.covariance.fixed_view::<3, 3>(at, at).trace().sqrt();
    let numbers = |numbers: &[f64]| numbers.iter().map(|v| format!("{v:e}")).collect::<Vec<_>>().join(", ");
    let rows: Vec<String> = (0..6).map(|row| format!("    {},", numbers(view.covariance.row(row).transpose().as_slice()))).collect();
    format!(
        "# Measured by `stagepose freeze`: known to {:.2} mm and {:.3} degrees.\n[camera.pose]\nposition_m = {:?}\norientation_xyzw = \
         {:?}\ncovariance = [\n{}\n]\n",
        sigma(0) * 1e3,
        sigma(3).to_degrees(),
        <[f64; 3]>::from(view.pose.translation),
        view.pose.orientation_xyzw(),
        rows.join("\n")
    )
}
