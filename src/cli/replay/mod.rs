//! `replay`: reads a recorded clip and writes the camera's pose.

mod overlay_video;
mod overlays;
mod paced;
pub(in crate::cli) mod progress;
pub(in crate::cli) mod records;
mod summary;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError};

use super::clip_timecode::timecode_of_clip;
use super::failure::Failure;
use super::interrupt;
use super::learnt::LearntArguments;
use super::logging::{self, LogArguments};
use super::output_file::STDOUT;
use super::outputs::Outputs;
use super::spared::Spared;
use crate::capture::{ClipEntry, ClipOptions, EntryContent, FrameSource, open_clip, open_clip_in_colour};
use crate::config::Settings;
use crate::daemon::{Daemon, Delivery, kept_views, thread_clock};
use crate::publish::{ClipStart, Stamps};
use crate::record::PoseSample;
use crate::track::Reason;
use crate::tracker::{Tracker, TrackerSetup};
use overlays::Overlays;
use paced::Paced;
use progress::Progress;
use records::Records;
use summary::Tally;

/// Track a recorded clip and write the camera's pose in every frame.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose replay clip --config stage.toml --poses poses.jsonl --summary summary.json\n\n\
    CLIP is a folder with frames/ and timestamps.csv, a folder of pictures, a .y4m, .avi (MJPEG) or .mjpeg file, or - for y4m on stdin.\n\
    Without --poses, --parts, --tum or --summary only the table is printed. OUT may be - for stdout, once.")]
pub(super) struct ReplayArguments {
    /// The clip
    clip: PathBuf,
    /// The config of the camera and the stage
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Write one JSON record per frame
    #[arg(long, value_name = "OUT.jsonl")]
    poses: Option<PathBuf>,
    /// Write what each record's covariances are made of: noise, new in every frame, and errors that
    /// are the same in all frames (lens, layout)
    #[arg(long, value_name = "OUT.jsonl")]
    parts: Option<PathBuf>,
    /// Write the tracked frames as a TUM trajectory
    #[arg(long, value_name = "OUT.txt")]
    tum: Option<PathBuf>,
    /// Write counts and times as JSON
    #[arg(long, value_name = "OUT.json")]
    summary: Option<PathBuf>,
    /// Frames per second of a clip without stamps
    #[arg(long, value_name = "N", value_parser = frames_per_second)]
    fps: Option<f64>,
    /// Tracker workers; they do not change the result [default: the config's, else 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=64))]
    threads: Option<u64>,
    /// Play at the pace of the stamps instead of as fast as possible
    #[arg(long)]
    realtime: bool,
    /// Also send to the config's outputs and serve [http], at the pace of the stamps
    #[arg(long)]
    outputs: bool,
    /// Write every frame with the result drawn on it: the surfaces, the axes, how well the picture
    /// fits, the pose in metres and degrees, and why a frame is not tracked; as pictures in a
    /// folder, or as a video if the name ends in .mp4, .mov, .mkv, .webm or .avi (needs ffmpeg)
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
    #[command(flatten)]
    learnt: LearntArguments,
    #[command(flatten)]
    log: LogArguments,
}

pub(in crate::cli) fn frames_per_second(text: &str) -> Result<f64, String> {
    let fps: f64 = text.parse().map_err(|_| "give a number such as 29.97".to_owned())?;
    if fps > 0.0 && fps <= 100_000.0 { Ok(fps) } else { Err("give frames per second above 0".to_owned()) }
}

/// What the pose thread tells the writing thread about the rows.
#[derive(Default)]
struct RowTally {
    readable: u64,
    undecodable: u64,
    skipped: u64,
    first_reason: Option<String>,
    overlays: Option<Overlays>,
    overlay_failure: Option<Failure>,
}

