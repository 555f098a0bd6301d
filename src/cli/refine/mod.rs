//! `refine`: tracks a recorded clip in both directions of time, and writes poses that use the
//! frames before and after each one.

mod backward;

use std::path::{Path, PathBuf};

use nalgebra::Matrix6;

use super::clip_rows::{self, RowCount};
use super::failure::Failure;
use super::interrupt;
use super::learnt::LearntArguments;
use super::logging::{self, LogArguments};
use super::output_file::{STDOUT, print};
use super::replay::progress::Progress;
use super::replay::records::Output;
use super::replay::{frames_per_second, tracker_setup};
use super::spared::Spared;
use crate::capture::FrameSource;
use crate::config::Settings;
use crate::daemon::track_entry;
use crate::record::{PoseSample, State};
use crate::refine::{Measured, Refined, Row, refine};
use crate::tracker::{Tracker, TrackerSetup};

/// Track a recorded clip in both directions of time and write poses that use the frames before and
/// after each one.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose refine clip --config stage.toml --poses refined.jsonl\n\n\
    The records are those of replay with another `pose` and `covariance`; `measured` stays what the frame alone shows. Rows in which \
    nothing was seen for up to half a second are bridged and marked `coasting`, with a covariance. Only noise averages out: what all \
    frames share (the lens, the layout of the stage) stays.\n\
    CLIP is read twice, so it cannot be `-`.")]
pub(super) struct RefineArguments {
    /// The clip
    clip: PathBuf,
    /// The config of the camera and the stage
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Where to write one JSON record per frame
    #[arg(long, value_name = "OUT.jsonl")]
    poses: PathBuf,
    /// Frames per second of a clip without stamps
    #[arg(long, value_name = "N", value_parser = frames_per_second)]
    fps: Option<f64>,
    #[command(flatten)]
    learnt: LearntArguments,
    #[command(flatten)]
    log: LogArguments,
}

pub(super) fn run(arguments: &RefineArguments) -> Result<(), Failure> {
    if arguments.clip == Path::new(STDOUT) {
        return Err(Failure::Usage("refine reads the clip twice, so it cannot come from `-`; save it to a file first".to_owned()));
    }
    let settings = Settings::load(&arguments.config)?;
    logging::start(&arguments.log, settings.log);
    settings.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    interrupt::watch();
    let mut spared = Spared::default().with_files(&settings.files, "a file of the config").with_clip(&arguments.clip);
    let poses = spared.open("--poses", Some(&arguments.poses))?;
    let source = clip_rows::open(&settings, &arguments.clip, arguments.fps)?;
    let (learnt, _) = arguments.learnt.of(&arguments.clip)?;
    let setup = TrackerSetup { learnt, ..tracker_setup(&settings, source.size(), None)? };
    let is_fixed = setup.fixed.is_some();
    let mut samples = forward(source, setup.clone(), &arguments.clip)?;
    let tracked = count(&samples, State::Tracking);
    backward::find_missing(&mut samples, clip_rows::open_again(&settings, &arguments.clip, arguments.fps)?, setup)?;
    let found = count(&samples, State::Tracking) - tracked;
    let covariances = refine_all(&mut samples, is_fixed);
    if let Some(poses) = poses {
        let mut output = Output::begin(poses)?;
        for (sample, covariance) in samples.iter().zip(&covariances) {
            output.write_line(&sample.to_refined_line(covariance.as_ref()))?;
        }
        output.flush()?;
    }
    let bridged = covariances.iter().zip(&samples).filter(|(covariance, sample)| covariance.is_some() && sample.measurement.is_none());
    let lines = [("frames", samples.len()), ("tracked", tracked), ("found backward", found), ("bridged", bridged.count())];
    let table: String = lines.map(|(name, count)| format!("{name:<16}{count}\n")).concat();
    if arguments.poses == Path::new(STDOUT) {
        eprint!("{table}");
        return Ok(());
    }
    print(table.as_bytes())
}

fn count(samples: &[PoseSample], state: State) -> usize {
    samples.iter().filter(|sample| sample.state == state).count()
}

/// Tracks every row as `replay` does.
fn forward(mut source: Box<dyn FrameSource>, setup: TrackerSetup, clip: &Path) -> Result<Vec<PoseSample>, Failure> {
    let progress = Progress::start(source.rows());
    let (mut tracker, mut rows, mut samples) = (Tracker::new(setup)?, RowCount::default(), Vec::new());
    while let Some(row) = source.next_entry() {
        rows.add(&row)?;
        samples.push(track_entry(&mut tracker, &row));
        progress.advance();
    }
    progress.finish();
    rows.finish(clip)?;
    Ok(samples)
}

/// Refines the poses of the camera, unless it is fixed, and of every object. Returns the covariance
/// of each camera pose.
fn refine_all(samples: &mut [PoseSample], is_fixed: bool) -> Vec<Option<Matrix6<f64>>> {
    let rows = |measured: &dyn Fn(&PoseSample) -> Option<Measured>| -> Vec<Row> {
        samples.iter().map(|sample| Row { timestamp: sample.timestamp, measured: measured(sample) }).collect()
    };
    let camera = rows(&|sample| {
        let m = sample.measurement.as_ref().filter(|_| !is_fixed)?;
        Some(Measured { pose: m.pose.renamed(), noise: m.covariance - m.common, common: m.common })
    });
    let objects = samples.first().map_or(0, |sample| sample.objects.len());
    let of_object = |k: usize| {
        rows(&|sample| {
            let object = sample.objects.get(k).filter(|object| object.state == State::Tracking)?;
            let (pose, covariance, common) = (object.pose?, object.covariance?, object.common?);
            Some(Measured { pose: pose.renamed(), noise: covariance - common, common })
        })
    };
    let refined_objects: Vec<Vec<Option<Refined>>> = (0..objects).map(|k| refine(&of_object(k))).collect();
    let mut covariances = Vec::with_capacity(samples.len());
    for (k, (sample, refined)) in samples.iter_mut().zip(refine(&camera)).enumerate() {
        if is_fixed {
            covariances.push(sample.measurement.as_ref().map(|m| m.covariance));
        } else {
            covariances.push(refined.map(|refined| refined.covariance));
            (sample.state, sample.pose) = (state_of(sample.state, refined.as_ref()), refined.map(|refined| refined.pose.renamed()));
        }
        for (object, refined) in sample.objects.iter_mut().zip(&refined_objects) {
            let refined = refined[k];
            object.state = state_of(object.state, refined.as_ref());
            (object.pose, object.covariance) = (refined.map(|r| r.pose.renamed()), refined.map(|r| r.covariance));
        }
    }
    covariances
}

/// Returns the state of a row: what is bridged is coasting, and what was predicted is lost where
/// nothing bridges it.
fn state_of(was: State, refined: Option<&Refined>) -> State {
    match refined {
        Some(refined) if refined.is_bridged => State::Coasting,
        Some(_) => State::Tracking,
        None if was == State::Coasting => State::Lost,
        None => was,
    }
}
