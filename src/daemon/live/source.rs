//! The capture stage of a live daemon: takes the newest picture, decodes it, and supervises the
//! reader.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError};

use super::patience::Patience;
use super::reader::{Arrived, Shared, Ticket, read};
use super::{Event, LiveLink};
use crate::camera::Shutter;
use crate::capture::camera::{CameraMode, CameraOpener, PixelLayout};
use crate::capture::repeats::Repeats;
use crate::capture::{ClipEntry, FrameSource, Received, decode_picture};
use crate::drop_oldest::drop_oldest;

/// Maximum number of abandoned readers; after that the daemon only waits for one of them. Chosen,
/// not tuned. Raised, a driver that hangs forever holds more threads.
const MAX_READERS: usize = 8;
/// Interval of checks on the reader. Chosen: well below a frame time of slow cameras. Raised, a
/// lost camera is noticed later; lowered, waiting takes processor time.
const TICK: Duration = Duration::from_millis(20);

/// A live camera as a source of rows. It ends when it is stopped, or when a played clip does.
pub struct LiveSource {
    shared: Arc<Shared>,
    pictures: Receiver<Arrived>,
    reader: Arc<Ticket>,
    left_behind: Vec<Arc<Ticket>>,
    nudged: bool,
    next_sequence: u64,
    repeats: Repeats,
}

/// Stops a [`LiveSource`] from elsewhere.
#[derive(Clone)]
pub struct LiveStop(Arc<Shared>);

impl LiveStop {
    /// Makes the source end at its next check.
    pub fn stop(&self) {
        self.0.stop.store(true, Ordering::Release);
    }
}

impl LiveSource {
    /// Starts to open and read the camera.
    pub fn start(opener: Arc<dyn CameraOpener>, shutter: Shutter, patience: Patience, link: LiveLink) -> Self {
        Self::start_late(opener, shutter, Duration::ZERO, patience, link)
    }

    /// Like [`start`](Self::start), for a camera whose pictures are stamped `latency` late.
    pub fn start_late(opener: Arc<dyn CameraOpener>, shutter: Shutter, latency: Duration, patience: Patience, link: LiveLink) -> Self {
        let (stop, is_read, has_reported_unstamped) = (Arc::default(), false.into(), false.into());
        let shared =
            Shared { opener, shutter, latency, patience, link, stop, first_mode: Mutex::new(None), is_read, has_reported_unstamped };
        let shared = Arc::new(shared);
        let (pictures, reader) = spawn(&shared);
        Self { shared, pictures, reader, left_behind: Vec::new(), nudged: false, next_sequence: 0, repeats: Repeats::default() }
    }

    /// Waits until the camera has been opened for the first time, and returns its mode; supervises
    /// the reader meanwhile. Returns `None` when `give_up` returns true.
    pub fn wait_for_camera(&mut self, mut give_up: impl FnMut() -> bool) -> Option<CameraMode> {
        loop {
            if let Some(mode) = self.shared.first_mode.lock().unwrap_or_else(PoisonError::into_inner).clone() {
                return Some(mode);
            }
            if give_up() || self.shared.stop.load(Ordering::Relaxed) {
                return None;
            }
            std::thread::sleep(TICK);
            self.look_after_reader();
        }
    }

    /// Returns a switch that stops it.
    pub fn stopper(&self) -> LiveStop {
        LiveStop(self.shared.clone())
    }

    /// Returns the switch behind [`stopper`](Self::stopper). The daemon shares it, so stopping one
    /// stops the other.
    pub(in crate::daemon) fn stop_switch(&self) -> Arc<AtomicBool> {
        self.shared.stop.clone()
    }

    /// Returns the state that it shares with the other stages.
    pub fn link(&self) -> LiveLink {
        self.shared.link.clone()
    }

