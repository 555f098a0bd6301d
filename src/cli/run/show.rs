//! Runs sessions one after another and owns what outlives them: the server, the record and event
//! files, the service status.

use std::cell::RefCell;
use std::io::{self, Write as _};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::LiveArguments;
use super::preview::Preview;
use super::service::Service;
use super::session::{Clips, End, Session, Sinks};
use crate::cli::failure::Failure;
use crate::cli::interrupt;
use crate::cli::logging;
use crate::cli::pages::Pages;
use crate::config::{HttpSettings, LogSettings, OtherTrackerSettings, Settings, TimecodeSettings};
use crate::contain;
use crate::daemon::live::{Event, LiveLink};
use crate::daemon::{Mode, OtherTrackerReader, Supervisor, TimecodeReader, give_back};
use crate::printable::printable;
use crate::publish::{SafetySettings, Stamps};
use crate::web::page_address;

/// Maximum failures of a stage within [`RESTART_SPAN`] before the daemon gives up. Chosen: a
/// failure that recurs every few seconds is left to the service manager. With a higher number or a
/// shorter span, a daemon that cannot work keeps restarting.
const MAX_RESTARTS: usize = 5;
const RESTART_SPAN: Duration = Duration::from_secs(60);

/// Interval of checks whether a lent camera is back or a config has come. Chosen: nobody notices
/// it. Raised, tracking starts later.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// What outlives sessions.
struct Show<'a> {
    arguments: &'a LiveArguments,
    link: LiveLink,
    supervisor: Arc<Supervisor>,
    server: Serving,
    /// The camera's picture while there is no config.
    preview: Preview,
    service: Service,
    sinks: Sinks,
    clips: Clips,
    timecode: Timecode,
    other_tracker: OtherTracker,
    /// The previous config, which worked.
    previous: Option<Settings>,
    /// When stages failed.
    failures: Vec<Instant>,
}

/// Runs until something ends the daemon; `clip` is what `record` records to.
pub(in crate::cli) fn live(arguments: &LiveArguments, clip: Option<PathBuf>) -> Result<(), Failure> {
    arguments.refuse_impossible()?;
    let loaded = arguments.load();
    let settings = match (&loaded, arguments.setup) {
        (Ok(settings), _) => Some(settings.clone()),
        // `setup` opens the page for exactly this case.
        (Err(_), Some(_)) => None,
        (Err(_), None) => return loaded.map(drop).map_err(Failure::from),
    };
    let log = settings.as_ref().map_or_else(LogSettings::default, |settings| settings.log);
    logging::start(&arguments.log, log);
    if let Some(settings) = &settings {
        settings.notes.iter().for_each(|note| tracing::info!("{note}"));
        settings.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    }
    match loaded {
        Err(_) if !arguments.config.exists() => {
            say(arguments, &format!("{}: there is no config yet; make it, or put one there on the page", arguments.config.display()));
        }
        Err(error) => tracing::warn!("there is no config to track with yet: {error}"),
        Ok(_) => {}
    }
    interrupt::watch();
    interrupt::watch_service();
    // Log contained panics as log lines, not as raw text between them.
    contain::report_others(|panic| tracing::error!("a part of the program failed: {panic}"));
    let link = LiveLink::default();
    let (poses, events) = match &settings {
        Some(settings) => arguments.open_sinks(settings, clip.as_deref())?,
        None => (None, None),
    };
    let mut show = Show {
        arguments,
        supervisor: Arc::new(Supervisor::new(&arguments.config, link.clone())),
        server: Serving::default(),
        preview: Preview::default(),
        sinks: Sinks::begin(poses, events, &link, log)?,
        service: Service::start(arguments.seconds),
        clips: Clips::new(clip),
        timecode: Timecode::default(),
        other_tracker: OtherTracker::default(),
        previous: None,
        failures: Vec::new(),
        link,
    };
    show.supervisor.set_played(arguments.play.clone());
    show.supervisor.set_program(std::env::current_exe().ok());
    let outcome = show.sessions(settings);
    show.end(outcome)
}

