//! State that outlives a session: the config file, pending requests, and who has the camera.
//!
//! A session (a camera, a tracker and their listeners, under one config) comes and goes; the HTTP
//! server stays. The server posts requests here (another config, a recording, saving the ring), and
//! the session's loop takes them up. Neither waits for the other.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::jobs::Jobs;
use super::live::LiveLink;
use super::own_folders::Keeping;
use crate::config::{ConfigError, Settings};
use crate::publish::OutputStatistics;

/// Who has the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// The tracker.
    Track,
    /// Nobody: it is closed while someone sets the stage up.
    Setup,
}

impl Mode {
    /// All modes.
    pub const ALL: [Self; 2] = [Self::Track, Self::Setup];

    /// Returns its word in the API.
    pub fn word(self) -> &'static str {
        match self {
            Self::Track => "track",
            Self::Setup => "setup",
        }
    }
}

/// A request to the recorder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordingWish {
    /// Start a new recording.
    Start,
    /// Stop the recording.
    Stop,
}

/// Returns the outputs' statistics.
type OutputsWatch = Arc<dyn Fn() -> Vec<OutputStatistics> + Send + Sync>;

/// Connects sessions with those that control them.
pub struct Supervisor {
    /// Counts, events, the camera's pulse.
    pub link: LiveLink,
    /// Long-running jobs.
    pub jobs: Jobs,
    file: PathBuf,
    keeping: Keeping,
    settings: Mutex<Option<Arc<Settings>>>,
    refusal: Mutex<Option<String>>,
    outputs: Mutex<Option<OutputsWatch>>,
    recording: Mutex<Option<RecordingWish>>,
    /// The page's address.
    page: Mutex<Option<SocketAddr>>,
    /// Size of the camera's pictures, while it is open.
    picture_size: Mutex<Option<(u32, u32)>>,
    /// The current recording.
    clip: Mutex<Option<PathBuf>>,
    /// The clip that is played in place of a camera.
    played: Mutex<Option<PathBuf>>,
    /// The camera to show while nothing is tracked.
    previewed: Mutex<Option<String>>,
    /// The program whose commands the page may ask for.
    program: Mutex<Option<PathBuf>>,
    save: AtomicBool,
    reload: AtomicBool,
    mode: AtomicU8,
    alone: Mutex<()>,
}

