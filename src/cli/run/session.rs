//! One session: a camera, a tracker and their listeners, under one config.

use std::cell::RefCell;
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError};

use super::service::Service;
use super::{LiveArguments, camera};
use crate::camera::KnownShutter;
use crate::capture::camera::CameraMode;
use crate::capture::timestamping::monotonic_now;
use crate::cli::failure::Failure;
use crate::cli::interrupt;
use crate::cli::outcome::Outcome;
use crate::cli::output_file::OutputFile;
use crate::cli::outputs::Outputs;
use crate::cli::pages::Pages;
use crate::cli::replay::records::{Output, Records};
use crate::cli::replay::tracker_setup;
use crate::config::{ConfigError, LogFormat, LogSettings, RecorderSettings, Settings};
use crate::daemon::live::{Event, EventListener, LiveLink, LiveSource, Patience, exposure_of};
use crate::daemon::recorder::{self, AboutClip, RealDisk, Recorder, RecorderPlan};
use crate::daemon::{Daemon, LearntFile, Mode, OtherTrackerReader, RecordingWish, RunningDaemon, Supervisor, TimecodeReader, unwritten};
use crate::frame::Timestamp;
use crate::publish::{PoseWithheld, Stamps};
use crate::record::{PoseSample, State};
use crate::telemetry::RecorderState;
use crate::track::LearntCamera;
use crate::tracker::Tracker;

/// Interval of stale messages while waiting for a camera: ten per second. Chosen: soon enough for a
/// client that has just connected. Raised, clients learn later that there is no pose.
const STALE_REPEAT: Duration = Duration::from_millis(100);
/// Maximum time that a reader of `--poses` or `--events` may take nothing before it is given up, as
/// it holds up the other outputs. Chosen, not tuned. Raised, a hung reader freezes all outputs for
/// longer.
const SLOW_READER: Duration = Duration::from_millis(200);

/// Why a session ended.
pub(super) enum End {
    /// On a signal, on time, or at the end of a played clip.
    Stopped,
    /// A new config is there.
    Reload(Box<Settings>),
    /// The camera is lent to another task.
    Lent,
}

/// What a session runs with.
pub(super) struct Session<'a> {
    pub settings: &'a Settings,
    pub arguments: &'a LiveArguments,
    pub link: &'a LiveLink,
    pub supervisor: &'a Arc<Supervisor>,
    pub pages: &'a Pages,
    /// The timecode of the camera's stamps.
    pub timecode: Option<&'a TimecodeReader>,
    /// Another tracker beside this one.
    pub other_tracker: Option<&'a OtherTrackerReader>,
    /// A new config that is being read and tried.
    pub reading: RefCell<Option<JoinHandle<Result<Settings, ConfigError>>>>,
}

impl Drop for Session<'_> {
    fn drop(&mut self) {
        if self.reading.get_mut().is_some() {
            // The next session will read it.
            self.supervisor.reload();
        }
    }
}

/// What follows a running session.
struct Listening<'a> {
    samples: &'a Receiver<PoseSample>,
    running: &'a RunningDaemon,
    /// Saves the ring.
    saver: Option<&'a dyn Fn()>,
    recorder: Option<&'a Recorder>,
    pages: &'a Pages,
    outputs: &'a Outputs,
}

/// Sends a sample to all. The outputs have their own watchdog for stale poses.
fn tell(sample: &PoseSample, pages: &Pages, outputs: &Outputs, sinks: &mut Sinks) {
    if sample.state != State::Stale {
        outputs.send(sample);
    }
    pages.publish(sample);
    sinks.write(sample);
}

