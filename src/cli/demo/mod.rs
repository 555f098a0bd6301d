//! `stagepose demo`: tracks a virtual stage and prints the poses' errors.
//!
//! It needs no camera and no files: the stage is painted and rendered in the process, so the true
//! pose of every frame is known. The page shows it to browsers on this machine only. `--save` also
//! writes the frames with everything that `stagepose replay` needs.

mod errors;
mod live;
mod page;
mod saved_clip;

use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;

use clap::Args;
use thiserror::Error;

use super::failure::Failure;
use super::interrupt;
use crate::capture::{CaptureError, EntryContent, FrameSource, VirtualCamera};
use crate::daemon::thread_clock;
use crate::frame::{Frame, Timestamp};
use crate::record::PoseSample;
use crate::simulate::{Dolly, DollyError, VirtualStage, dolly};
use crate::tracker::{FrameError, SetupError, Tracker, TrackerSetup};
use errors::PoseErrors;
use live::LivePrint;
use page::Page;
use saved_clip::SavedClip;

/// Number of frames without `--frames`: five seconds. Raised, scripts wait longer for the table of
/// errors.
const FRAMES: u64 = 150;
/// Duration without `--frames` at a terminal with the page, seconds, unless Ctrl-C ends it earlier.
/// Raised, an unattended demo runs longer.
const SHOWN_S: f64 = 600.0;

/// Track a virtual stage and print the errors against the truth; needs no camera.
#[derive(Debug, Clone, PartialEq, Args)]
#[command(
    after_help = "Example:\n  stagepose demo\n  stagepose demo --frames 60 --save clip && stagepose replay clip --config clip/stage.toml --poses poses.jsonl\n\n\
        The first line is the address of the page, which only this machine sees. At a terminal it runs for ten minutes or until Ctrl-C."
)]
pub struct DemoArguments {
    /// How many frames to render and track [default: 150; at a terminal with the page, ten minutes]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub frames: Option<u64>,
    /// Write the clip to this folder: frames, stamps, config, calibration, artwork, true poses
    #[arg(long, value_name = "CLIP")]
    pub save: Option<PathBuf>,
    /// Picture width in pixels
    #[arg(long, value_name = "PX", default_value_t = 640, value_parser = clap::value_parser!(u32).range(64..=4096))]
    pub width: u32,
    /// Picture height in pixels
    #[arg(long, value_name = "PX", default_value_t = 480, value_parser = clap::value_parser!(u32).range(64..=4096))]
    pub height: u32,
    /// Frames per second
    #[arg(long, value_name = "HZ", default_value_t = 30.0, value_parser = super::send_test::rate)]
    pub fps: f64,
    /// Seed: another number paints another stage and shakes the camera in another way
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Save the frames as JPEG of this quality, 1 to 100, instead of PNG
    #[arg(long, value_name = "QUALITY", requires = "save", value_parser = clap::value_parser!(u8).range(1..=100))]
    pub jpeg: Option<u8>,
    /// Serve no page, and track as fast as possible
    #[arg(long)]
    pub no_page: bool,
}

impl DemoArguments {
    /// Returns the number of frames to render.
    fn frame_count(&self, is_terminal: bool) -> u64 {
        let is_watched = is_terminal && !self.no_page && self.save.is_none() && cfg!(feature = "http");
        self.frames.unwrap_or(if is_watched { (SHOWN_S * self.fps).ceil() as u64 } else { FRAMES })
    }
}

