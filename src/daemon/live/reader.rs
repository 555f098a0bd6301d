//! The thread that owns the camera: opens it, reads it, gives it up, reopens it.
//!
//! Only this thread can be blocked by a driver. Its beats tell the capture stage that it is alive.
//! A signal interrupts most blocking calls (reads return "interrupted"); a thread that stays
//! blocked is abandoned.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::{Arc, Mutex, Once, PoisonError};
use std::time::{Duration, Instant};

use nix::libc;
use nix::sys::signal::{SaFlags, SigAction, SigHandler, SigSet, Signal, sigaction};

use super::patience::Patience;
use super::shutter::{contradiction, exposure_of};
use super::{Event, LiveLink};
use crate::camera::Shutter;
use crate::capture::camera::{Camera, CameraFault, CameraMode, CameraOpener, CapturedPicture};
use crate::capture::timestamping::{StampTrust, monotonic_now};
use crate::drop_oldest::DropOldestSender;
use crate::frame::Timestamp;

/// A picture on its way to the capture stage.
pub(super) struct Arrived {
    pub picture: CapturedPicture,
    pub mode: Arc<CameraMode>,
    pub timestamp: Timestamp,
}

/// State shared by readers and their source; it outlives abandoned readers.
pub(super) struct Shared {
    pub opener: Arc<dyn CameraOpener>,
    pub shutter: Shutter,
    /// How late the camera's pictures are stamped.
    pub latency: Duration,
    pub patience: Patience,
    pub link: LiveLink,
    pub stop: Arc<AtomicBool>,
    /// The mode of the first opening: later ones must have its size.
    pub first_mode: Mutex<Option<CameraMode>>,
    /// Set once rows are being taken; pictures before that do not count as dropped.
    pub is_read: AtomicBool,
    /// Set once the missing driver stamps have been reported.
    pub has_reported_unstamped: AtomicBool,
}

/// One reader's own state.
pub(super) struct Ticket {
    /// Cleared when it is no longer wanted.
    pub wanted: AtomicBool,
    /// When it was last seen unblocked, nanoseconds on the monotonic clock.
    beat_ns: AtomicI64,
    /// Set if its camera has no more pictures (a played clip).
    pub ended: AtomicBool,
    /// Its thread, while it runs.
    thread: Mutex<Option<libc::pthread_t>>,
}

impl Ticket {
    pub fn new() -> Self {
        let beat_ns = AtomicI64::new(monotonic_now().ns());
        Self { wanted: AtomicBool::new(true), beat_ns, ended: AtomicBool::new(false), thread: Mutex::new(None) }
    }

    fn beat(&self) {
        self.beat_ns.store(monotonic_now().ns(), Ordering::Relaxed);
    }

    /// Returns how long it has been blocked.
    pub fn blocked_for(&self) -> Duration {
        monotonic_now().duration_since(Timestamp::from_ns(self.beat_ns.load(Ordering::Relaxed)))
    }

    /// Interrupts the call it is blocked in.
    pub fn nudge(&self) {
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(thread) = *thread {
            // SAFETY: the thread clears its entry under this lock before it ends ([`OnThread`]), so
            // it is alive.
            unsafe { libc::pthread_kill(thread, libc::SIGURG) };
        }
    }

    pub fn is_running(&self) -> bool {
        self.thread.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    fn set_thread(&self, thread: Option<libc::pthread_t>) {
        *self.thread.lock().unwrap_or_else(PoisonError::into_inner) = thread;
    }
}

/// Keeps the calling thread's id in a ticket while the thread runs, however it ends. A stale id
/// could be another thread's by the time it is signalled.
struct OnThread<'a>(&'a Ticket);

impl<'a> OnThread<'a> {
    fn enter(ticket: &'a Ticket) -> Self {
        // SAFETY: it only reads the calling thread's id.
        ticket.set_thread(Some(unsafe { libc::pthread_self() }));
        Self(ticket)
    }
}

impl Drop for OnThread<'_> {
    fn drop(&mut self) {
        self.0.set_thread(None);
    }
}

