//! The capture stage of a live daemon: takes the newest picture, decodes it, and looks after the reader.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError};

use super::reader::{Arrived, Shared, Ticket, read};
use super::{Event, LiveLink};
use crate::capture::camera::{CameraMode, CameraOpener};
use crate::capture::{FrameSource, Row, decode_picture};
use crate::drop_oldest::drop_oldest;

/// The camera's shutter, seconds; 0 where unknown.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Shutter {
    /// Exposure of a row; 0: as the camera says it, where it does.
    pub exposure_s: f64,
    /// First row to last.
    pub readout_s: f64,
}

/// Longest exposure that is believed, seconds: the range of `exposure_s` in a config.
const LONGEST_EXPOSURE_S: f64 = 1.0;
/// Two exposures are equal within this much, seconds (drivers count in units of 0.1 ms), and within this share of the longer.
const SAME_EXPOSURE_S: f64 = 1.5e-4;
const SAME_EXPOSURE_SHARE: f64 = 0.02;

impl Shutter {
    /// The exposure to stamp and to track with: as set here, else as the camera has it locked; 0 where neither is known.
    pub fn exposure_of(&self, mode: &CameraMode) -> f64 {
        if self.exposure_s > 0.0 { self.exposure_s } else { locked(mode).unwrap_or(0.0) }
    }

    /// What is to be said where the exposure that poses rest on is not the one that the camera has locked now; `first` is
    /// the mode that the tracker was made for.
    pub fn contradiction(&self, first: &CameraMode, now: &CameraMode) -> Option<String> {
        let (used, real) = (self.exposure_of(first), locked(now).unwrap_or(0.0));
        let (used_ms, real_ms) = (used * 1e3, real * 1e3);
        if (used - real).abs() <= SAME_EXPOSURE_S.max(SAME_EXPOSURE_SHARE * used.max(real)) {
            None
        } else if self.exposure_s == 0.0 && used == 0.0 {
            Some(format!("its exposure is now locked at {real_ms:.1} ms, which the tracker was not told; send SIGHUP or start again"))
        } else if self.exposure_s == 0.0 && real == 0.0 {
            Some(format!("its exposure is not locked any more, the tracker was told {used_ms:.1} ms; lock it in `controls`"))
        } else if self.exposure_s == 0.0 {
            Some(format!("its exposure is now {real_ms:.1} ms, the tracker was told {used_ms:.1} ms; send SIGHUP or start again"))
        } else if real > 0.0 {
            Some(format!(
                "its exposure is {real_ms:.1} ms, exposure_s in [camera] says {used_ms:.1} ms, which is used; make them equal or remove exposure_s"
            ))
        } else {
            None
        }
    }
}

/// The exposure that a camera has locked, where it can be true.
fn locked(mode: &CameraMode) -> Option<f64> {
    mode.exposure_s.filter(|s| *s > 0.0 && *s <= LONGEST_EXPOSURE_S)
}

/// How long the pipeline bears what.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Patience {
    /// One wait for a picture.
    pub read: Duration,
    /// No picture at all, before the camera is opened again (and 15 frame times at least).
    pub silence: Duration,
    /// A call that does not come back, before it is interrupted; twice this, before it is left behind.
    pub blocked: Duration,
    /// Between two tries to open.
    pub between_openings: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        let ms = Duration::from_millis;
        Self { read: ms(100), silence: ms(1500), blocked: ms(3000), between_openings: ms(300) }
    }
}

/// Readers that may be left behind before the daemon only waits for one of them.
const MOST_READERS: usize = 8;
/// How often the reader is looked after.
const TICK: Duration = Duration::from_millis(20);

/// A live camera as a source of rows. It ends when it is stopped, or when a played clip does.
pub struct LiveSource {
    shared: Arc<Shared>,
    pictures: Receiver<Arrived>,
    reader: Arc<Ticket>,
    left_behind: Vec<Arc<Ticket>>,
    nudged: bool,
    next_sequence: u64,
}

/// Stops a [`LiveSource`] from elsewhere.
#[derive(Clone)]
pub struct LiveStop(Arc<Shared>);

impl LiveStop {
    /// The source ends at its next look.
    pub fn stop(&self) {
        self.0.stop.store(true, Ordering::Relaxed);
    }
}

impl LiveSource {
    /// Starts to open the camera and to read it.
    pub fn start(opener: Arc<dyn CameraOpener>, shutter: Shutter, patience: Patience, link: LiveLink) -> Self {
        let (stop, is_read, unstamped_said) = (Arc::default(), false.into(), false.into());
        let shared = Shared { opener, shutter, patience, link, stop, first_mode: Mutex::new(None), is_read, unstamped_said };
        let shared = Arc::new(shared);
        let (pictures, reader) = spawn(&shared);
        Self { shared, pictures, reader, left_behind: Vec::new(), nudged: false, next_sequence: 0 }
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

    fn row(&mut self, arrived: Arrived) -> Row {
        let Arrived { picture, mode, timestamp_ns } = arrived;
        let begun = Instant::now();
        let decoded = decode_picture(&picture, mode.layout, mode.size);
        let decode = begun.elapsed();
        let sequence = self.next_sequence;
        self.next_sequence += 1;
        let (content, received) = decoded.content(mode.size, timestamp_ns, sequence);
        Row { sequence, timestamp_ns, content, decode, received: Some(received) }
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
    fn next_row(&mut self) -> Option<Row> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::camera::PixelLayout;

    fn mode(exposure_s: Option<f64>) -> CameraMode {
        let (name, notes, controls) = ("Cam".to_owned(), vec![], vec![]);
        CameraMode { name, size: (8, 6), layout: PixelLayout::Grey, fps: 30.0, exposure_s, controls, notes }
    }

    #[test]
    fn the_cameras_locked_exposure_counts_where_none_is_set() {
        let (set, unset) = (Shutter { exposure_s: 0.01, readout_s: 0.0 }, Shutter::default());
        assert_eq!(unset.exposure_of(&mode(Some(0.0083))), 0.0083);
        assert_eq!(set.exposure_of(&mode(Some(0.0083))), 0.01);
        for impossible in [None, Some(0.0), Some(-1.0), Some(f64::NAN), Some(204.7)] {
            assert_eq!(unset.exposure_of(&mode(impossible)), 0.0, "{impossible:?}");
        }
    }

    #[test]
    fn exposures_that_contradict_each_other_are_said() {
        let (set, unset) = (Shutter { exposure_s: 0.01, readout_s: 0.0 }, Shutter::default());
        let said = |shutter: Shutter, first: Option<f64>, now: Option<f64>| shutter.contradiction(&mode(first), &mode(now));
        assert_eq!(said(unset, Some(0.01), Some(0.01)), None);
        assert_eq!(said(unset, None, None), None);
        assert_eq!(said(set, None, None), None, "an automatic exposure is warned of elsewhere");
        assert_eq!(said(set, Some(0.0101), Some(0.0101)), None, "within the driver's unit");
        assert!(said(set, Some(0.02), Some(0.02)).unwrap().starts_with("its exposure is 20.0 ms, exposure_s in [camera] says 10.0 ms"));
        assert!(said(unset, Some(0.01), Some(0.02)).unwrap().contains("now 20.0 ms, the tracker was told 10.0 ms"));
        assert!(said(unset, Some(0.01), None).unwrap().contains("not locked any more"));
        assert!(said(unset, None, Some(0.01)).unwrap().contains("now locked at 10.0 ms"));
    }
}
