//! `run`: a camera in, its pose out, for a whole show.
//!
//! A session is a camera, a tracker and what listens to it, under one config. It ends on a signal, with a played clip,
//! on a new config, or when a stage fails; the daemon then starts the next one.

mod camera;
mod notify;
mod service;
mod session;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::failure::Failure;
use super::interrupt;
use super::logging::{self, LogArguments};
use super::output_file::OutputFile;
use super::pages::Pages;
use super::spared::Spared;
use crate::config::{HttpSettings, Settings};
use crate::contain;
use crate::daemon::live::{Event, LiveLink};
use crate::daemon::recorder;
use crate::daemon::{Mode, Supervisor};
use crate::publish::Stamps;
use service::Service;
use session::{End, Session, Sinks};

#[cfg(feature = "live")]
pub(super) use camera::opener;

/// Track with a camera until a signal ends it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose run --config config/stage.toml\n\n\
    The camera may be missing, go and come back: tracking resumes by itself. SIGINT and SIGTERM end it, SIGHUP reads the config again,\n\
    SIGUSR1 saves the recorder's ring. Names of cameras: stagepose devices")]
pub(super) struct RunArguments {
    #[command(flatten)]
    live: LiveArguments,
}

/// What `run` and `record` have in common.
#[derive(Debug, clap::Args)]
pub(super) struct LiveArguments {
    /// The config of the camera and the stage
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// Write one JSON record a tracked frame; - for stdout
    #[arg(long, value_name = "OUT.jsonl")]
    poses: Option<PathBuf>,
    /// Write what happens (camera lost, stale, …) as JSON lines
    #[arg(long, value_name = "OUT.jsonl")]
    events: Option<PathBuf>,
    /// Tracker workers; the result does not depend on it [default: the config's, else 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=64))]
    threads: Option<u64>,
    /// Play a clip as if it were the camera: its pace, late frames dropped
    #[arg(long, value_name = "CLIP")]
    play: Option<PathBuf>,
    /// End after tracking for this many seconds, or when the camera does not come in this time
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// Serve the page from this folder instead of the program, for who works on it
    #[cfg(feature = "http")]
    #[arg(long, value_name = "FOLDER")]
    page_dir: Option<PathBuf>,
    #[command(flatten)]
    log: LogArguments,
}

impl LiveArguments {
    #[cfg(feature = "http")]
    fn page_dir(&self) -> Option<&Path> {
        self.page_dir.as_deref()
    }

    #[cfg(not(feature = "http"))]
    fn page_dir(&self) -> Option<&Path> {
        None
    }

    /// `--poses` and `--events`, open; none of them over what is read, what is recorded, or an output of the config.
    fn open_sinks(&self, settings: &Settings, recording: Option<&Path>) -> Result<(Option<OutputFile>, Option<OutputFile>), Failure> {
        let spared = Spared::default().with_files(&settings.files, "a file of the config");
        let mut spared = self.play.iter().fold(spared, |spared, clip| spared.with_clip(clip));
        recording.into_iter().flat_map(recorder::parts).try_for_each(|part| spared.claim("the recording", &part))?;
        let (poses, events) = (spared.open("--poses", self.poses.as_deref())?, spared.open("--events", self.events.as_deref())?);
        spared.claim_outputs(&settings.outputs)?;
        Ok((poses, events))
    }
}

pub(super) fn run(arguments: &RunArguments) -> Result<(), Failure> {
    live(&arguments.live, None)
}

/// A stage may fail this often within [`RESTART_SPAN`] before the daemon gives up. Chosen: a failure that comes back every few seconds is
/// left to the supervisor. The number raised or the span shortened, a daemon that cannot work goes on restarting.
const MOST_RESTARTS: usize = 5;
const RESTART_SPAN: Duration = Duration::from_secs(60);

/// How often it is looked whether a lent camera is back. Chosen: nobody notices it. Raised, tracking begins later.
const LENT_LOOK: Duration = Duration::from_millis(50);

