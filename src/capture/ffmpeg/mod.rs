//! Reads every other container through an installed ffmpeg, run as a child process.
//!
//! The file is first probed for its format and remarks ([`probe`]). Then ffmpeg decodes it and
//! writes the pixels to a pipe as they lie in the file: the unchanged luma plane of video, or RGB
//! if there is none ([`form`]). Its `showinfo` filter prints the exact stamp, size and depth of
//! each frame on stderr, where a thread parses them ([`log`]). So frames at an uneven rate keep
//! their times, and a picture that changes its size stays in step with its bytes.

mod form;
mod log;
mod probe;

use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Read};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use image::{GrayImage, RgbImage};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use self::form::Form;
use self::log::{Announced, Log};
use self::probe::Probe;
pub use self::probe::ffmpeg_account;
use super::error::CaptureError;
use super::grey::check_size;
use super::picture_stream::{Picture, PictureData, PictureStream};
use super::rate::FrameRate;
use super::remarks;

/// Frames from a running ffmpeg process.
pub(super) struct Ffmpeg {
    path: PathBuf,
    child: Child,
    frames: ChildStdout,
    announced: Receiver<Announced>,
    /// The thread that reads stderr to its end.
    listener: Option<JoinHandle<Log>>,
    /// Replaces the container's stamps, if set.
    rate: Option<FrameRate>,
    next: u64,
    form: Form,
    /// Whether an old ffmpeg scales all pictures to the size of the first.
    scaled_to: Scaling,
    remarks: Remarks,
    /// Set once pictures and announcements no longer match.
    is_out_of_step: bool,
}

/// Whether ffmpeg scales pictures of another size.
#[derive(Debug, Clone, Copy)]
enum Scaling {
    Off,
    /// To the size of the first picture, once it is known.
    ToFirst(Option<(u32, u32)>),
}

/// Remarks about the file, one sentence each.
#[derive(Default)]
struct Remarks {
    sentences: Vec<String>,
    has_shape: bool,
    has_fields: bool,
}

/// First ffmpeg version with `-autoscale`; earlier ones scale pictures of another size to that of
/// the first.
const HAS_AUTOSCALE: (u32, u32) = (4, 4);
/// First ffmpeg version with `-fps_mode`, which replaces `-vsync`.
const HAS_FPS_MODE: (u32, u32) = (5, 1);
/// How long bytes may wait in the pipe without an announcing line, in units of [`LISTENING`]. The
/// line is written first, so this is ample even on a busy machine. Raised, a stream out of step is
/// noticed later.
const MAX_SILENT: u32 = 20;
/// Interval at which the pipe is polled while no line comes. Raised, a stream out of step is
/// noticed later; lowered, waiting costs more CPU time.
const LISTENING: Duration = Duration::from_millis(500);

impl Ffmpeg {
    /// Starts ffmpeg on a file.
    pub fn open(path: &Path, rate: Option<FrameRate>) -> Result<Self, CaptureError> {
        Self::of_program(OsStr::new("ffmpeg"), path, rate)
    }

    /// Starts ffmpeg on a file for its colours; read them with
    /// [`next_colours`](Self::next_colours).
    pub fn open_colours(path: &Path) -> Result<Self, CaptureError> {
        let program = OsStr::new("ffmpeg");
        let probe = probed(program, path, true)?;
        Self::start(program, path, None, (Form::Rgb, probe))
    }

    fn of_program(program: &OsStr, path: &Path, rate: Option<FrameRate>) -> Result<Self, CaptureError> {
        let probe = probed(program, path, rate.is_some())?;
        let form = probe.pixels.as_deref().map_or(Form::Luma, Form::of);
        Self::start(program, path, rate, (form, probe))
    }

