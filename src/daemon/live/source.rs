//! The capture stage of a live daemon: takes the newest picture, decodes it, and looks after the reader.

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

/// Readers that may be left behind before the daemon only waits for one of them. Chosen, not tuned. Raised, a driver that hangs for good
/// holds more threads.
const MOST_READERS: usize = 8;
/// How often the reader is looked after. Chosen: well below a frame time of slow cameras. Raised, a lost camera is noticed later; lowered,
/// waiting takes processor time.
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
    /// The source ends at its next look.
    pub fn stop(&self) {
        self.0.stop.store(true, Ordering::Release);
    }
}

impl LiveSource {
    /// Starts to open the camera and to read it.
    pub fn start(opener: Arc<dyn CameraOpener>, shutter: Shutter, patience: Patience, link: LiveLink) -> Self {
        let (stop, is_read, unstamped_said) = (Arc::default(), false.into(), false.into());
        let shared = Shared { opener, shutter, patience, link, stop, first_mode: Mutex::new(None), is_read, unstamped_said };
        let shared = Arc::new(shared);
        let (pictures, reader) = spawn(&shared);
        Self { shared, pictures, reader, left_behind: Vec::new(), nudged: false, next_sequence: 0, repeats: Repeats::default() }
    }

    /// What the camera delivers, once it has been opened for the first time; looks after the reader meanwhile.
    /// `None` when `give_up` says so.
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

    /// A switch that ends it.
    pub fn stopper(&self) -> LiveStop {
        LiveStop(self.shared.clone())
    }

    /// The switch behind [`stopper`](Self::stopper), which the daemon makes its own: what stops one stops the other.
    pub(in crate::daemon) fn stop_switch(&self) -> Arc<AtomicBool> {
        self.shared.stop.clone()
    }

    /// What it shares with the other stages.
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
            // A buffer may have other stale bytes behind the same picture.
            Received::Jpeg(jpeg) => self.repeats.is_repeat(jpeg.to_vec()),
            // Grey pictures may be those of a played clip, whose video repeats them where nothing
            // moves.
            Received::Raw if mode.layout != PixelLayout::Grey => self.repeats.is_repeat(picture.bytes),
            _ => false,
        };
        ClipEntry { sequence, timestamp, content, decode, repeats, received: Some(received) }
    }

    /// Puts another reader in the place of one that is gone or stays blocked; interrupts one that is blocked before that.
    fn look_after_reader(&mut self) {
        // The thread holds the other handle: without it, it has ended, or the system gave none.
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
            if self.left_behind.len() >= MOST_READERS {
                return;
            }
            let reason = format!("its driver has not answered for {:.1} s; another try is made beside it", blocked.as_secs_f64());
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

/// A reader and its channel. Where the system gives no thread, the channel is closed and the next look tries again.
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
                    // It is about to end.
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
    /// Lets the reader close its camera, for a second at most.
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