pub(super) fn run(arguments: &ReplayArguments, started: Instant) -> Result<(), Failure> {
    let uses_stdout = arguments.one_stdout()?;
    let settings = Settings::load(&arguments.config)?;
    if arguments.outputs && settings.http.is_none() && !settings.outputs.iter().any(|output| output.enabled) {
        let file = arguments.config.display();
        return Err(Failure::Usage(format!("{file}: there is no [[output]] section to send to; omit --outputs")));
    }
    logging::start(&arguments.log, settings.log);
    settings.notes.iter().for_each(|note| tracing::info!("{note}"));
    settings.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    interrupt::watch();
    let calibrated = settings.lens.size(&settings.camera);
    let options = ClipOptions { fps: arguments.fps, calibrated, is_stopped: Some(interrupt::is_interrupted) };
    // Only overlays need colours.
    let opened =
        if arguments.overlay.is_some() { open_clip_in_colour(&arguments.clip, options) } else { open_clip(&arguments.clip, options) };
    let source = match opened {
        Err(_) if interrupt::is_interrupted() => return Err(Failure::Interrupted),
        opened => opened?,
    };
    source.notes().iter().for_each(|note| tracing::warn!("{note}"));
    let (learnt, learnt_from) = arguments.learnt.of(&arguments.clip)?;
    let setup = TrackerSetup { learnt, ..tracker_setup(&settings, source.size(), arguments.threads)? };
    let begun = ClipStart::default();
    let stamps = || Stamps::Recorded(begun.clone());
    // Open all before truncating the first: a wrong name then destroys nothing.
    let mut spared = arguments.spared(&settings);
    let (poses, tum) = (spared.open("--poses", arguments.poses.as_deref())?, spared.open("--tum", arguments.tum.as_deref())?);
    let parts = spared.open("--parts", arguments.parts.as_deref())?;
    let summary = spared.open("--summary", arguments.summary.as_deref())?;
    arguments.claim_others(&settings, &mut spared)?;
    arguments.overlay.as_deref().map_or(Ok(()), overlays::refuse_foreign)?;
    let start = || {
        let timecode = timecode_of_clip(settings.timecode.as_ref(), Some(&arguments.clip))?.map(Arc::new);
        Outputs::start(&settings, settings.http.as_ref(), setup.camera, stamps(), timecode, None, arguments.fps)
    };
    let outputs = arguments.outputs.then(start).transpose()?;
    let mut records = Records::begin(poses, tum, arguments.realtime)?.with_parts(parts)?;
    let mut summary = summary.map(records::Output::begin).transpose()?;
    let overlay = arguments.overlay.as_deref().map(|dir| (dir, setup.clone()));

    // Outputs get samples at the recorded pace.
    let source: Box<dyn FrameSource> = if arguments.realtime || arguments.outputs { Box::new(Paced::new(source, begun)) } else { source };
    let mut tally = Tally::new(started, settings.shutter, learnt_from);
    let mut tracker = Tracker::new(setup)?.with_filter(settings.filter);
    let overlays = overlay.map(|(dir, setup)| Overlays::create(dir, setup, tracker.watch_pixels())).transpose()?;
    let mut writing = Writing { records: &mut records, tally: &mut tally, outputs: outputs.as_ref() };
    let rows = track(source, tracker, overlays, &mut writing)?;
    if let Some(outputs) = outputs {
        outputs.close();
    }
    tally.set_rows(rows.undecodable, rows.skipped);
    if let Some(output) = &mut summary {
        output.write_all_and_flush(&tally.summary_json())?;
    }
    rows.failure(arguments, tally.frames())?;
    summary::print_table(&tally, uses_stdout)
}

/// The destinations of every sample.
struct Writing<'a> {
    records: &'a mut Records,
    tally: &'a mut Tally,
    outputs: Option<&'a Outputs>,
}

impl Writing<'_> {
    fn take(&mut self, sample: &PoseSample) -> Result<(), Failure> {
        // Outputs come first, as receivers wait for them.
        if let Some(outputs) = self.outputs {
            outputs.send(sample);
        }
        self.tally.add(sample);
        self.records.write(sample)
    }
}

/// Runs the daemon over the clip and writes the samples as they come.
fn track(
    source: Box<dyn FrameSource>,
    tracker: Tracker,
    overlays: Option<Overlays>,
    writing: &mut Writing<'_>,
) -> Result<RowTally, Failure> {
    let progress = Progress::start(source.rows());
    let rows = Arc::new(Mutex::new(RowTally::default()));
    let mut daemon = Daemon::new(source, tracker, Delivery::Blocking);
    let samples = daemon.subscribe();
    let seen = Arc::clone(&rows);
    lock(&seen).overlays = overlays;
    daemon.observe(move |row, sample| lock(&seen).take(row, sample));
    let running = daemon.start().map_err(|e| Failure::Tracking(e.to_string()))?;
    let mut written = follow(&samples, &rows, writing, &progress);
    running.stop();
    // Let rows in progress finish, and write their records too, unless writing is what failed.
    for sample in samples {
        written = written.and_then(|()| writing.take(&sample));
    }
    let joined = running.join().map_err(|e| Failure::Tracking(e.to_string()));
    progress.finish();
    let mut rows = std::mem::take(&mut *lock(&rows));
    rows.finish_overlays();
    written.and(joined)?;
    writing.records.finish()?;
    Ok(rows)
}