impl Session<'_> {
    /// Runs until something ends the session.
    pub fn run(&self, service: &mut Service, sinks: &mut Sinks, clips: &mut Clips) -> Result<End, Failure> {
        let pages = self.pages;
        pages.use_limits(&self.settings.safety);
        let opener = camera::camera(self.settings, self.arguments.play.as_deref())?;
        let (shutter, latency) = (self.settings.shutter.or_zero(), self.settings.device.latency);
        let mut source = LiveSource::start_late(opener, shutter, latency, Patience::default(), self.link.clone());
        let mode = match self.wait(&mut source, pages, service, sinks) {
            Ok(mode) => mode,
            Err(end) => return Ok(end),
        };
        let mut setup = tracker_setup(self.settings, mode.size, self.arguments.threads)?;
        // Stamps, tracker and the recording's config must all use the exposure that the camera has
        // locked.
        let exposure_s = exposure_of(&self.settings.shutter.or_zero(), &mode);
        let known_exposure_s = Some(exposure_s).filter(|s| *s > 0.0);
        setup.shutter.exposure_s = known_exposure_s;
        if self.settings.device.fps.is_none() {
            self.settings.safety.note_on_rate(mode.fps).into_iter().for_each(|note| tracing::warn!("{note}"));
        }
        let learnt_file = LearntFile::of(&mode);
        setup.learnt = learnt_file.load();
        sinks.learnt = setup.learnt;
        let stopper = source.stopper();
        let outputs = Outputs::start(
            self.settings,
            None,
            setup.camera,
            Stamps::Live,
            self.timecode.map(|timecode| timecode.source().clone()),
            self.other_tracker.map(|other| other.rings().clone()),
            Some(mode.fps),
        )?;
        pages.show_scene(&setup);
        let mut tracker = Tracker::new(setup)?.with_filter(self.settings.filter);
        let for_pages = pages.observer(&mut tracker);
        let mut daemon = Daemon::live(source, tracker);
        let samples = daemon.subscribe();
        let recorder = clips.recorder(self, mode.clone(), exposure_s)?;
        if let Some(recorder) = &recorder {
            daemon.observe(recorder.observer());
        }
        if let Some(observer) = for_pages {
            daemon.observe(observer);
        }
        let running = match daemon.start() {
            Ok(running) => running,
            Err(e) => {
                outputs.close();
                if let Some(recorder) = recorder {
                    recorder.finish();
                }
                return Err(Failure::Tracking(e.to_string()));
            }
        };
        let saver = recorder.as_ref().map(Recorder::saver);
        let listening = Listening {
            samples: &samples,
            running: &running,
            saver: saver.as_ref().map(|s| s as &dyn Fn()),
            recorder: recorder.as_ref(),
            pages,
            outputs: &outputs,
        };
        self.supervisor.watch_outputs(Some(Arc::new(outputs.watch())));
        self.link.statistics.set_shutter(KnownShutter { exposure_s: known_exposure_s, ..self.settings.shutter });
        self.supervisor.set_picture_size(Some(mode.size));
        let end = self.follow(&listening, service, sinks);
        self.supervisor.watch_outputs(None);
        self.supervisor.set_picture_size(None);
        self.supervisor.set_recording(None);
        drop(saver);
        stopper.stop();
        running.stop();
        // Let rows in progress finish, and publish them.
        samples.iter().for_each(|sample| tell(&sample, pages, &outputs, sinks));
        outputs.close();
        learnt_file.store(&sinks.learnt);
        let joined = running.join().map_err(|e| Failure::Tracking(e.to_string()));
        if let Some(recorder) = recorder {
            clips.ended(recorder.finish());
        }
        sinks.write_events();
        joined.map(|()| end)
    }

    /// Returns the camera's mode once it is there, or why the session ended before that.
    fn wait(&self, source: &mut LiveSource, pages: &Pages, service: &mut Service, sinks: &mut Sinks) -> Result<CameraMode, End> {
        let (mut reload, mut stale_reported_at) = (None, Instant::now());
        let mode = source.wait_for_camera(|| {
            service.alive();
            // Clients are also told that there is no pose while there is no pipeline.
            let now = monotonic_now();
            if stale_reported_at.elapsed() >= STALE_REPEAT && self.link.pulse.time_left(now).is_none() {
                stale_reported_at = Instant::now();
                pages.publish(&PoseSample::stale(0, Timestamp::default(), self.link.pulse.age_ms(now)));
            }
            service.tick(self.link);
            sinks.write_events();
            reload = self.reload();
            service.is_over() || reload.is_some() || self.supervisor.mode() != Mode::Track
        });
        let ended = || if self.supervisor.mode() == Mode::Track { End::Stopped } else { End::Lent };
        mode.ok_or_else(|| reload.map_or_else(ended, End::Reload))
    }

    fn follow(&self, listening: &Listening<'_>, service: &mut Service, sinks: &mut Sinks) -> End {
        let Listening { samples, running, saver, recorder, pages, outputs } = *listening;
        service.tracking_begins();
        loop {
            match samples.recv_timeout(Duration::from_millis(50)) {
                Ok(sample) => {
                    service.seen(&sample);
                    self.other_tracker.into_iter().for_each(|other| other.ours(&sample));
                    tell(&sample, pages, outputs, sinks);
                    outputs.slowest_ms().into_iter().for_each(|ms| self.link.statistics.sent_after_ms(ms));
                }
                Err(RecvTimeoutError::Timeout) if running.has_ended() => return End::Stopped,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return End::Stopped,
            }
            service.tick(self.link);
            if let Some(timecode) = self.timecode {
                timecode.look(self.link);
            }
            if let Some(other) = self.other_tracker {
                other.look(self.link);
            }
            for PoseWithheld { output, body, reason } in outputs.withheld() {
                self.link.events.publish(Event::PoseWithheld { output, body, reason: reason.words().into() });
            }
            sinks.write_events();
            self.take_up_recording(recorder);
            if interrupt::take_save() | self.supervisor.take_save() {
                match saver {
                    Some(save) => save(),
                    None => tracing::warn!("there is no ring to save; set ring_s in [recorder]"),
                }
            }
            if let Some(new) = self.reload() {
                service.reloading();
                return End::Reload(new);
            }
            if self.supervisor.mode() != Mode::Track {
                return End::Lent;
            }
            if service.is_over() {
                return End::Stopped;
            }
        }
    }

    /// Starts or stops a recording if requested.
    fn take_up_recording(&self, recorder: Option<&Recorder>) {
        let (Some(wish), Some(recorder)) = (self.supervisor.take_recording(), recorder) else { return };
        match wish {
            RecordingWish::Start if self.supervisor.recording().is_none() => {
                let clip = recorder::new_clip_folder(&self.settings.recorder.folder);
                self.supervisor.set_recording(Some(clip.clone()));
                recorder.begin(clip);
            }
            RecordingWish::Start => {}
            RecordingWish::Stop => {
                self.supervisor.set_recording(None);
                recorder.end();
            }
        }
    }

    /// Returns the new config if SIGHUP or the page asked for it and it can be run. It is read and
    /// tried on its own thread while tracking continues.
    fn reload(&self) -> Option<Box<Settings>> {
        let mut reading = self.reading.borrow_mut();
        if reading.is_none() && (interrupt::take_reload() | self.supervisor.take_reload()) {
            let (load, supervisor) = (self.arguments.loader(), self.supervisor.clone());
            let read = move || load().and_then(|settings| supervisor.rehearse(&settings).map(|()| settings));
            match std::thread::Builder::new().name("config".to_owned()).spawn(read) {
                Ok(thread) => *reading = Some(thread),
                Err(error) => self.refuse(format!("cannot start a thread ({error}); close other programs")),
            }
        }
        let read = reading.take_if(|thread| thread.is_finished())?.join();
        match read {
            Ok(Ok(settings)) => {
                self.supervisor.accept();
                self.link.events.publish(Event::ConfigReloaded { file: self.settings.file.display().to_string() });
                Some(Box::new(settings))
            }
            Ok(Err(error)) => {
                self.refuse(error.to_string());
                None
            }
            Err(_) => {
                self.refuse("reading it failed inside the program; please report it with the config".to_owned());
                None
            }
        }
    }

    /// Refuses a new config; the previous one stays in force.
    fn refuse(&self, reason: String) {
        self.supervisor.refuse(reason.clone());
        self.link.events.publish(Event::ConfigRefused { reason });
    }
}

