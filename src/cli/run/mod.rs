//! `run`: tracks a camera for a whole show.
//!
//! A session is a camera, a tracker and their listeners under one config. It ends on a signal, at
//! the end of a played clip, on a new config, or when a stage fails; the daemon then starts the
//! next one (`show`). `setup` does the same for a stage that has no valid config yet.

mod camera;
mod notify;
mod preview;
mod service;
mod session;
#[cfg(feature = "http")]
mod setup;
mod show;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use super::failure::Failure;
use super::logging::LogArguments;
use super::output_file::{OutputFile, STDOUT};
use super::spared::Spared;
use crate::config::{ConfigError, HttpSettings, Settings};
use crate::daemon::{Keeping, recorder};

#[cfg(feature = "live")]
pub(super) use camera::opener;
#[cfg(feature = "http")]
pub(super) use setup::{SetupArguments, setup};
pub(super) use show::live;

/// Track with a camera until a signal ends it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose run --config config/stage.toml\n\n\
    The camera may be missing, go and come back: tracking resumes by itself. SIGINT and SIGTERM end it, SIGHUP reads the config again,\n\
    SIGUSR1 saves the recorder's ring. Names of cameras: stagepose devices")]
pub(super) struct RunArguments {
    #[command(flatten)]
    live: LiveArguments,
}

/// Arguments common to `run` and `record`.
#[derive(Debug, clap::Args)]
pub(super) struct LiveArguments {
    /// The config of the camera and the stage
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// Write one JSON record per tracked frame; - for stdout
    #[arg(long, value_name = "OUT.jsonl")]
    poses: Option<PathBuf>,
    /// Write events (camera lost, stale, …) as JSON lines
    #[arg(long, value_name = "OUT.jsonl")]
    events: Option<PathBuf>,
    /// Tracker workers; they do not change the result [default: the config's, else 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=64))]
    threads: Option<u64>,
    /// Play a clip as if it were the camera: in real time, late frames dropped
    #[arg(long, value_name = "CLIP")]
    play: Option<PathBuf>,
    /// Play the clip again and again: each time tracking starts anew and rows are numbered from 0,
    /// while stamps keep rising
    #[arg(long = "loop", requires = "play")]
    plays_again: bool,
    /// Stop after tracking for this many seconds, or if the camera does not come in this time
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// Serve the page from this folder instead of the built-in one, for developing it
    #[cfg(feature = "http")]
    #[arg(long, value_name = "FOLDER")]
    page_dir: Option<PathBuf>,
    #[command(flatten)]
    log: LogArguments,
    /// The page's address, whatever the config says. Set by `setup`: the config may then be invalid
    /// or missing.
    #[arg(skip)]
    setup: Option<SocketAddr>,
}

impl LiveArguments {
    fn load(&self) -> Result<Settings, ConfigError> {
        self.loader()()
    }

    /// Returns a closure that loads the config on any thread.
    fn loader(&self) -> impl Fn() -> Result<Settings, ConfigError> + Send + 'static {
        let (config, setup) = (self.config.clone(), self.setup);
        move || {
            let keeping = Keeping::of(&config);
            let mut settings = Settings::load_as(&keeping.current(), &config)?;
            if keeping.is_elsewhere() {
                keep_elsewhere(&mut settings, &keeping);
            }
            let Some(listen) = setup else { return Ok(settings) };
            let hosts = settings.http.as_ref().map(|http| http.hosts.clone()).unwrap_or_default();
            Ok(Settings { http: Some(HttpSettings { listen, hosts }), ..settings })
        }
    }

    /// Whether records or events go to standard output, which messages must then not use.
    fn uses_stdout(&self) -> bool {
        [&self.poses, &self.events].into_iter().flatten().any(|file| file.as_path() == Path::new(STDOUT))
    }

    /// Refuses arguments that cannot be satisfied.
    fn refuse_impossible(&self) -> Result<(), Failure> {
        match self.play.as_deref() {
            Some(clip) if self.plays_again && clip == Path::new(STDOUT) => {
                Err(Failure::Usage("--loop: a clip from standard input cannot be played twice; save it to a file".to_owned()))
            }
            _ => Ok(()),
        }
    }

    #[cfg(feature = "http")]
    fn page_dir(&self) -> Option<&Path> {
        self.page_dir.as_deref()
    }

    #[cfg(not(feature = "http"))]
    fn page_dir(&self) -> Option<&Path> {
        None
    }

    /// Opens `--poses` and `--events`; neither may overwrite an input, the recording, or an output
    /// of the config.
    fn open_sinks(&self, settings: &Settings, recording: Option<&Path>) -> Result<(Option<OutputFile>, Option<OutputFile>), Failure> {
        let spared = Spared::default().with_files(&settings.files, "a file of the config");
        let mut spared = self.play.iter().fold(spared, |spared, clip| spared.with_clip(clip));
        recording.into_iter().flat_map(recorder::parts).try_for_each(|part| spared.claim("the recording", &part))?;
        let (poses, events) = (spared.open("--poses", self.poses.as_deref())?, spared.open("--events", self.events.as_deref())?);
        spared.claim_outputs(&settings.outputs)?;
        Ok((poses, events))
    }
}

/// Moves what is normally stored next to the config to a writable folder, and adds a note about it.
fn keep_elsewhere(settings: &mut Settings, keeping: &Keeping) {
    let (file, folder) = (settings.file.display().to_string(), keeping.folder());
    settings.notes.push(format!("{file}: its folder is not writable, so the set and config changes are kept in {}", folder.display()));
    if keeping.current() != settings.file {
        settings.notes.push(format!("{file}: {} was changed later and is used instead", keeping.current().display()));
    }
    if settings.recorder.folder == settings.file.with_file_name("recordings") {
        settings.recorder.folder = folder.join("recordings");
    }
}

pub(super) fn run(arguments: &RunArguments) -> Result<(), Failure> {
    live(&arguments.live, None)
}

/// Returns why this build cannot open a camera.
#[cfg(not(feature = "live"))]
pub(super) fn no_live_feature() -> Failure {
    Failure::Usage(
        "this build has no cameras: it was made without the feature `live`; build it with: .ci/setup && cargo build --release (it needs libclang)"
            .to_owned(),
    )
}
