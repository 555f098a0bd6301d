//! Every other container, through an installed ffmpeg as a child process.
//!
//! ffmpeg decodes, keeps the luma plane as it is and writes it to a pipe. Its `showinfo` filter tells the exact
//! stamp and size of each frame on stderr, where a thread picks them up; so frames of uneven rate keep their times.

use std::collections::VecDeque;
use std::ffi::{OsStr, OsString};
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;

use image::{GrayImage, RgbImage};

use super::error::CaptureError;
use super::grey::check_size;
use super::picture_stream::{Picture, PictureData, PictureStream};
use super::rate::FrameRate;
use crate::frame::Timestamp;

/// Frames from a running ffmpeg.
pub(super) struct Ffmpeg {
    path: PathBuf,
    child: Child,
    frames: ChildStdout,
    announced: Receiver<Announced>,
    /// Collects stderr; its result is ffmpeg's last words.
    listener: Option<JoinHandle<String>>,
    /// Stands in place of the container's stamps.
    rate: Option<FrameRate>,
    next: u64,
    form: Form,
}

/// What ffmpeg makes of the pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Form {
    /// Their luma plane as it is.
    Grey,
    /// Red, green and blue.
    Colours,
}

impl Form {
    fn filter(self) -> &'static str {
        match self {
            Self::Grey => "extractplanes=y,format=gray,showinfo",
            Self::Colours => "format=rgb24,showinfo",
        }
    }

    fn bytes_a_pixel(self) -> u64 {
        match self {
            Self::Grey => 1,
            Self::Colours => 3,
        }
    }
}

/// What showinfo says of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Announced {
    stamp: Option<Timestamp>,
    width: u32,
    height: u32,
}

impl Ffmpeg {
    /// Starts ffmpeg on a file.
    pub fn open(path: &Path, rate: Option<FrameRate>) -> Result<Self, CaptureError> {
        Self::start(OsStr::new("ffmpeg"), path, rate, Form::Grey)
    }

    /// Starts ffmpeg on a file for its colours, to be read by [`next_colours`](Self::next_colours).
    pub fn open_colours(path: &Path) -> Result<Self, CaptureError> {
        Self::start(OsStr::new("ffmpeg"), path, None, Form::Colours)
    }