/// Why a demo ended early.
#[derive(Debug, Error)]
pub enum DemoError {
    /// The scene cannot be made.
    #[error("the virtual stage cannot be made: {0}")]
    Scene(#[from] DollyError),
    /// A file of the saved clip cannot be written.
    #[error("{}: cannot be written ({source}); give --save a writable folder with free space", file.display())]
    Save {
        /// The file or folder.
        file: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A frame or a stamp of the saved clip cannot be written.
    #[error(transparent)]
    Clip(#[from] CaptureError),
    /// The folder already holds part of a saved clip; holds the first such file.
    #[error("{}: exists already and would be overwritten; give --save a new folder", .0.display())]
    Exists(PathBuf),
    /// The tracker cannot be set up.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// A frame cannot be tracked.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// Standard output is closed.
    #[error("standard output cannot be written ({0})")]
    Print(#[from] io::Error),
}

impl From<DemoError> for Failure {
    fn from(error: DemoError) -> Self {
        match error {
            DemoError::Print(source) => Self::Output { file: "standard output".into(), source },
            other => Self::Demo(other.to_string()),
        }
    }
}

/// Renders, tracks, and prints the errors.
///
/// # Errors
/// When the saved clip or standard output cannot be written. A stage that is not found is not an
/// error.
pub fn run(arguments: &DemoArguments) -> Result<(), DemoError> {
    interrupt::watch();
    // Print the address first: painting and preparing take a moment.
    let mut page = if arguments.no_page { None } else { served()? };
    let frames = arguments.frame_count(io::stdout().is_terminal());
    let stage = scene(arguments, frames)?;
    let mut saved = match &arguments.save {
        Some(folder) => Some(SavedClip::create(folder, &stage, arguments.jpeg)?),
        None => None,
    };
    let setup = TrackerSetup { clock: thread_clock(), ..TrackerSetup::from(&stage) };
    let mut tracker = Tracker::new(setup.clone())?;
    if let Some(page) = &mut page {
        page.watch(&setup, &mut tracker);
    }
    let mut camera = VirtualCamera::new(stage, arguments.fps, frames);
    let mut live = LivePrint::stdout();
    let errors = session(&mut camera, |frame| tracker.track(frame), saved.as_mut(), page.as_mut(), &mut live)?;
    if let Some(saved) = saved {
        saved.finish()?;
    }
    let mut out = io::stdout().lock();
    write!(out, "{errors}")?;
    if let Some(folder) = &arguments.save {
        let folder = folder.display();
        writeln!(out, "saved; replay with: stagepose replay {folder} --config {folder}/stage.toml")?;
    }
    Ok(out.flush()?)
}

/// Starts the page and prints its address. If no port is available, it says so and returns `None`.
fn served() -> io::Result<Option<Page>> {
    match Page::start() {
        Ok(page) => {
            if let Some(address) = page.address() {
                let mut out = io::stdout().lock();
                writeln!(out, "page: {address} (only this machine sees it; Ctrl-C ends the demo)")?;
                out.flush()?;
            }
            Ok(Some(page))
        }
        Err(failure) => {
            let _ = writeln!(io::stderr(), "stagepose: there is no page: {failure}");
            Ok(None)
        }
    }
}

/// Returns the dolly scene that the arguments ask for; its artwork has about two texels per pixel.
fn scene(arguments: &DemoArguments, frames: u64) -> Result<VirtualStage, DemoError> {
    let (width, height, seed) = (arguments.width, arguments.height, arguments.seed);
    let duration_s = frames as f64 / arguments.fps;
    Ok(dolly(Dolly { width, height, seed, duration_s, artwork_width: (2 * width).clamp(400, 2400) })?)
}

/// Tracks every frame until a signal: saves it if requested, prints it, shows it, and compares it
/// with the truth. With a page and without saving, frames come in real time.
fn session<W: Write>(
    camera: &mut VirtualCamera,
    mut track: impl FnMut(&Frame) -> Result<PoseSample, FrameError>,
    mut saved: Option<&mut SavedClip>,
    mut page: Option<&mut Page>,
    live: &mut LivePrint<W>,
) -> Result<PoseErrors, DemoError> {
    let mut errors = PoseErrors::default();
    while let Some(row) = camera.next_entry().filter(|_| !interrupt::is_interrupted()) {
        // The virtual camera has a picture for every row.
        let EntryContent::Frame(frame) = &row.content else { continue };
        let truth = camera.truth(frame.sequence);
        match (saved.as_deref_mut(), page.as_deref()) {
            (Some(saved), _) => saved.add(frame, &truth)?,
            (None, Some(page)) => page.wait_until(frame.timestamp.duration_since(Timestamp::default())),
            (None, None) => {}
        }
        let sample = track(frame)?;
        errors.add(&sample, &truth);
        live.show(&sample, &truth)?;
        if let Some(page) = page.as_deref_mut() {
            page.show(&row, &sample);
        }
    }
    live.end()?;
    Ok(errors)
}

#[cfg(test)]
mod tests;