/// Writes samples until the clip ends, Ctrl-C is pressed, or something cannot be written.
fn follow(samples: &Receiver<PoseSample>, rows: &Mutex<RowTally>, writing: &mut Writing<'_>, progress: &Progress) -> Result<(), Failure> {
    while !interrupt::is_interrupted() && lock(rows).overlay_failure.is_none() {
        // The timeout lets Ctrl-C through while no frame comes.
        match samples.recv_timeout(Duration::from_millis(100)) {
            Ok(sample) => {
                progress.advance();
                writing.take(&sample)?;
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    Ok(())
}

/// Locks the tally. Its counts are valid even after an observer panicked.
fn lock(rows: &Mutex<RowTally>) -> MutexGuard<'_, RowTally> {
    rows.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns a tracker's setup for pictures of this size.
pub(in crate::cli) fn tracker_setup(
    settings: &Settings,
    (width, height): (u32, u32),
    threads: Option<u64>,
) -> Result<TrackerSetup, Failure> {
    let (setup, note) = settings.tracker_setup(width, height)?;
    if let Some(note) = note {
        tracing::warn!("{note}");
    }
    let mut setup = TrackerSetup { clock: thread_clock(), store: kept_views(), ..setup };
    if let Some(threads) = threads {
        // At most 64, by the argument's range.
        setup.settings.threads = threads as usize;
    }
    Ok(setup)
}

impl ReplayArguments {
    /// Returns the inputs, which must not be overwritten.
    fn spared(&self, settings: &Settings) -> Spared {
        Spared::default().with_files(&settings.files, "a file of the config").with_clip(&self.clip)
    }

    /// Claims outputs that other modules open later.
    fn claim_others(&self, settings: &Settings, spared: &mut Spared) -> Result<(), Failure> {
        if let Some(folder) = &self.overlay {
            if overlay_video::is_video(folder) {
                spared.claim("--overlay", folder)?;
                overlay_video::refuse_without_program(folder)?;
            } else {
                spared.claim_folder("--overlay", folder)?;
            }
        }
        if self.outputs { spared.claim_outputs(&settings.outputs) } else { Ok(()) }
    }

    /// Whether an output goes to stdout; two are refused.
    fn one_stdout(&self) -> Result<bool, Failure> {
        let outputs = [&self.poses, &self.parts, &self.tum, &self.summary];
        match outputs.into_iter().flatten().filter(|file| file.as_path() == Path::new(STDOUT)).count() {
            0 => Ok(false),
            1 => Ok(true),
            _ => Err(Failure::Usage("only one of --poses, --parts, --tum and --summary may be `-`; give the others a file".to_owned())),
        }
    }
}

/// Number of rows without a frame that get a warning each; later ones are only counted. Chosen, not
/// tuned. Raised, a damaged clip fills the screen.
const WARNED_IN_FULL: u64 = 5;

impl RowTally {
    /// Counts a row and draws its frame, until drawing fails.
    fn take(&mut self, row: &ClipEntry, sample: &PoseSample) {
        self.count(row, sample);
        if let (Some(overlays), EntryContent::Frame(frame), None) = (&mut self.overlays, &row.content, &self.overlay_failure) {
            self.overlay_failure = overlays.write(frame, row.received.as_ref(), sample).err();
        }
    }

    fn finish_overlays(&mut self) {
        let finished = self.overlays.take().map_or(Ok(()), Overlays::finish);
        self.overlay_failure = self.overlay_failure.take().or(finished.err());
    }

    fn count(&mut self, row: &ClipEntry, sample: &PoseSample) {
        let repeated = "it is identical to the one before".to_owned();
        let (reason, what) = match &row.content {
            EntryContent::Frame(_) if sample.reason == Some(Reason::Repeated) => {
                self.undecodable += 1;
                (&repeated, "has no picture of its own")
            }
            EntryContent::Frame(_) => {
                self.readable += 1;
                return;
            }
            EntryContent::Undecodable(reason) => {
                self.undecodable += 1;
                (reason, "cannot be read")
            }
            EntryContent::Skipped(reason) => {
                self.skipped += 1;
                (reason, "is skipped")
            }
        };
        self.first_reason.get_or_insert_with(|| reason.clone());
        match (self.undecodable + self.skipped).cmp(&(WARNED_IN_FULL + 1)) {
            std::cmp::Ordering::Less => tracing::warn!("row {} {what}: {reason}", row.sequence),
            std::cmp::Ordering::Equal => tracing::warn!("row {} {what}: {reason}; more such rows are only counted", row.sequence),
            std::cmp::Ordering::Greater => tracing::debug!("row {} {what}: {reason}", row.sequence),
        }
    }

    /// Returns what went wrong on the pose thread, or with the clip as a whole.
    fn failure(self, arguments: &ReplayArguments, rows: u64) -> Result<(), Failure> {
        if let Some(failure) = self.overlay_failure {
            return Err(failure);
        }
        if self.readable == 0 && !interrupt::is_interrupted() {
            return Err(Failure::NoFrame { clip: arguments.clip.clone(), rows, first: self.first_reason });
        }
        Ok(())
    }
}
