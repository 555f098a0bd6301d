//! Plays a clip as if it were a live camera: live rules and live pace, without hardware. For
//! rehearsals and tests.
//!
//! Pictures become available when they are due, and their stamps are the clip's, shifted to now. A
//! slow reader loses pictures and gets what is due now: a clip that lags would show the past as the
//! present.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Duration;

use serde::Deserialize;

use super::camera::{Camera, CameraFault, CameraMode, CameraOpener, CapturedPicture, OpenFault, PixelLayout};
use super::timestamping::{DriverStamp, monotonic_now};
use super::{CaptureError, ClipEntry, ClipOptions, EntryContent, FrameSource, MjpegReader, open_clip};
use crate::frame::Timestamp;

/// Plays a clip once.
pub struct PlayedClip {
    clip: PathBuf,
    /// Taken by the first opening, since a clip is played once.
    unopened: Mutex<Option<PlayingClip>>,
    notes: Vec<String>,
}

impl PlayedClip {
    /// Opens the clip. `fps` applies to clips without stamps (default 30); clips with stamps take
    /// the rate of their first two stamps if `fps` is absent.
    ///
    /// # Errors
    /// As [`open_clip`].
    pub fn open(clip: &Path, fps: Option<f64>) -> Result<Self, CaptureError> {
        let first = open_clip(clip, ClipOptions { fps, ..ClipOptions::default() })?;
        let notes = first.notes();
        let mut pictures = match clip.extension().and_then(|e| e.to_str()) {
            Some("mjpeg" | "mjpg") => {
                let file = crate::safe_file::open(clip).map_err(|e| CaptureError::reading(clip, e))?;
                let size = first.size();
                Pictures::Jpegs { reader: MjpegReader::new(Box::new(std::io::BufReader::new(file))), size, next: 0 }
            }
            _ => Pictures::Rows(first),
        };
        let mut ahead = VecDeque::new();
        let fps = fps.or_else(|| stamped_rate(&mut pictures, &mut ahead)).unwrap_or(30.0);
        let layout = if matches!(pictures, Pictures::Rows(_)) { PixelLayout::Grey } else { PixelLayout::Mjpeg };
        let mode = CameraMode {
            name: clip.display().to_string(),
            size: pictures.size(),
            layout,
            fps,
            exposure_s: recorded_exposure(clip),
            controls: Vec::new(),
            notes: Vec::new(),
        };
        let playing = PlayingClip { pictures, mode, begun: None, ahead, counted: 0 };
        Ok(Self { clip: clip.to_owned(), unopened: Mutex::new(Some(playing)), notes })
    }

    /// Returns remarks about the clip, one sentence each.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }
}

/// The relevant part of a recording's clip.toml.
#[derive(Deserialize)]
struct Recording {
    camera: RecordedCamera,
}

#[derive(Deserialize)]
struct RecordedCamera {
    exposure_s: Option<f64>,
}

/// Maximum size of a clip.toml, bytes. It is a page of text; the limit keeps a wrong file from
/// being read into memory.
const MAX_ACCOUNT_BYTES: u64 = 1 << 20;

/// Returns the locked exposure of a recording's camera, seconds; `None` if the clip is not a
/// recording.
fn recorded_exposure(clip: &Path) -> Option<f64> {
    let account = clip.join("clip.toml");
    std::fs::metadata(&account).ok().filter(|m| m.is_file() && m.len() <= MAX_ACCOUNT_BYTES)?;
    let recording: Recording = toml::from_str(&String::from_utf8(crate::safe_file::read(&account, MAX_ACCOUNT_BYTES).ok()?).ok()?).ok()?;
    recording.camera.exposure_s
}

impl CameraOpener for PlayedClip {
    fn open(&self) -> Result<Box<dyn Camera>, OpenFault> {
        let playing = self.unopened.lock().ok().and_then(|mut unopened| unopened.take());
        let played = || OpenFault(format!("the clip {} has been played; give it again", self.clip.display()));
        playing.map(|p| Box::new(p) as Box<dyn Camera>).ok_or_else(played)
    }
}

enum Pictures {
    /// Encoded pictures at a constant rate.
    Jpegs { reader: MjpegReader<Box<dyn std::io::Read + Send>>, size: (u32, u32), next: u64 },
    /// Decoded pictures with stamps.
    Rows(Box<dyn FrameSource>),
}

impl Pictures {
    /// Announces that pictures before a time of the clip are not needed any more. Encoded pictures
    /// cost nothing to skip.
    fn pass_over_before(&mut self, earliest: Timestamp) {
        if let Self::Rows(rows) = self {
            rows.pass_over_before(earliest);
        }
    }

    fn size(&self) -> (u32, u32) {
        match self {
            Self::Jpegs { size, .. } => *size,
            Self::Rows(rows) => rows.size(),
        }
    }

    /// Returns the next picture's stamp in the clip and its bytes (empty if it cannot be read).
    fn next(&mut self, fps: f64) -> Option<(Timestamp, Vec<u8>)> {
        match self {
            Self::Jpegs { reader, next, .. } => {
                let bytes = reader.next_jpeg()?.unwrap_or_default();
                *next += 1;
                Some((Timestamp::from_ns(((*next - 1) as f64 * 1e9 / fps).round() as i64), bytes))
            }
            Self::Rows(rows) => rows.next_entry().map(|ClipEntry { timestamp, content, .. }| match content {
                EntryContent::Frame(frame) => (timestamp, frame.image.into_raw()),
                EntryContent::Undecodable(_) | EntryContent::Skipped(_) => (timestamp, Vec::new()),
            }),
        }
    }
}