/// The files that `run` writes lines to. A file that can no longer be written is given up; tracking
/// continues.
pub(super) struct Sinks {
    poses: Option<Records>,
    events: Option<Output>,
    happening: EventListener,
    /// Why the first of them was given up.
    failure: Option<Failure>,
    outcome: Outcome,
    /// What has been learnt of the camera so far.
    pub learnt: LearntCamera,
    /// Whether stderr is a log for programs.
    logs_json: bool,
}

impl Sinks {
    /// Starts the files.
    pub fn begin(poses: Option<OutputFile>, events: Option<OutputFile>, link: &LiveLink, log: LogSettings) -> Result<Self, Failure> {
        let poses = poses.map(|file| Records::begin(Some(file.with_patience(SLOW_READER)), None, true)).transpose()?;
        let events = events.map(|file| Output::begin(file.with_patience(SLOW_READER))).transpose()?;
        Ok(Self {
            poses,
            events,
            happening: link.events.listen(),
            failure: None,
            outcome: Outcome::default(),
            learnt: LearntCamera::default(),
            logs_json: log.format == LogFormat::Json,
        })
    }

    /// Writes a sample's record; a stale message has none.
    pub fn write(&mut self, sample: &PoseSample) {
        if sample.state == State::Stale {
            return;
        }
        self.outcome.add(sample);
        self.learnt = sample.learnt;
        attempt(&mut self.poses, "records", &mut self.failure, |poses| poses.write(sample));
    }