/// Sessions one after another; `clip` is what `record` records to.
pub(super) fn live(arguments: &LiveArguments, clip: Option<PathBuf>) -> Result<(), Failure> {
    let mut settings = Settings::load(&arguments.config)?;
    logging::start(&arguments.log, settings.log);
    settings.notes.iter().for_each(|note| tracing::info!("{note}"));
    settings.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    interrupt::watch();
    interrupt::watch_service();
    // What the threads contain shall be in the log, not between its lines.
    contain::report_others(|panic| tracing::error!("a part of the program failed: {panic}"));
    let link = LiveLink::default();
    let (poses, events) = arguments.open_sinks(&settings, clip.as_deref())?;
    let mut sinks = Sinks::begin(poses, events, &link, settings.log)?;
    let mut service = Service::start(arguments.seconds);
    let mut previous: Option<Settings> = None;
    let mut failures: Vec<Instant> = Vec::new();
    let mut clips = session::Clips::new(clip);
    let supervisor = Arc::new(Supervisor::new(&arguments.config, link.clone()));
    let mut server = Serving::default();
    let outcome = loop {
        let outcome = server.serve(&settings, &supervisor, arguments).and_then(|pages| {
            supervisor.use_settings(settings.clone());
            let session = Session { settings: &settings, arguments, link: &link, supervisor: &supervisor, pages };
            session.run(&mut service, &mut sinks, &mut clips)
        });
        match outcome {
            Ok(End::Stopped) => break Ok(()),
            Ok(End::Lent) => {
                if !lent(&mut service, &mut sinks, &supervisor) {
                    break Ok(());
                }
            }
            Ok(End::Reload(new)) => {
                sinks.reopen();
                previous = Some(std::mem::replace(&mut settings, *new));
            }
            Err(failure) => match previous.take() {
                // A new config that cannot be run (its camera does not fit, its port is taken): back to the one that worked.
                Some(old) if !matches!(failure, Failure::Tracking(_)) => {
                    link.events.publish(Event::ConfigRefused { reason: failure.to_string() });
                    settings = old;
                }
                _ if !matches!(failure, Failure::Tracking(_)) => break Err(failure),
                _ => {
                    link.statistics.contained_panics.add(1);
                    failures.retain(|at| at.elapsed() < RESTART_SPAN);
                    failures.push(Instant::now());
                    if failures.len() > MOST_RESTARTS {
                        break Err(failure);
                    }
                    tracing::error!("{failure}; starting again");
                }
            },
        }
    };
    let reason = match &outcome {
        Err(failure) => failure.to_string(),
        Ok(()) if interrupt::is_interrupted() => "a signal asked for it".to_owned(),
        Ok(()) if service.is_over() => "the time of --seconds is over".to_owned(),
        Ok(()) => "the camera's pictures are at their end".to_owned(),
    };
    link.events.publish(Event::Ended { reason });
    service.end();
    let written = sinks.finish();
    link.events.close();
    let recorded = clips.cut_short().map_or(Ok(()), |reason| Err(Failure::Recording(reason)));
    outcome.and(recorded).and(written)
}

/// The server, which outlives sessions; it begins anew only where the config has another one.
#[derive(Default)]
struct Serving {
    pages: Option<(Option<HttpSettings>, Pages)>,
}

impl Serving {
    /// The server of this config.
    fn serve(&mut self, settings: &Settings, supervisor: &Arc<Supervisor>, arguments: &LiveArguments) -> Result<&Pages, Failure> {
        if self.pages.as_ref().is_some_and(|(http, _)| *http != settings.http) {
            self.pages = None;
        }
        let (_, pages) = match self.pages.take() {
            Some(pages) => self.pages.insert(pages),
            None => {
                let run = Some((supervisor, arguments.page_dir()));
                let pages = Pages::start(settings.http.as_ref(), &settings.safety, Stamps::Live, run)?;
                self.pages.insert((settings.http.clone(), pages))
            }
        };
        Ok(pages)
    }
}

/// Waits until the tracker gets the camera back; false where the program is to end before.
fn lent(service: &mut Service, sinks: &mut Sinks, supervisor: &Supervisor) -> bool {
    while supervisor.mode() != Mode::Track {
        service.alive();
        service.tick(&supervisor.link);
        sinks.write_events();
        if service.is_over() {
            return false;
        }
        std::thread::sleep(LENT_LOOK);
    }
    true
}

/// Why this build cannot open a camera.
#[cfg(not(feature = "live"))]
pub(super) fn no_live_feature() -> Failure {
    Failure::Usage(
        "this build has no cameras: it was made without the feature `live`; build it with: .ci/setup && cargo build --release (it needs libclang)"
            .to_owned(),
    )
}