/// Number of frames kept for a late reader: as many as a camera driver's buffers. Raised, a stalled
/// reader gets older pictures; below 1, even a slight delay loses pictures.
const WAITING_FRAMES: f64 = 4.0;

struct PlayingClip {
    pictures: Pictures,
    mode: CameraMode,
    /// When the first picture was due, and its stamp in the clip.
    begun: Option<(Timestamp, Timestamp)>,
    /// Pictures that were read before they were due, with their stamps in the clip.
    ahead: VecDeque<(Timestamp, Vec<u8>)>,
    /// Number of pictures delivered or skipped.
    counted: u32,
}

/// Returns the pictures per second from the first two stamps, if the clip has stamps; the two
/// pictures are kept in `ahead`.
fn stamped_rate(pictures: &mut Pictures, ahead: &mut VecDeque<(Timestamp, Vec<u8>)>) -> Option<f64> {
    let Pictures::Rows(_) = pictures else { return None };
    ahead.extend(pictures.next(0.0));
    ahead.extend(pictures.next(0.0));
    let (first, second) = (ahead.front()?.0, ahead.back()?.0);
    let frame_s = second.seconds_since(first);
    (0.001..=10.0).contains(&frame_s).then_some(1.0 / frame_s)
}

impl PlayingClip {
    /// Returns the next picture that is not too late: its stamp in the clip, its bytes, and when it
    /// is due.
    fn next_due(&mut self) -> Option<(Timestamp, Vec<u8>, Timestamp)> {
        let waiting_ns = (WAITING_FRAMES * 1e9 / self.mode.fps) as i64;
        loop {
            let (stamp, bytes) = self.ahead.pop_front().or_else(|| self.pictures.next(self.mode.fps))?;
            let now = monotonic_now();
            let (begun, first) = *self.begun.get_or_insert((now, stamp));
            let due = begun.after_ns(stamp.ns_since(first));
            if now.ns_since(due) <= waiting_ns {
                return Some((stamp, bytes, due));
            }
            self.counted = self.counted.wrapping_add(1);
            self.pictures.pass_over_before(first.after_ns(now.ns_since(begun) - waiting_ns));
        }
    }
}

impl Camera for PlayingClip {
    fn mode(&self) -> &CameraMode {
        &self.mode
    }

    fn next_picture(&mut self, patience: Duration) -> Result<CapturedPicture, CameraFault> {
        let (stamp, bytes, due) = self.next_due().ok_or(CameraFault::End)?;
        let left = due.duration_since(monotonic_now());
        std::thread::sleep(left.min(patience));
        if left > patience {
            self.ahead.push_front((stamp, bytes));
            return Err(CameraFault::Silent);
        }
        let (arrival, device_sequence) = (monotonic_now(), Some(self.counted));
        self.counted = self.counted.wrapping_add(1);
        Ok(CapturedPicture { is_damaged: bytes.is_empty(), bytes, stamp: DriverStamp::MidExposure(due), arrival, device_sequence })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_reader_gets_the_frame_due_now() {
        let folder = tempfile::tempdir().unwrap();
        image::GrayImage::new(8, 6).save(folder.path().join("a.png")).unwrap();
        let rows = (0..10_000_i64).map(|n| format!("{},a.png\n", n * 10_000_000));
        std::fs::write(folder.path().join("timestamps.csv"), "#timestamp [ns],filename\n".to_owned() + &rows.collect::<String>()).unwrap();
        let mut camera = PlayedClip::open(folder.path(), None).unwrap().open().unwrap();
        let mut next =
            || camera.next_picture(Duration::from_secs(10)).map(|picture| (picture.device_sequence, picture.stamp, picture.is_damaged));
        let Ok((Some(0), DriverStamp::MidExposure(first), false)) = next() else { panic!("no first picture") };
        std::thread::sleep(Duration::from_millis(500));
        // Fifty are due and four wait; a busy machine may be later still.
        let Ok((Some(number @ 46..), DriverStamp::MidExposure(later), false)) = next() else { panic!("not what is due") };
        assert_eq!(later.ns_since(first), i64::from(number) * 10_000_000);
    }

    #[test]
    fn a_clip_with_stamps_plays_at_its_own_rate() {
        let folder = tempfile::tempdir().unwrap();
        let mut index = "#timestamp [ns],filename\n".to_owned();
        std::fs::create_dir(folder.path().join("frames")).unwrap();
        for n in 0..3_i64 {
            image::GrayImage::new(8, 6).save(folder.path().join(format!("frames/{n}.png"))).unwrap();
            index += &format!("{},{n}.png\n", n * 40_000_000);
        }
        std::fs::write(folder.path().join("timestamps.csv"), index).unwrap();
        let mut camera = PlayedClip::open(folder.path(), None).unwrap().open().unwrap();
        assert_eq!((camera.mode().fps, camera.mode().size), (25.0, (8, 6)));
        let mut stamps = Vec::new();
        loop {
            match camera.next_picture(Duration::from_millis(10)) {
                Ok(CapturedPicture { stamp: DriverStamp::MidExposure(at), .. }) => stamps.push(at),
                Err(CameraFault::Silent) => {}
                other => break assert!(matches!(other, Err(CameraFault::End)), "{other:?}"),
            }
        }
        assert_eq!(stamps.windows(2).map(|w| w[1].ns_since(w[0])).collect::<Vec<_>>(), [40_000_000; 2]);
    }
}