impl Show<'_> {
    /// Runs sessions, each under the config that ended the previous one.
    fn sessions(&mut self, first: Option<Settings>) -> Result<(), Failure> {
        let mut next = first;
        loop {
            let settings = match next.take() {
                Some(settings) => settings,
                None => match self.await_config()? {
                    Some(settings) => settings,
                    None => return Ok(()),
                },
            };
            let ended = self.session(&settings);
            give_back();
            next = match ended {
                Ok(End::Stopped) if self.plays_again() => Some(settings),
                Ok(End::Stopped) => return Ok(()),
                Ok(End::Lent) if self.lent() => Some(settings),
                Ok(End::Lent) => return Ok(()),
                Ok(End::Reload(new)) => {
                    self.sinks.reopen();
                    self.previous = Some(settings);
                    Some(*new)
                }
                Err(failure) => self.after(failure, settings)?,
            };
        }
    }

    /// Whether a clip that has ended is played again.
    fn plays_again(&self) -> bool {
        self.arguments.plays_again && !self.service.is_over()
    }

    fn session(&mut self, settings: &Settings) -> Result<End, Failure> {
        let pages = self.server.serve(settings.http.as_ref(), &settings.safety, &self.supervisor, self.arguments)?;
        self.supervisor.use_settings(Some(settings.clone()));
        let timecode = self.timecode.of(settings.timecode.as_ref(), &self.link);
        let other_tracker = self.other_tracker.of(settings.other_tracker.as_ref(), &self.link);
        let (supervisor, reading) = (&self.supervisor, RefCell::default());
        let session =
            Session { settings, arguments: self.arguments, link: &self.link, supervisor, pages, timecode, other_tracker, reading };
        session.run(&mut self.service, &mut self.sinks, &mut self.clips)
    }

    /// Returns the config to track with after a failure under this one; `None` to wait for another
    /// config.
    fn after(&mut self, failure: Failure, settings: Settings) -> Result<Option<Settings>, Failure> {
        if matches!(failure, Failure::Tracking(_)) {
            self.previous = None;
            self.link.statistics.contained_panics.add(1);
            self.failures.retain(|at| at.elapsed() < RESTART_SPAN);
            self.failures.push(Instant::now());
            if self.failures.len() > MAX_RESTARTS {
                return Err(failure);
            }
            tracing::error!("{failure}; starting again");
            return Ok(Some(settings));
        }
        // A new config that cannot be run (its camera does not fit, its port is taken): return to
        // the one that worked.
        let previous = self.previous.take();
        if previous.is_none() && self.arguments.setup.is_none() {
            return Err(failure);
        }
        self.link.events.publish(Event::ConfigRefused { reason: failure.to_string() });
        self.supervisor.refuse(failure.to_string());
        Ok(previous)
    }

    /// Waits for a usable config while the page shows what is wrong with the current one; `None` if
    /// the program is to end before.
    fn await_config(&mut self) -> Result<Option<Settings>, Failure> {
        let http = self.arguments.setup.map(|listen| HttpSettings { listen, ..HttpSettings::default() });
        // Set the state before the page starts, so that it never claims to track an unknown stage.
        self.supervisor.use_settings(None);
        self.supervisor.set_mode(Mode::Setup);
        self.server.serve(http.as_ref(), &SafetySettings::default(), &self.supervisor, self.arguments)?;
        let settings = self.await_good_config();
        // The session opens the camera itself.
        self.preview.end();
        Ok(settings)
    }

    /// Shows the camera until there is a usable config; `None` if the program is to end before.
    fn await_good_config(&mut self) -> Option<Settings> {
        while !self.wait() {
            self.show_camera();
            if !(interrupt::take_reload() | self.supervisor.take_reload()) {
                continue;
            }
            match self.arguments.load() {
                Ok(settings) => {
                    self.supervisor.accept();
                    self.link.events.publish(Event::ConfigReloaded { file: self.arguments.config.display().to_string() });
                    self.supervisor.set_mode(Mode::Track);
                    return Some(settings);
                }
                Err(error) => self.link.events.publish(Event::ConfigRefused { reason: error.to_string() }),
            }
        }
        None
    }

    /// Shows the picture of the camera that the page chose.
    fn show_camera(&mut self) {
        if let Some((_, pages)) = &self.server.pages {
            self.preview.follow(self.supervisor.previewed(), self.arguments.play.as_deref(), &self.link, pages);
        }
    }

    /// Waits until the tracker gets the camera back; false if the program is to end before.
    fn lent(&mut self) -> bool {
        while self.supervisor.mode() != Mode::Track {
            if self.wait() {
                return false;
            }
        }
        true
    }

    /// Waits a moment without a session; true if the program is to end.
    fn wait(&mut self) -> bool {
        self.service.alive();
        self.service.tick(&self.link);
        self.sinks.write_events();
        if self.service.is_over() {
            return true;
        }
        std::thread::sleep(LOOK_EVERY);
        false
    }

    fn end(self, outcome: Result<(), Failure>) -> Result<(), Failure> {
        let reason = match &outcome {
            Err(failure) => failure.to_string(),
            Ok(()) if interrupt::is_interrupted() => "a signal asked for it".to_owned(),
            Ok(()) if self.service.is_over() => "the time of --seconds is over".to_owned(),
            Ok(()) => "the camera's pictures are at their end".to_owned(),
        };
        self.link.events.publish(Event::Ended { reason });
        self.service.end();
        let written = self.sinks.finish();
        self.link.events.close();
        let recorded = self.clips.cut_short().map_or(Ok(()), |reason| Err(Failure::Recording(reason)));
        outcome.and(recorded).and(written)
    }
}

