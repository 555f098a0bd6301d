//! A sound card, through ALSA.

use std::io::{self, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use alsa::pcm::{Access, Format, HwParams, PCM};
use alsa::{Direction, ValueOr};

use crate::timecode::RawFormat;

/// Wanted time between two deliveries of samples, microseconds. Raised, timecode comes later;
/// lowered, the daemon wakes more often.
const PERIOD_US: u32 = 10_000;
/// Wanted time that the card's buffer holds, microseconds: a busy machine loses nothing for that
/// long. Raised, only memory.
const BUFFER_US: u32 = 300_000;
/// Interval of looks at the stop, milliseconds; see the pipes' one.
const LOOK_MS: u32 = 100;

/// A card that records. Its `read` returns 0 at the stop, and an error if samples were lost.
pub(super) struct SoundCard {
    pcm: PCM,
    stop: Arc<AtomicBool>,
}

impl SoundCard {
    /// Opens a card by its ALSA name for 16-bit samples of this rate and number of channels.
    ///
    /// # Errors
    /// It is not there, is in use, or does not record like that.
    pub fn open(name: &str, format: RawFormat, stop: Arc<AtomicBool>) -> io::Result<Self> {
        // Otherwise the library writes to stderr at every attempt.
        let _kept = alsa::Output::local_error_handler();
        Self::start(name, format).map(|pcm| Self { pcm, stop }).map_err(of_alsa)
    }

    fn start(name: &str, format: RawFormat) -> alsa::Result<PCM> {
        let pcm = PCM::new(name, Direction::Capture, true)?;
        {
            let parameters = HwParams::any(&pcm)?;
            parameters.set_access(Access::RWInterleaved)?;
            parameters.set_format(Format::S16LE)?;
            parameters.set_channels(u32::from(format.channels))?;
            parameters.set_rate(format.sample_rate, ValueOr::Nearest)?;
            parameters.set_period_time_near(PERIOD_US, ValueOr::Nearest)?;
            parameters.set_buffer_time_near(BUFFER_US, ValueOr::Nearest)?;
            pcm.hw_params(&parameters)?;
        }
        pcm.start()?;
        Ok(pcm)
    }
}

fn of_alsa(error: alsa::Error) -> io::Error {
    io::Error::from_raw_os_error(error.errno())
}

impl Read for SoundCard {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while !self.stop.load(Ordering::Relaxed) {
            if !self.pcm.wait(Some(LOOK_MS)).map_err(of_alsa)? {
                continue;
            }
            match self.pcm.io_bytes().read(buffer) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                read => return read,
            }
        }
        Ok(0)
    }
}