/// Installs an empty handler, so that the nudging signal only interrupts.
fn take_signal() {
    extern "C" fn nothing(_: libc::c_int) {}
    /// Ensures that the handler is installed once per process.
    static TAKEN: Once = Once::new();
    TAKEN.call_once(|| {
        // No SA_RESTART: a blocked call must return.
        let action = SigAction::new(SigHandler::Handler(nothing), SaFlags::empty(), SigSet::empty());
        // SAFETY: the handler does nothing.
        let _ = unsafe { sigaction(Signal::SIGURG, &action) };
    });
}

/// Why reading a camera ended.
enum Loss {
    Unwanted,
    Ended,
    Gone(String),
}

/// The thread's main function.
pub(super) fn read(shared: &Shared, ticket: &Ticket, to: &DropOldestSender<Arrived>) {
    take_signal();
    let _here = OnThread::enter(ticket);
    // Driver panics are contained where the driver is called; this catches all others. The source
    // starts another reader.
    if catch_unwind(AssertUnwindSafe(|| open_and_stream(shared, ticket, to))).is_err() {
        shared.link.statistics.contained_panics.add(1);
        shared.link.statistics.camera_lost();
        let reason = "the thread that reads it failed; restarting it".to_owned();
        shared.link.events.publish(Event::CameraLost { reason });
    }
}

fn open_and_stream(shared: &Shared, ticket: &Ticket, to: &DropOldestSender<Arrived>) {
    let mut last_reason = None;
    while wanted(shared, ticket) {
        ticket.beat();
        match open(shared) {
            Ok((mut camera, mode)) => {
                last_reason = None;
                let loss = stream(shared, ticket, &mut *camera, mode, to);
                ticket.beat();
                close(shared, camera);
                shared.link.statistics.camera_lost();
                match loss {
                    Loss::Unwanted => break,
                    Loss::Ended => {
                        ticket.ended.store(true, Ordering::Relaxed);
                        break;
                    }
                    Loss::Gone(reason) => shared.link.events.publish(Event::CameraLost { reason }),
                }
            }
            Err(reason) if last_reason.as_ref() != Some(&reason) => {
                shared.link.events.publish(Event::CameraWaiting { reason: reason.clone() });
                last_reason = Some(reason);
            }
            Err(_) => {}
        }
        nap(shared, ticket, shared.patience.between_openings);
    }
}

fn wanted(shared: &Shared, ticket: &Ticket) -> bool {
    ticket.wanted.load(Ordering::Relaxed) && !shared.stop.load(Ordering::Relaxed)
}

fn nap(shared: &Shared, ticket: &Ticket, whole: Duration) {
    let begun = Instant::now();
    while begun.elapsed() < whole && wanted(shared, ticket) {
        ticket.beat();
        std::thread::sleep(Duration::from_millis(10).min(whole));
    }
}

/// Closes a camera; its driver's library may panic.
fn close(shared: &Shared, camera: Box<dyn Camera>) {
    if catch_unwind(AssertUnwindSafe(|| drop(camera))).is_err() {
        shared.link.statistics.contained_panics.add(1);
    }
}

fn open(shared: &Shared) -> Result<(Box<dyn Camera>, CameraMode), String> {
    let opened = catch_unwind(AssertUnwindSafe(|| shared.opener.open().map(|camera| (camera.mode().clone(), camera))));
    let opened = opened.map_err(|_| {
        shared.link.statistics.contained_panics.add(1);
        "the camera's driver failed while the camera was opened; unplug the camera and plug it in again".to_owned()
    })?;
    let (mode, camera) = opened.map_err(|fault| fault.to_string())?;
    let mut first = shared.first_mode.lock().unwrap_or_else(PoisonError::into_inner);
    let again = first.is_some();
    let before = first.get_or_insert_with(|| mode.clone()).clone();
    drop(first);
    if mode.size != before.size {
        close(shared, camera);
        let ((w, h), (before_w, before_h)) = (mode.size, before.size);
        return Err(format!(
            "{} now gives {w} x {h} pixels instead of {before_w} x {before_h}; set width and height in [camera]",
            mode.name
        ));
    }
    shared.link.pulse.set_rate(mode.fps);
    shared.link.statistics.camera_opened(&mode.name, again);
    let CameraMode { name, size: (width, height), layout, fps, exposure_s, controls, .. } = mode.clone();
    shared.link.events.publish(Event::CameraOpened {
        name,
        width,
        height,
        format: layout.fourcc().into(),
        fps,
        exposure_s,
        controls,
        again,
    });
    if let Some(reason) = contradiction(&shared.shutter, &before, &mode) {
        shared.link.events.publish(Event::ExposureDiffers { reason: format!("{}: {reason}", mode.name) });
    }
    Ok((camera, mode))
}