/// Prints a line for the user on standard output, or on stderr if records or events use stdout.
/// Errors are ignored.
fn say(arguments: &LiveArguments, line: &str) {
    let line = format!("{}\n", printable(line));
    let _ = match arguments.uses_stdout() {
        true => io::stderr().write_all(line.as_bytes()),
        false => io::stdout().write_all(line.as_bytes()).and_then(|()| io::stdout().flush()),
    };
}

/// The server, which outlives sessions. It restarts only if the config names another one.
#[derive(Default)]
struct Serving {
    pages: Option<(Option<HttpSettings>, Pages)>,
}

impl Serving {
    fn serve(
        &mut self,
        http: Option<&HttpSettings>,
        safety: &SafetySettings,
        supervisor: &Arc<Supervisor>,
        arguments: &LiveArguments,
    ) -> Result<&Pages, Failure> {
        if self.pages.as_ref().is_some_and(|(before, _)| before.as_ref() != http) {
            self.pages = None;
        }
        let (_, pages) = match self.pages.take() {
            Some(pages) => self.pages.insert(pages),
            None => {
                let run = Some((supervisor, arguments.page_dir()));
                let pages = Pages::start(http, safety, Stamps::Live, run)?;
                supervisor.set_page(http.map(|http| http.listen));
                if let Some(listens) = pages.listens() {
                    say(arguments, &format!("page: {}", page_address(listens)));
                }
                self.pages.insert((http.cloned(), pages))
            }
        };
        Ok(pages)
    }
}

/// The timecode reader. It outlives sessions, because a program that writes to a pipe ends when its
/// reader closes the pipe. It restarts only if `[timecode]` of the config changes.
#[derive(Default)]
struct Timecode(Option<TimecodeReader>);

impl Timecode {
    /// Returns the reader for a config. Tracking goes on without one that cannot be started.
    fn of(&mut self, settings: Option<&TimecodeSettings>, link: &LiveLink) -> Option<&TimecodeReader> {
        if self.0.as_ref().map(TimecodeReader::settings) != settings {
            // The old one must let go of its sound first.
            self.0 = None;
            link.statistics.set_timecode(None);
            let started = settings.map(|settings| TimecodeReader::start(settings.clone(), link)).transpose();
            self.0 = started.unwrap_or_else(|e| {
                tracing::error!("timecode: cannot start its thread ({e}); close other programs");
                None
            });
        }
        self.0.as_ref()
    }
}

/// The reader of another tracker. It outlives sessions, so that the last minute of both is not
/// forgotten, and restarts only if `[other_tracker]` of the config changes.
#[derive(Default)]
struct OtherTracker(Option<OtherTrackerReader>);

impl OtherTracker {
    /// Returns the reader for a config. Tracking goes on without one that cannot be started.
    fn of(&mut self, settings: Option<&OtherTrackerSettings>, link: &LiveLink) -> Option<&OtherTrackerReader> {
        if self.0.as_ref().map(OtherTrackerReader::settings) != settings {
            // The old one must let go of its port first.
            self.0 = None;
            link.statistics.set_other_tracker(None);
            let started = settings.map(|settings| OtherTrackerReader::start(settings.clone())).transpose();
            self.0 = started.unwrap_or_else(|e| {
                tracing::error!("other tracker: cannot start its threads ({e}); close other programs");
                None
            });
        }
        self.0.as_ref()
    }
}