    fn start(program: &OsStr, path: &Path, rate: Option<FrameRate>, (form, probe): (Form, Probe)) -> Result<Self, CaptureError> {
        let failed = |e| not_run(path, e);
        let knows = |since| probe.version.is_none_or(|version| version >= since);
        let mut command = probe::command(program, path);
        let scaled_to = if knows(HAS_AUTOSCALE) { Scaling::Off } else { Scaling::ToFirst(None) };
        if matches!(scaled_to, Scaling::Off) {
            command.args(["-autoscale", "0"]);
        }
        let mut child = command
            .args(["-vf", form.filter(), if knows(HAS_FPS_MODE) { "-fps_mode" } else { "-vsync" }])
            .args(["passthrough", "-f", "rawvideo", "pipe:1"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(failed)?;
        let (Some(frames), Some(errors)) = (child.stdout.take(), child.stderr.take()) else {
            return Err(failed(std::io::Error::other("its pipes are gone")));
        };
        let (sender, announced) = channel();
        let remarks = Remarks { sentences: probe.notes, ..Remarks::default() };
        // Built before the thread starts, so that a failure from here on ends the child process (by
        // `drop`).
        let mut stream = Self {
            path: path.to_owned(),
            child,
            frames,
            announced,
            listener: None,
            rate,
            next: 0,
            form,
            scaled_to,
            remarks,
            is_out_of_step: false,
        };
        let listen = move || {
            let mut log = Log::default();
            // Keep reading after the receiver is gone, or ffmpeg would block on a full pipe.
            for line in BufReader::new(errors).split(b'\n').map_while(Result::ok) {
                if let Some(frame) = log.note(&String::from_utf8_lossy(&line)) {
                    let _ = sender.send(frame);
                }
            }
            log
        };
        stream.listener = Some(std::thread::Builder::new().name("ffmpeg".to_owned()).spawn(listen).map_err(failed)?);
        Ok(stream)
    }

    /// Returns the next picture's colours; `None` at the end, and for a picture that has none.
    pub fn next_colours(&mut self) -> Option<RgbImage> {
        let announced = self.next_announced()?.ok()?;
        RgbImage::from_raw(announced.width, announced.height, self.read_bytes(&announced).ok()?)
    }

    /// Returns the announcement of the next picture; `None` at the end. Does not wait forever while
    /// ffmpeg is blocked on a full pipe.
    fn next_announced(&mut self) -> Option<Result<Announced, String>> {
        let mut silent = 0;
        while !self.is_out_of_step {
            match self.announced.recv_timeout(LISTENING) {
                Ok(announced) => return Some(Ok(announced)),
                Err(RecvTimeoutError::Disconnected) => return None,
                Err(RecvTimeoutError::Timeout) => silent = if self.has_bytes() { silent + 1 } else { 0 },
            }
            if silent >= MAX_SILENT {
                let _ = self.child.kill(); // fails if ffmpeg has already ended
                self.is_out_of_step = true;
                return Some(Err("ffmpeg's pictures and its log are out of step".to_owned()));
            }
        }
        None
    }

    fn has_bytes(&self) -> bool {
        poll(&mut [PollFd::new(self.frames.as_fd(), PollFlags::POLLIN)], PollTimeout::ZERO).is_ok_and(|ready| ready > 0)
    }

    /// Reads the bytes of one picture, or returns why there are none.
    fn read_bytes(&mut self, announced: &Announced) -> Result<Vec<u8>, String> {
        let size = (announced.width, announced.height);
        let written = match &mut self.scaled_to {
            Scaling::Off => size,
            Scaling::ToFirst(first) => *first.get_or_insert(size),
        };
        let wanted = u64::from(written.0) * u64::from(written.1) * self.form.bytes_a_pixel(announced);
        let mut picture = (&mut self.frames).take(wanted);
        let unreadable = |e| format!("ffmpeg's output cannot be read: {e}");
        let is_allowed = check_size(written.0, written.1).map_err(|e| e.to_string());
        let is_own =
            if written == size { Ok(()) } else { Err(format!("the picture is {} x {} pixels, unlike the first one", size.0, size.1)) };
        if let Err(reason) = is_allowed.and(is_own) {
            std::io::copy(&mut picture, &mut std::io::sink()).map_err(unreadable)?;
            return Err(reason);
        }
        let mut bytes = Vec::with_capacity(wanted.min(1 << 26) as usize);
        picture.read_to_end(&mut bytes).map_err(unreadable)?;
        if (bytes.len() as u64) < wanted { Err("ffmpeg ended in the middle of this frame".to_owned()) } else { Ok(bytes) }
    }

    fn read_frame(&mut self, announced: &Announced) -> Result<GrayImage, String> {
        let bytes = self.read_bytes(announced)?;
        self.form.grey(bytes, announced).ok_or_else(|| "ffmpeg gave too few bytes for this frame".to_owned())
    }

    /// Returns why ffmpeg ended, unless it reached the end of an intact file.
    fn early_end(&mut self) -> Option<String> {
        let log = self.listener.take()?.join().unwrap_or_default();
        let is_clean = self.child.wait().is_ok_and(|status| status.success());
        let (rows, complaint) = (self.next, log.complaint().unwrap_or("it ended without a word"));
        if log.is_cut_off() {
            return Some(format!("the recording is cut off: it ends in the middle, after {rows} frames (ffmpeg: {complaint})"));
        }
        if !is_clean {
            return Some(format!("ffmpeg ended after {rows} frames: {complaint}; the rest is missing"));
        }
        log.complaint().map(|complaint| format!("ffmpeg complains of the clip, some pictures may be damaged: {complaint}"))
    }
}

impl PictureStream for Ffmpeg {
    fn next_picture(&mut self) -> Option<Picture> {
        let Some(announced) = self.next_announced() else {
            if self.next > 0 && !self.is_out_of_step {
                let ended = self.early_end();
                self.remarks.sentences.extend(ended);
            }
            return None;
        };
        let data = announced.clone().and_then(|a| self.read_frame(&a)).map_or_else(PictureData::Missing, PictureData::Grey);
        if let Ok(announced) = &announced {
            self.remarks.note(announced, self.next);
        }
        let stamp = match (self.rate, announced.ok().and_then(|a| a.stamp)) {
            (Some(rate), _) => Ok(rate.stamp(self.next)),
            (None, Some(stamp)) => Ok(stamp),
            (None, None) => Err("the container has no time stamp for this frame; give --fps".to_owned()),
        };
        self.next += 1;
        Some(Picture { stamp, data })
    }

    fn failure(&mut self) -> Option<CaptureError> {
        let log = self.listener.take()?.join().unwrap_or_default();
        let clean = self.child.wait().is_ok_and(|status| status.success());
        (!clean).then(|| refusal(&self.path, &log))
    }

    fn take_notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.remarks.sentences)
    }
}