fn stream(shared: &Shared, ticket: &Ticket, camera: &mut dyn Camera, mode: CameraMode, to: &DropOldestSender<Arrived>) -> Loss {
    let mode = Arc::new(mode);
    let shutter = Shutter { exposure_s: exposure_of(&shared.shutter, &mode), ..shared.shutter };
    let silence = shared.patience.silence.max(Duration::from_secs_f64(15.0 / mode.fps.max(0.1)));
    let (mut last, mut last_sequence, mut trust) = (Instant::now(), None, StampTrust::late_by(shared.latency));
    while wanted(shared, ticket) {
        ticket.beat();
        let picture = match catch_unwind(AssertUnwindSafe(|| camera.next_picture(shared.patience.read))) {
            Ok(Ok(picture)) => picture,
            Ok(Err(CameraFault::Silent)) if last.elapsed() < silence => continue,
            Ok(Err(CameraFault::Silent)) => return Loss::Gone(format!("it gave no picture for {:.1} s", last.elapsed().as_secs_f64())),
            Ok(Err(CameraFault::Gone(reason))) => return Loss::Gone(reason),
            Ok(Err(CameraFault::End)) => return Loss::Ended,
            Err(_) => {
                shared.link.statistics.contained_panics.add(1);
                return Loss::Gone("the camera's driver failed while the camera was read".to_owned());
            }
        };
        last = Instant::now();
        let (timestamp, stamped) = trust.mid_exposure(picture.stamp, picture.arrival, &shutter);
        if !stamped && !shared.has_reported_unstamped.swap(true, Ordering::Relaxed) {
            shared.link.events.publish(Event::NoDriverStamp { name: mode.name.clone() });
        }
        if let (Some(before), Some(now)) = (last_sequence, picture.device_sequence) {
            let lost: u32 = u32::wrapping_sub(now, before).wrapping_sub(1);
            // A count that goes back has restarted; it does not mean four thousand million lost
            // frames.
            shared.link.statistics.device_dropped.add(if lost < 10_000 { lost.into() } else { 0 });
        }
        last_sequence = picture.device_sequence.or(last_sequence);
        shared.link.pulse.beat(picture.arrival, timestamp);
        let late = |late: Arrived| {
            if shared.is_read.load(Ordering::Relaxed) {
                dropped(&shared.link, late.timestamp);
            }
        };
        to.send_dropping(Arrived { picture, mode: mode.clone(), timestamp }, late);
    }
    Loss::Unwanted
}

/// Counts and reports a dropped frame.
pub(in crate::daemon) fn dropped(link: &LiveLink, timestamp: Timestamp) {
    link.statistics.dropped.add(1);
    link.events.publish(Event::FrameDropped { timestamp });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_panics_leaves_no_id_behind() {
        let ticket = Arc::new(Ticket::new());
        let own = ticket.clone();
        let (inside, entered) = crossbeam_channel::bounded::<()>(0);
        let reader = std::thread::spawn(move || {
            let _here = OnThread::enter(&own);
            let _ = entered.recv();
            // Quietly: a resumed panic runs no hook.
            std::panic::resume_unwind(Box::new("told to"));
        });
        while !ticket.is_running() {
            std::thread::yield_now();
        }
        drop(inside);
        assert!(reader.join().is_err());
        assert!(!ticket.is_running());
        // There is no thread to signal.
        ticket.nudge();
    }
}