    /// Writes the events since the last call.
    pub fn write_events(&mut self) {
        for event in self.happening.try_iter() {
            // Dropped frames are only counted; a recording lists them.
            if !event.event.is_progress() {
                attempt(&mut self.events, "events", &mut self.failure, |events| events.write_all_and_flush(&event.to_json_line()));
            }
        }
    }

    /// After a SIGHUP: flushes events, and starts new files for those that log rotation has moved
    /// away.
    pub fn reopen(&mut self) {
        self.write_events();
        attempt(&mut self.poses, "records", &mut self.failure, Records::reopen);
        attempt(&mut self.events, "events", &mut self.failure, Output::reopen);
    }

    /// Writes what is left, closes the files, and prints the show's summary on stderr.
    ///
    /// # Errors
    /// Why a file was given up, now or before. Tracking continued, but the file is incomplete.
    pub fn finish(mut self) -> Result<(), Failure> {
        self.write_events();
        match self.logs_json {
            true => tracing::info!("{}", self.outcome.sentences()),
            // If stderr is closed, nobody is listening.
            false => drop(writeln!(io::stderr(), "{}", self.outcome.sentences())),
        }
        self.failure.map_or(Ok(()), Err)
    }
}

/// Runs `act` on a file that is still in use. On failure it logs the reason and gives the file up;
/// the first reason is kept.
fn attempt<T>(file: &mut Option<T>, of: &str, kept: &mut Option<Failure>, act: impl FnOnce(&mut T) -> Result<(), Failure>) {
    if let Some(Err(failure)) = file.as_mut().map(act) {
        tracing::error!("{failure}; no more {of} are written");
        *file = None;
        kept.get_or_insert(failure);
    }
}

/// The clips that sessions record to, one each.
pub(super) struct Clips {
    asked: Option<PathBuf>,
    begun: u32,
    /// Why the first requested clip that ended early did so.
    cut_short: Option<String>,
}

impl Clips {
    /// Starts with no clips. The first session records to `asked`; later ones get a number
    /// appended.
    pub fn new(asked: Option<PathBuf>) -> Self {
        Self { asked, begun: 0, cut_short: None }
    }

    /// Returns why a recording requested by name is incomplete.
    pub fn cut_short(self) -> Option<String> {
        self.cut_short.filter(|_| self.asked.is_some())
    }

    fn ended(&mut self, reason: Option<String>) {
        self.cut_short = self.cut_short.take().or(reason);
    }

    fn next(&mut self, settings: &RecorderSettings) -> Option<PathBuf> {
        self.begun += 1;
        match (&self.asked, self.begun) {
            (Some(asked), 1) => Some(asked.clone()),
            (Some(asked), n) => {
                let mut name = asked.as_os_str().to_owned();
                name.push(format!("-{n}"));
                Some(PathBuf::from(name))
            }
            (None, _) => settings.continuous.then(|| recorder::new_clip_folder(&settings.folder)),
        }
    }

    /// Returns the session's recorder, if anything may be recorded. A recording requested by name
    /// must work; others are optional.
    fn recorder(&mut self, session: &Session<'_>, camera: CameraMode, exposure_s: f64) -> Result<Option<Recorder>, Failure> {
        let settings = &session.settings.recorder;
        let clip = self.next(settings);
        let ring = (settings.ring_s > 0.0).then(|| (settings.folder.clone(), settings.ring_s));
        // With a server, someone may request a recording later.
        if clip.is_none() && ring.is_none() && session.settings.http.is_none() {
            return Ok(None);
        }
        session.supervisor.set_recording(clip.clone());
        let named = clip.clone().filter(|_| self.asked.is_some() && self.begun == 1);
        let about = AboutClip { camera, config: session.settings.source.clone(), exposure_s };
        let recorder = Recorder::start(RecorderPlan { clip, ring, about }, session.link, Box::<RealDisk>::default());
        match (recorder, named) {
            (Ok(recorder), _) => Ok(Some(recorder)),
            (Err(e), Some(clip)) => Err(Failure::output(&clip)(e)),
            (Err(e), None) => {
                session.link.statistics.set_recorder(RecorderState::Stopped);
                session.supervisor.set_recording(None);
                session.link.events.publish(Event::RecorderStopped { reason: unwritten(&e) });
                Ok(None)
            }
        }
    }
}
