//! Another tracker beside this one, live: hears its packets on the port of `[other_tracker]`, on a
//! thread of its own, and compares the last minute of both on another.
//!
//! Packets are stamped with their arrival, on the clock of the camera's stamps. The other's delay
//! is measured from the turn rates of both, so nobody needs to know it.

mod watch;

use std::io;
use std::net::UdpSocket;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::live::LiveLink;
use super::priority::stand_back;
use crate::capture::timestamping::monotonic_now;
use crate::config::OtherTrackerSettings;
use crate::delay::log::LoggedPose;
use crate::other_tracker::{Beside, Comparison, Heard, Unalignable};
use crate::publish::{HeardRings, Rings, udp_listener};
use crate::record::{PoseSample, State};
use watch::OtherTrackerWatch;

/// Maximum bytes of a packet that is read: a UDP datagram's.
const MAX_PACKET: usize = 65_536;
/// Maximum wait for a packet. Raised, the daemon ends later.
const WAIT: Duration = Duration::from_millis(100);
/// Interval between attempts to open the port. Raised, a port that becomes free is taken later.
const AGAIN_EVERY: Duration = Duration::from_secs(1);
/// Interval between comparisons. Chosen: they take a tenth of a second, on a thread that stands
/// back. Raised, differences are reported later.
const COMPARE_EVERY: Duration = Duration::from_secs(5);
/// Minimum interval between two looks at the state. Chosen: below what a person notices. Raised,
/// changes are reported later.
const LOOK_EVERY: Duration = Duration::from_millis(200);

/// Hears another tracker until it is dropped.
#[derive(Debug)]
pub struct OtherTrackerReader {
    settings: OtherTrackerSettings,
    shared: Arc<Shared>,
    rings: Arc<HeardRings>,
    watch: Mutex<(OtherTrackerWatch, Option<Instant>)>,
    threads: Vec<JoinHandle<()>>,
}

/// What the threads share.
#[derive(Debug)]
struct Shared {
    known: Mutex<Known>,
    stop: AtomicBool,
}

/// What is known of the other tracker.
#[derive(Debug)]
struct Known {
    heard: Heard,
    beside: Beside,
    /// The last comparison; `None` before the first.
    compared: Option<Result<Comparison, Unalignable>>,
    /// Why the port cannot be opened.
    trouble: Option<String>,
}

impl Shared {
    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Waits, but not beyond the stop.
    fn pause(&self, duration: Duration) {
        let until = Instant::now() + duration;
        while let Some(left) = until.checked_duration_since(Instant::now()).filter(|_| !self.is_stopped()) {
            std::thread::sleep(left.min(WAIT));
        }
    }
}

impl OtherTrackerReader {
    /// Starts to hear and to compare.
    ///
    /// # Errors
    /// The system provides no thread.
    pub fn start(settings: OtherTrackerSettings) -> io::Result<Self> {
        let heard = Heard::new(settings.spoken.clone(), settings.zoom_range);
        let known = Known { heard, beside: Beside::default(), compared: None, trouble: None };
        let shared = Arc::new(Shared { known: Mutex::new(known), stop: AtomicBool::new(false) });
        let rings: Arc<HeardRings> = Arc::default();
        let mut reader =
            Self { settings: settings.clone(), shared: shared.clone(), rings: rings.clone(), watch: Mutex::default(), threads: Vec::new() };
        let named = |name: &str| std::thread::Builder::new().name(name.to_owned());
        reader.threads.push(named("other tracker").spawn(move || hear(&settings, &shared, &rings))?);
        let shared = reader.shared.clone();
        reader.threads.push(named("comparison").spawn(move || compare(&shared))?);
        Ok(reader)
    }

    /// Returns zoom and focus of its packets, for outputs.
    pub fn rings(&self) -> &Arc<HeardRings> {
        &self.rings
    }

    /// Returns what it was started with.
    pub fn settings(&self) -> &OtherTrackerSettings {
        &self.settings
    }

    /// Takes a sample of ours; only a measured pose counts, before any filter.
    pub fn ours(&self, sample: &PoseSample) {
        let measured = sample.measurement.as_ref().filter(|_| sample.state == State::Tracking);
        if let Some(measured) = measured {
            let (rotation, position) = (measured.pose.rotation, measured.pose.translation);
            self.shared.known().beside.add_ours(LoggedPose { at: sample.timestamp, rotation, position });
        }
    }

    /// Publishes what has changed by now; to be called several times a second.
    pub fn look(&self, link: &LiveLink) {
        let mut watch = self.watch.lock().unwrap_or_else(PoisonError::into_inner);
        if watch.1.is_some_and(|looked| looked.elapsed() < LOOK_EVERY) {
            return;
        }
        watch.1 = Some(Instant::now());
        let known = self.shared.known();
        watch.0.look(&known, &self.settings, monotonic_now(), link);
    }
}

impl Drop for OtherTrackerReader {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        // They look for that several times a second.
        self.threads.drain(..).for_each(|thread| drop(thread.join()));
    }
}

/// Hears packets until the stop; a port that is taken is tried again.
fn hear(settings: &OtherTrackerSettings, shared: &Shared, rings: &HeardRings) {
    while !shared.is_stopped() {
        let opened = udp_listener(settings.listen, settings.interface.as_ref()).map(UdpSocket::from);
        match opened.and_then(|socket| socket.set_read_timeout(Some(WAIT)).map(|()| socket)) {
            Ok(socket) => {
                shared.known().trouble = None;
                follow(&socket, shared, rings);
            }
            Err(error) => {
                shared.known().trouble = Some(error.to_string());
                shared.pause(AGAIN_EVERY);
            }
        }
    }
}

fn follow(socket: &UdpSocket, shared: &Shared, rings: &HeardRings) {
    let mut buffer = vec![0; MAX_PACKET];
    while !shared.is_stopped() {
        // A timeout lets the stop through; an error with one packet is not the end.
        let Ok((length, _)) = socket.recv_from(&mut buffer) else { continue };
        let (at, mut known) = (monotonic_now(), shared.known());
        if let Some(row) = known.heard.packet(&buffer[..length], at) {
            known.beside.add_others(row);
        }
        let [zoom, focus] = known.heard.rings();
        rings.set(Rings { zoom, focus });
    }
}

/// Compares until the stop, on what was heard so far.
fn compare(shared: &Shared) {
    stand_back();
    while !shared.is_stopped() {
        shared.pause(COMPARE_EVERY);
        let beside = shared.known().beside.clone();
        let compared = beside.compare();
        shared.known().compared = Some(compared);
    }
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
