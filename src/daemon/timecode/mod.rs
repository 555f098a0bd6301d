//! Timecode while a camera runs: reads the sound of `[timecode]` on its own thread and puts the
//! decoded frames on the clock of the camera's stamps.
//!
//! The sound may be missing, end and come again; what is known meanwhile is the track's business
//! ([`crate::timecode::TimecodeTrack`]).

mod arrival;
mod input;
#[cfg(feature = "sound-card")]
mod sound_card;
mod watch;

use std::io::{self, Read};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::live::{Event, LiveLink};
use crate::capture::timestamping::monotonic_now;
use crate::config::{TimecodeInput, TimecodeSettings};
use crate::timecode::{LtcDecoder, LtcFrame, Sound, SoundError, TimecodeMark, TimecodeSource, TimecodeTrack};
use arrival::Arrival;
use input::Input;
#[cfg(feature = "sound-card")]
use sound_card::SoundCard;
use watch::TimecodeWatch;

/// Interval between attempts to open a missing sound. Chosen short enough that nobody notices it.
/// Raised, a sound that appears is heard later.
const AGAIN_EVERY: Duration = Duration::from_millis(500);

/// Reads timecode until it is dropped.
#[derive(Debug)]
pub struct TimecodeReader {
    settings: TimecodeSettings,
    watch: Mutex<TimecodeWatch>,
    source: Arc<TimecodeSource>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl TimecodeReader {
    /// Starts to read, and shows the timecode in the statistics.
    ///
    /// # Errors
    /// The system provides no thread.
    pub fn start(settings: TimecodeSettings, link: &LiveLink) -> io::Result<Self> {
        let source = Arc::new(TimecodeSource::live(TimecodeTrack::live(settings.track)));
        let stop = Arc::new(AtomicBool::new(false));
        let ear = Ear { settings: settings.clone(), source: source.clone(), stop: stop.clone(), link: link.clone() };
        let thread = std::thread::Builder::new().name("timecode".to_owned()).spawn(move || ear.run())?;
        link.statistics.set_timecode(Some(source.clone()));
        Ok(Self { settings, watch: Mutex::default(), source, stop, thread: Some(thread) })
    }

    /// Returns what it was started with.
    pub fn settings(&self) -> &TimecodeSettings {
        &self.settings
    }

    /// Publishes what has changed by now; to be called several times a second.
    pub fn look(&self, link: &LiveLink) {
        self.watch.lock().unwrap_or_else(PoisonError::into_inner).look(&self.source, monotonic_now(), link);
    }

    /// Returns the timecode of stamps.
    pub fn source(&self) -> &Arc<TimecodeSource> {
        &self.source
    }
}

impl Drop for TimecodeReader {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // It looks for that several times a second.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// The reading thread.
struct Ear {
    settings: TimecodeSettings,
    source: Arc<TimecodeSource>,
    stop: Arc<AtomicBool>,
    link: LiveLink,
}

impl Ear {
    fn run(self) {
        let mut said = String::new();
        while !self.is_stopped() {
            match self.listen() {
                Ok(true) => return,
                Ok(false) => said.clear(),
                Err(reason) if reason != said => {
                    said.clone_from(&reason);
                    self.link.events.publish(Event::TimecodeWaiting { reason });
                }
                Err(_) => {}
            }
            self.pause(AGAIN_EVERY);
        }
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Waits, but not beyond the stop.
    fn pause(&self, duration: Duration) {
        let until = Instant::now() + duration;
        while let Some(left) = until.checked_duration_since(Instant::now()).filter(|_| !self.is_stopped()) {
            std::thread::sleep(left.min(Duration::from_millis(50)));
        }
    }

    /// Reads the sound to its end; returns whether it will never continue.
    fn listen(&self) -> Result<bool, String> {
        let name = &self.settings.input;
        let refuse = |e: SoundError| format!("{name}: {e}");
        let file = match name {
            TimecodeInput::File(file) => Some(file.as_path()),
            TimecodeInput::Stdin => None,
            #[cfg(feature = "sound-card")]
            TimecodeInput::SoundCard(device) => {
                let format = self.settings.raw_format();
                let card = SoundCard::open(device, format, self.stop.clone()).map_err(|e| format!("{name}: {}", unopened_card(&e)))?;
                self.follow(Sound::raw(card, format, self.settings.channel).map_err(refuse)?, false)?;
                return Ok(false);
            }
            #[cfg(not(feature = "sound-card"))]
            TimecodeInput::SoundCard(_) => return Err(format!("{name}: this build has no sound cards")),
        };
        let input = Input::open(file, self.stop.clone()).map_err(|e| format!("{name}: {}", unopened(&e, file)))?;
        let is_regular = input.is_regular();
        let raw = self.settings.raw.or_else(|| (!is_regular).then(|| self.settings.raw_format()));
        self.follow(Sound::open(input, raw, self.settings.channel).map_err(refuse)?, is_regular)?;
        // A pipe's next writer may come.
        Ok(is_regular || file.is_none())
    }

    /// Decodes a sound to its end; a file plays from now on.
    fn follow<R: Read>(&self, mut sound: Sound<R>, is_file: bool) -> Result<(), String> {
        let (name, sample_rate) = (&self.settings.input, sound.sample_rate());
        let (mut decoder, mut arrival) = (LtcDecoder::new(sample_rate), Arrival::new(sample_rate));
        let (begun, mut count, mut samples) = (monotonic_now(), 0, Vec::new());
        while !self.is_stopped() && sound.read(&mut samples).map_err(|e| format!("{name}: {e}"))? {
            count += samples.len() as u64;
            let mut now = monotonic_now();
            if is_file {
                let due = begun.after_s(count as f64 / f64::from(sample_rate));
                self.pause(due.duration_since(now));
                now = due;
            }
            if arrival.arrived(count, now) {
                let reason = format!(
                    "{name}: more than {sample_rate} samples a second come, so it is not known when they were made; give `sample_rate_hz` \
                     and `channels` as they are, and play files at their speed (ffmpeg -re)"
                );
                self.link.events.publish(Event::TimecodeWaiting { reason });
            }
            let mut add = |frame: LtcFrame| {
                let at = arrival.at(frame.edge).after_s(-self.settings.latency_s);
                let mark = TimecodeMark { at, code: frame.code, is_reverse: frame.is_reverse };
                self.source.with_live(|track| track.push(mark));
            };
            decoder.push(&samples, &mut add);
            samples.clear();
        }
        Ok(())
    }
}

#[cfg(feature = "sound-card")]
fn unopened_card(error: &io::Error) -> String {
    format!("it cannot be opened ({error}); arecord -L lists the names, and plughw:… converts what a card cannot record")
}

/// Says why a sound cannot be opened, and what to do.
fn unopened(error: &io::Error, file: Option<&Path>) -> String {
    match (error.kind(), file) {
        (io::ErrorKind::NotFound, Some(_)) => "it is not there; make the pipe with mkfifo, or correct `file` in [timecode]".to_owned(),
        _ => format!("it cannot be opened ({error}); correct `file` in [timecode]"),
    }
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