    fn row(&mut self, arrived: Arrived) -> ClipEntry {
        let Arrived { picture, mode, timestamp } = arrived;
        let begun = Instant::now();
        let decoded = decode_picture(&picture, mode.layout, mode.size);
        let decode = begun.elapsed();
        let sequence = self.next_sequence;
        self.next_sequence += 1;
        let (content, received) = decoded.content(mode.size, timestamp, sequence);
        let repeats = match &received {
            // The capture buffer may have other stale bytes after the same picture.
            Received::Jpeg(jpeg) => self.repeats.is_repeat(jpeg.to_vec()),
            // Grey pictures may come from a played clip, whose video repeats them while nothing
            // moves.
            Received::Raw if mode.layout != PixelLayout::Grey => self.repeats.is_repeat(picture.bytes),
            _ => false,
        };
        ClipEntry { sequence, timestamp, content, decode, repeats, received: Some(received) }
    }

    /// Replaces a reader that ended or stays blocked; a blocked one is interrupted first.
    fn look_after_reader(&mut self) {
        // The thread holds the other handle: without it, the thread has ended or was never created.
        if Arc::strong_count(&self.reader) == 1 {
            if !self.reader.ended.load(Ordering::Relaxed) {
                std::thread::sleep(self.shared.patience.between_openings);
                self.replace_reader();
            }
            return;
        }
        let (blocked, limit) = (self.reader.blocked_for(), self.shared.patience.blocked);
        if blocked < limit {
            self.nudged = false;
        } else if blocked >= 2 * limit {
            self.left_behind.retain(|r| r.is_running());
            if self.left_behind.len() >= MAX_READERS {
                return;
            }
            let reason = format!("its driver has not answered for {:.1} s; trying again in parallel", blocked.as_secs_f64());
            self.shared.link.statistics.camera_lost();
            self.shared.link.events.publish(Event::CameraLost { reason });
            self.replace_reader();
        } else if !self.nudged {
            self.nudged = true;
            self.reader.nudge();
        }
    }

    fn replace_reader(&mut self) {
        self.reader.wanted.store(false, Ordering::Relaxed);
        let (pictures, reader) = spawn(&self.shared);
        self.pictures = pictures;
        let before = std::mem::replace(&mut self.reader, reader);
        self.left_behind.retain(|r| r.is_running());
        if before.is_running() {
            self.left_behind.push(before);
        }
    }
}

/// Starts a reader and returns its channel. If the system provides no thread, the channel is closed
/// and the next check tries again.
fn spawn(shared: &Arc<Shared>) -> (Receiver<Arrived>, Arc<Ticket>) {
    let (to, pictures) = drop_oldest(1);
    let ticket = Arc::new(Ticket::new());
    let (shared, own) = (shared.clone(), ticket.clone());
    let started = std::thread::Builder::new().name("camera".to_owned()).spawn(move || read(&shared, &own, &to));
    if let Err(e) = started {
        tracing::error!("cannot start the camera thread: {e}; close other programs or raise the limit of processes");
    }
    (pictures, ticket)
}

impl FrameSource for LiveSource {
    fn next_entry(&mut self) -> Option<ClipEntry> {
        self.shared.is_read.store(true, Ordering::Relaxed);
        while !self.shared.stop.load(Ordering::Relaxed) {
            match self.pictures.recv_timeout(TICK) {
                Ok(arrived) => return Some(self.row(arrived)),
                Err(RecvTimeoutError::Timeout) => self.look_after_reader(),
                Err(RecvTimeoutError::Disconnected) if self.reader.ended.load(Ordering::Relaxed) => return None,
                Err(RecvTimeoutError::Disconnected) => {
                    // The reader is about to end.
                    std::thread::sleep(Duration::from_millis(1));
                    self.look_after_reader();
                }
            }
        }
        None
    }

    fn size(&self) -> (u32, u32) {
        self.shared.first_mode.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map_or((0, 0), |mode| mode.size)
    }

    fn rows(&self) -> Option<u64> {
        None
    }
}

impl Drop for LiveSource {
    /// Lets the reader close its camera, for at most a second.
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        let begun = Instant::now();
        while self.reader.is_running() && begun.elapsed() < Duration::from_secs(1) {
            std::thread::sleep(Duration::from_millis(2));
            if begun.elapsed() > Duration::from_millis(300) {
                self.reader.nudge();
            }
        }
    }
}