fn held<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Supervisor {
    /// Returns the supervisor for a daemon with this config file.
    pub fn new(file: &Path, link: LiveLink) -> Self {
        Self {
            link,
            jobs: Jobs::default(),
            file: file.to_owned(),
            keeping: Keeping::of(file),
            settings: Mutex::default(),
            refusal: Mutex::default(),
            outputs: Mutex::default(),
            recording: Mutex::default(),
            page: Mutex::default(),
            picture_size: Mutex::default(),
            clip: Mutex::default(),
            played: Mutex::default(),
            previewed: Mutex::default(),
            program: Mutex::default(),
            save: AtomicBool::new(false),
            reload: AtomicBool::new(false),
            mode: AtomicU8::new(Mode::Track as u8),
            alone: Mutex::default(),
        }
    }

    /// Returns the config file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Returns where changes of the config and the set are stored.
    pub fn keeping(&self) -> &Keeping {
        &self.keeping
    }

    /// Locks out others that read and then change the config or the files next to it.
    pub fn alone(&self) -> MutexGuard<'_, ()> {
        held(&self.alone)
    }

    /// Returns the config in use, if any.
    pub fn settings(&self) -> Option<Arc<Settings>> {
        held(&self.settings).clone()
    }

    /// Sets the config of a new session; `None` if there is no valid one.
    pub fn use_settings(&self, settings: Option<Settings>) {
        *held(&self.settings) = settings.map(Arc::new);
    }

    /// Notes that the config in the file was read and will be used.
    pub fn accept(&self) {
        *held(&self.refusal) = None;
    }

    /// Notes why the config in the file is not used: it cannot be read, or cannot be run.
    pub fn refuse(&self, reason: String) {
        *held(&self.refusal) = Some(reason);
    }

    /// Returns why the config in the file is not used; `None` if it is.
    pub fn refusal(&self) -> Option<String> {
        held(&self.refusal).clone()
    }

    /// Returns the page's address; `None` without a page.
    pub fn page(&self) -> Option<SocketAddr> {
        *held(&self.page)
    }

    /// Sets the clip that is played in place of a camera.
    pub fn set_played(&self, clip: Option<PathBuf>) {
        *held(&self.played) = clip;
    }

    /// Returns the clip that is played in place of a camera, if any.
    pub fn played(&self) -> Option<PathBuf> {
        held(&self.played).clone()
    }

    /// Requests the picture of this camera while nothing is tracked; `None` closes it.
    pub fn preview(&self, device: Option<String>) {
        *held(&self.previewed) = device;
    }

    /// Returns the camera to show while nothing is tracked.
    pub fn previewed(&self) -> Option<String> {
        held(&self.previewed).clone()
    }

    /// Sets the program whose commands (`survey`, `check` …) the page may ask for.
    pub fn set_program(&self, program: Option<PathBuf>) {
        *held(&self.program) = program;
    }

    /// Returns the program whose commands the page may ask for, if any.
    pub fn program(&self) -> Option<PathBuf> {
        held(&self.program).clone()
    }

    /// Sets the page's address; `None` without a page.
    pub fn set_page(&self, address: Option<SocketAddr>) {
        *held(&self.page) = address;
    }

    /// Sets the size of the camera's pictures; `None` when it is closed.
    pub fn set_picture_size(&self, size: Option<(u32, u32)>) {
        *held(&self.picture_size) = size;
    }

    /// Checks whether a config can be run on this machine in place of the current one, ignoring
    /// what the current one holds.
    ///
    /// # Errors
    /// The first thing that is not available on this machine, or does not fit the camera, with its
    /// place in the config.
    pub fn rehearse(&self, new: &Settings) -> Result<(), ConfigError> {
        let now = self.settings();
        let page = *held(&self.page);
        let listens: Vec<SocketAddr> = now.iter().flat_map(|now| now.listens()).chain(page).collect();
        new.rehearse_outputs_beside(&listens)?;
        let size = *held(&self.picture_size);
        match (size, now) {
            // If the camera stays the same, the calibration must fit it.
            (Some((width, height)), Some(now)) if now.device == new.device => new.camera_for(width, height).map(drop),
            _ => Ok(()),
        }
    }

    /// Sets the session's outputs; `None` when it ends.
    pub fn watch_outputs(&self, watch: Option<OutputsWatch>) {
        *held(&self.outputs) = watch;
    }

    /// Returns the outputs' statistics; empty if no session runs.
    pub fn outputs(&self) -> Vec<OutputStatistics> {
        // Do not hold the lock: this queries the outputs.
        let watch = held(&self.outputs).clone();
        watch.map_or_else(Vec::new, |watch| watch())
    }

    /// Requests that the ring be saved.
    pub fn save_ring(&self) {
        self.save.store(true, Ordering::Relaxed);
    }

    /// Takes that request.
    pub fn take_save(&self) -> bool {
        self.save.swap(false, Ordering::Relaxed)
    }

    /// Requests that the config be reloaded.
    pub fn reload(&self) {
        self.reload.store(true, Ordering::Relaxed);
    }

    /// Takes that request.
    pub fn take_reload(&self) -> bool {
        self.reload.swap(false, Ordering::Relaxed)
    }

    /// Requests a recording, or its end.
    pub fn record(&self, wish: RecordingWish) {
        *held(&self.recording) = Some(wish);
    }

    /// Takes that request.
    pub fn take_recording(&self) -> Option<RecordingWish> {
        held(&self.recording).take()
    }

    /// Returns the current recording.
    pub fn recording(&self) -> Option<PathBuf> {
        held(&self.clip).clone()
    }

    /// Sets the current recording.
    pub fn set_recording(&self, clip: Option<PathBuf>) {
        *held(&self.clip) = clip;
    }

    /// Returns who has the camera.
    pub fn mode(&self) -> Mode {
        Mode::ALL.into_iter().find(|mode| *mode as u8 == self.mode.load(Ordering::Relaxed)).unwrap_or(Mode::Track)
    }

    /// Sets who has the camera; a session that has it ends soon.
    pub fn set_mode(&self, mode: Mode) {
        self.mode.store(mode as u8, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_taken_once_and_the_last_one_wins() {
        let supervisor = Supervisor::new(Path::new("stage.toml"), LiveLink::default());
        supervisor.save_ring();
        supervisor.reload();
        supervisor.record(RecordingWish::Start);
        supervisor.record(RecordingWish::Stop);
        assert!(supervisor.take_save() && supervisor.take_reload());
        assert_eq!(supervisor.take_recording(), Some(RecordingWish::Stop));
        assert!(!supervisor.take_save() && !supervisor.take_reload() && supervisor.take_recording().is_none());
        for mode in Mode::ALL {
            supervisor.set_mode(mode);
            assert_eq!(supervisor.mode(), mode);
        }
        assert!(supervisor.outputs().is_empty() && supervisor.settings().is_none());
    }
}