    fn start(program: &OsStr, path: &Path, rate: Option<FrameRate>, form: Form) -> Result<Self, CaptureError> {
        let failed = |e: std::io::Error| match e.kind() {
            std::io::ErrorKind::NotFound => CaptureError::FfmpegMissing { path: path.to_owned() },
            _ => CaptureError::FfmpegFailed { path: path.to_owned(), reason: e.to_string() },
        };
        let passthrough = if knows_fps_mode(program).map_err(failed)? { "-fps_mode" } else { "-vsync" };
        // The prefix keeps a name with a colon or a leading dash from being read as a protocol or an option.
        let mut input = OsString::from("file:");
        input.push(path);
        let mut child = Command::new(program)
            .args(["-hide_banner", "-nostdin", "-nostats", "-loglevel", "info", "-i"])
            .arg(input)
            .args(["-map", "0:v:0", "-an", "-sn", "-dn", "-vf", form.filter()])
            .args([passthrough, "passthrough", "-f", "rawvideo", "pipe:1"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(failed)?;
        let (Some(frames), Some(errors)) = (child.stdout.take(), child.stderr.take()) else {
            return Err(failed(std::io::Error::other("its pipes are gone")));
        };
        let (sender, announced) = channel();
        // From here on a failure ends the program that was started.
        let mut stream = Self { path: path.to_owned(), child, frames, announced, listener: None, rate, next: 0, form };
        let listen = move || {
            let mut log = Log::default();
            // Read on after the receiver is gone, or ffmpeg would block on a full pipe.
            for line in BufReader::new(errors).split(b'\n').map_while(Result::ok) {
                if let Some(frame) = log.note(&String::from_utf8_lossy(&line)) {
                    let _ = sender.send(frame);
                }
            }
            log.last_words()
        };
        stream.listener = Some(std::thread::Builder::new().name("ffmpeg".to_owned()).spawn(listen).map_err(failed)?);
        Ok(stream)
    }

    /// The next picture's colours; `None` at the end, and where there are none for the picture.
    pub fn next_colours(&mut self) -> Option<RgbImage> {
        let announced = self.announced.recv().ok()?;
        RgbImage::from_raw(announced.width, announced.height, self.read_bytes(&announced).ok()?)
    }

    /// The bytes of one picture, fewer where ffmpeg ended, or why there are none.
    fn read_bytes(&mut self, size: &Announced) -> Result<Vec<u8>, String> {
        let wanted = u64::from(size.width) * u64::from(size.height) * self.form.bytes_a_pixel();
        let mut picture = (&mut self.frames).take(wanted);
        let unreadable = |e| format!("ffmpeg cannot be read: {e}");
        if let Err(e) = check_size(size.width, size.height) {
            std::io::copy(&mut picture, &mut std::io::sink()).map_err(unreadable)?;
            return Err(e.to_string());
        }
        let mut bytes = Vec::with_capacity(wanted.min(1 << 26) as usize);
        picture.read_to_end(&mut bytes).map_err(unreadable)?;
        Ok(bytes)
    }

    fn read_frame(&mut self, size: &Announced) -> Result<GrayImage, String> {
        let grey = self.read_bytes(size)?;
        GrayImage::from_raw(size.width, size.height, grey).ok_or_else(|| "ffmpeg ended in the middle of this frame".to_owned())
    }
}

impl PictureStream for Ffmpeg {
    fn next_picture(&mut self) -> Option<Picture> {
        let announced = self.announced.recv().ok()?;
        let data = self.read_frame(&announced).map_or_else(PictureData::Missing, PictureData::Grey);
        let stamp = match (self.rate, announced.stamp) {
            (Some(rate), _) => Ok(rate.stamp(self.next)),
            (None, Some(stamp)) => Ok(stamp),
            (None, None) => Err("the container has no time stamp for this frame; give --fps".to_owned()),
        };
        self.next += 1;
        Some(Picture { stamp, data })
    }

    fn failure(&mut self) -> Option<CaptureError> {
        let reason = self.listener.take()?.join().unwrap_or_default();
        let clean = self.child.wait().is_ok_and(|status| status.success());
        (!clean).then(|| CaptureError::FfmpegFailed { path: self.path.clone(), reason })
    }
}

impl Drop for Ffmpeg {
    fn drop(&mut self) {
        // It may have ended by itself; then there is nothing to kill and nothing lost.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// `-fps_mode` came with 5.1, where `-vsync` began to go. Versions without a number are newer builds.
fn knows_fps_mode(program: &OsStr) -> std::io::Result<bool> {
    let output = Command::new(program).arg("-version").stdin(Stdio::null()).output()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let version = text.split_whitespace().nth(2).unwrap_or_default();
    let mut numbers = version.trim_start_matches('n').split(['.', '-']).map_while(|n| n.parse::<u32>().ok());
    Ok(numbers.next().is_none_or(|major| (major, numbers.next().unwrap_or(0)) >= (5, 1)))
}

/// ffmpeg's stderr, line by line.
#[derive(Default)]
struct Log {
    /// Seconds a tick, as a ratio.
    time_base: Option<(i64, i64)>,
    other_lines: VecDeque<String>,
}

impl Log {
    /// Takes a line in; a frame where the line announces one.
    fn note(&mut self, line: &str) -> Option<Announced> {
        let Some((_, said)) = line.split_once("showinfo").and_then(|(_, rest)| rest.split_once("] ")) else {
            if !line.trim().is_empty() {
                self.other_lines.push_back(line.trim().to_owned());
            }
            if self.other_lines.len() > 20 {
                self.other_lines.pop_front();
            }
            return None;
        };
        if let Some(base) = word_after(said, "config in time_base:") {
            let (numerator, denominator) = base.trim_end_matches(',').split_once('/')?;
            self.time_base = Some((numerator.parse().ok()?, denominator.parse().ok()?));
            return None;
        }
        let (width, height) = word_after(said, " s:")?.split_once('x')?;
        let ticks = word_after(said, " pts:").and_then(|t| t.parse::<i64>().ok());
        let stamp = ticks.zip(self.time_base).and_then(|(ticks, base)| stamp_of(ticks, base));
        Some(Announced { stamp, width: width.parse().ok()?, height: height.parse().ok()? })
    }

    /// The line that says most likely what went wrong.
    fn last_words(self) -> String {
        let telling = self.other_lines.iter().rev().find(|l| l.starts_with("file:") || l.contains("rror") || l.contains("nvalid"));
        telling.or(self.other_lines.back()).cloned().unwrap_or_else(|| "it ended without a word".to_owned())
    }
}

fn word_after<'a>(line: &'a str, name: &str) -> Option<&'a str> {
    line.split_once(name)?.1.split_whitespace().next()
}

/// Ticks of numerator / denominator seconds as a stamp, rounded.
fn stamp_of(ticks: i64, (numerator, denominator): (i64, i64)) -> Option<Timestamp> {
    let doubled = (i128::from(ticks) * i128::from(numerator)).checked_mul(2_000_000_000)?;
    let denominator = i128::from(denominator);
    let ns = (denominator > 0).then(|| (doubled + denominator).div_euclid(2 * denominator))?;
    i64::try_from(ns).ok().map(Timestamp::from_ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn showinfo_lines_become_stamps() {
        let mut log = Log::default();
        assert_eq!(log.note("[Parsed_showinfo_2 @ 0x55] config in time_base: 1/12800, frame_rate: 25/1"), None);
        let line =
            "[Parsed_showinfo_2 @ 0x55] n:   1 pts:    512 pts_time:0.04    pos:    40462 fmt:gray sar:1/1 s:640x480 i:P iskey:0 type:B ";
        assert_eq!(log.note(line), Some(Announced { stamp: Some(Timestamp::from_ns(40_000_000)), width: 640, height: 480 }));
        assert_eq!(log.note("[Parsed_showinfo_2 @ 0x55] color_range:unknown color_space:unknown"), None);
        assert_eq!(log.note(&line.replace("512", "NOPTS")).unwrap().stamp, None);
        assert_eq!(stamp_of(1, (1001, 30_000)), Some(Timestamp::from_ns(33_366_667)));
        assert_eq!(stamp_of(-1, (1, 3)), Some(Timestamp::from_ns(-333_333_333)));
        assert_eq!((stamp_of(1, (1, 0)), stamp_of(i64::MAX, (i64::MAX, 1))), (None, None));
    }

    #[test]
    fn a_missing_program_is_named_with_the_mend() {
        let gone = Ffmpeg::start(OsStr::new("no-such-program-as-this"), Path::new("a.mp4"), None, Form::Grey).err().map(|e| e.to_string());
        assert!(gone.is_some_and(|e| e.contains("a.mp4") && e.contains("install it")));
    }
}