impl Remarks {
    fn note(&mut self, announced: &Announced, row: u64) {
        if let Some(shape) = announced.pixel_shape.filter(|_| !self.has_shape) {
            self.has_shape = true;
            self.sentences.push(remarks::pixel_shape(shape));
        }
        if announced.is_interlaced && !self.has_fields {
            self.has_fields = true;
            self.sentences.push(remarks::interlaced(row));
        }
    }
}

impl Drop for Ffmpeg {
    fn drop(&mut self) {
        // Both fail harmlessly if ffmpeg has already ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn probed(program: &OsStr, path: &Path, has_own_rate: bool) -> Result<Probe, CaptureError> {
    let probe = Probe::of(program, path, has_own_rate).map_err(|e| not_run(path, e))?;
    if probe.pixels.is_none() && probe.log.complaint().is_some() { Err(refusal(path, &probe.log)) } else { Ok(probe) }
}

fn not_run(path: &Path, e: std::io::Error) -> CaptureError {
    match e.kind() {
        std::io::ErrorKind::NotFound => CaptureError::FfmpegMissing { path: path.to_owned() },
        _ => CaptureError::FfmpegFailed { path: path.to_owned(), reason: e.to_string() },
    }
}

/// Returns why there is no picture at all.
fn refusal(path: &Path, log: &Log) -> CaptureError {
    let (path, reason) = (path.to_owned(), log.complaint().unwrap_or("it ended without a word").to_owned());
    // A file that is no film at all lacks an index, too: do not call it cut off.
    let is_begun = !reason.contains("moov") || begins_as_film(&path);
    if log.is_cut_off() && is_begun { CaptureError::CutOff { path, reason } } else { CaptureError::FfmpegFailed { path, reason } }
}

/// Whether a file begins with a QuickTime or MP4 box.
fn begins_as_film(path: &Path) -> bool {
    let mut start = [0; 8];
    let is_read = crate::safe_file::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok();
    is_read && [b"ftyp", b"mdat", b"moov", b"wide", b"free", b"skip"].iter().any(|kind| start[4..] == **kind)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_ffmpeg_is_named_with_a_hint() {
        let gone = Ffmpeg::of_program(OsStr::new("no-such-program-as-this"), Path::new("a.mp4"), None).err().map(|e| e.to_string());
        assert!(gone.is_some_and(|e| e.contains("a.mp4") && e.contains("install it")));
    }

    /// Runs a program that writes one picture more than it announces and then blocks until it is
    /// read.
    #[test]
    fn an_out_of_step_stream_ends_instead_of_hanging() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("ffmpeg");
        let script = "#!/bin/sh\necho 'ffmpeg version 5.1.9'\necho '[Parsed_showinfo_0 @ 0x5] [info] n: 0 pts: 0 fmt:gray s:8x2 i:P' >&2\n\
            exec head -c 1000000 /dev/zero\n";
        std::fs::write(&program, script).unwrap();
        std::fs::set_permissions(&program, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
        let mut stream = Ffmpeg::start(program.as_os_str(), Path::new("a.mp4"), None, (Form::Luma, Probe::default())).unwrap();
        assert!(matches!(stream.next_picture().unwrap().data, PictureData::Grey(_)));
        let PictureData::Missing(reason) = stream.next_picture().unwrap().data else { panic!("there is no such picture") };
        assert!(reason.contains("out of step"), "{reason}");
        assert!(stream.next_picture().is_none());
    }
}
