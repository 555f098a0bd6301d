//! What outlives a session: the config file, what is wished for, and who has the camera.
//!
//! A session (a camera, a tracker and what listens, under one config) comes and goes; the HTTP server stays. It asks here for what it wants
//! (another config, a recording, the ring saved), and the session's loop takes the wishes up. Nobody waits for anybody.

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
    /// Nobody: it is closed, for whoever sets the stage up.
    Setup,
}

impl Mode {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Track, Self::Setup];

    /// Its word in the API.
    pub fn word(self) -> &'static str {
        match self {
            Self::Track => "track",
            Self::Setup => "setup",
        }
    }
}

/// What is wished of the recorder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordingWish {
    /// A new recording.
    Start,
    /// The end of it.
    Stop,
}

/// Tells what the outputs have done so far.
type OutputsWatch = Arc<dyn Fn() -> Vec<OutputStatistics> + Send + Sync>;

/// Between sessions and those that steer them.
pub struct Supervisor {
    /// Counts, events, the camera's pulse.
    pub link: LiveLink,
    /// What takes its time.
    pub jobs: Jobs,
    file: PathBuf,
    keeping: Keeping,
    settings: Mutex<Option<Arc<Settings>>>,
    refusal: Mutex<Option<String>>,
    outputs: Mutex<Option<OutputsWatch>>,
    recording: Mutex<Option<RecordingWish>>,
    /// Where the page is.
    page: Mutex<Option<SocketAddr>>,
    /// Size of the camera's pictures, while it is open.
    picture_size: Mutex<Option<(u32, u32)>>,
    /// What is recorded now.
    clip: Mutex<Option<PathBuf>>,
    save: AtomicBool,
    reload: AtomicBool,
    mode: AtomicU8,
    alone: Mutex<()>,
}

fn held<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Supervisor {
    /// Of the daemon with this config file.
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
            save: AtomicBool::new(false),
            reload: AtomicBool::new(false),
            mode: AtomicU8::new(Mode::Track as u8),
            alone: Mutex::default(),
        }
    }

    /// The config's file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Where the config and the set are changed.
    pub fn keeping(&self) -> &Keeping {
        &self.keeping
    }

    /// Held by who looks at the config or what lies beside it and then changes it, one after the other.
    pub fn alone(&self) -> MutexGuard<'_, ()> {
        held(&self.alone)
    }

    /// The config that is used, where there is one.
    pub fn settings(&self) -> Option<Arc<Settings>> {
        held(&self.settings).clone()
    }

    /// A session begins under this config; none where there is no good one.
    pub fn use_settings(&self, settings: Option<Settings>) {
        *held(&self.settings) = settings.map(Arc::new);
    }

    /// The config in the file was read, and is the one to be used.
    pub fn accept(&self) {
        *held(&self.refusal) = None;
    }

    /// Says why the config in the file is not used: it cannot be read, or cannot be run.
    pub fn refuse(&self, reason: String) {
        *held(&self.refusal) = Some(reason);
    }

    /// Why the config in the file is not used; none where it is.
    pub fn refusal(&self) -> Option<String> {
        held(&self.refusal).clone()
    }

    /// Where the page is; none where there is none.
    pub fn set_page(&self, address: Option<SocketAddr>) {
        *held(&self.page) = address;
    }

    /// The size of the camera's pictures; none when it is closed.
    pub fn set_picture_size(&self, size: Option<(u32, u32)>) {
        *held(&self.picture_size) = size;
    }

    /// Whether a config can be run on this machine in place of the one that is used now: what that one holds is free for it.
    ///
    /// # Errors
    /// The first thing that this machine does not give, or that does not fit the camera, with its place in the config.
    pub fn rehearse(&self, new: &Settings) -> Result<(), ConfigError> {
        let now = self.settings();
        let page = *held(&self.page);
        let listens: Vec<SocketAddr> = now.iter().flat_map(|now| now.listens()).chain(page).collect();
        new.rehearse_outputs_beside(&listens)?;
        let size = *held(&self.picture_size);
        match (size, now) {
            // Where the camera stays what it is, the calibration must fit it.
            (Some((width, height)), Some(now)) if now.device == new.device => new.camera_for(width, height).map(drop),
            _ => Ok(()),
        }
    }

    /// The session's outputs; none when it ends.
    pub fn watch_outputs(&self, watch: Option<OutputsWatch>) {
        *held(&self.outputs) = watch;
    }

    /// What the outputs have done so far; none where no session runs.
    pub fn outputs(&self) -> Vec<OutputStatistics> {
        // Not under the lock: it asks the outputs.
        let watch = held(&self.outputs).clone();
        watch.map_or_else(Vec::new, |watch| watch())
    }

    /// Wishes for the ring to be saved.
    pub fn save_ring(&self) {
        self.save.store(true, Ordering::Relaxed);
    }

    /// Takes that wish.
    pub fn take_save(&self) -> bool {
        self.save.swap(false, Ordering::Relaxed)
    }

    /// Wishes for the config to be read again.
    pub fn reload(&self) {
        self.reload.store(true, Ordering::Relaxed);
    }

    /// Takes that wish.
    pub fn take_reload(&self) -> bool {
        self.reload.swap(false, Ordering::Relaxed)
    }

    /// Wishes for a recording, or its end.
    pub fn record(&self, wish: RecordingWish) {
        *held(&self.recording) = Some(wish);
    }

    /// Takes that wish.
    pub fn take_recording(&self) -> Option<RecordingWish> {
        held(&self.recording).take()
    }

    /// What is recorded now.
    pub fn recording(&self) -> Option<PathBuf> {
        held(&self.clip).clone()
    }

    /// Says what is recorded now.
    pub fn set_recording(&self, clip: Option<PathBuf>) {
        *held(&self.clip) = clip;
    }

    /// Who has the camera.
    pub fn mode(&self) -> Mode {
        Mode::ALL.into_iter().find(|mode| *mode as u8 == self.mode.load(Ordering::Relaxed)).unwrap_or(Mode::Track)
    }

    /// Lends the camera; the session that has it ends soon.
    pub fn set_mode(&self, mode: Mode) {
        self.mode.store(mode as u8, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wish_is_taken_once_and_the_last_one_of_a_kind_counts() {
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
