//! `--overlay FILE.mp4`: the overlay's pictures as a video, encoded by an installed ffmpeg in a
//! child process.
//!
//! A video has a constant rate and a clip need not. So the rate is that of the clip's first frames,
//! and every frame is shown. If rows are missing, the last picture is repeated until the next one,
//! so that the video does not run ahead of its clip.

use std::ffi::OsString;
use std::io::{self, Read, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdin, Command, Stdio};
use std::thread::JoinHandle;

use image::RgbImage;

use crate::cli::failure::Failure;
use crate::frame::Timestamp;
use crate::safe_file;

/// The encoder program.
const PROGRAM: &str = "ffmpeg";
/// Number of intervals between frames whose median is the rate: the fewest whose median a single
/// gap does not change. Their pictures are held in memory until then; raised, more are.
const INTERVALS: usize = 3;
/// Frame interval of a clip of one frame, nanoseconds: 25 per second. Any rate would do for a
/// single picture.
const SINGLE_FRAME_NS: i64 = 1_000_000_000 / 25;
/// Maximum time that one picture is repeated for missing rows, nanoseconds: stamps may jump by
/// hours. Chosen, not tuned. Raised, a jump makes a longer still in the video.
const MAX_STAND_NS: i64 = 10_000_000_000;

/// File extensions that mean a video, with ffmpeg's encoding options. The qualities (`-crf`) are
/// chosen, not tuned; raised, videos are smaller and worse.
const FORMS: [(&str, &str); 6] = [
    ("mp4", H264_AT_ONCE),
    ("m4v", H264_AT_ONCE),
    ("mov", H264_AT_ONCE),
    ("mkv", "-c:v libx264 -preset veryfast -crf 20 -pix_fmt yuv420p"),
    ("webm", "-c:v libvpx-vp9 -b:v 0 -crf 30 -deadline realtime -cpu-used 8 -row-mt 1 -pix_fmt yuv420p"),
    ("avi", "-c:v mjpeg -q:v 3 -pix_fmt yuvj420p"),
];
/// H.264 with the index in front, so that a browser can play it while loading.
const H264_AT_ONCE: &str = "-c:v libx264 -preset veryfast -crf 20 -pix_fmt yuv420p -movflags +faststart";

/// Returns the encoding options for a file of this name; `None` if the name means a folder.
fn encoding(path: &Path) -> Option<&'static str> {
    let extension = path.extension()?.to_str()?.to_ascii_lowercase();
    FORMS.iter().find(|(end, _)| *end == extension && !path.is_dir()).map(|(_, arguments)| *arguments)
}

/// Whether a path means a video file and not a folder of pictures.
pub(super) fn is_video(path: &Path) -> bool {
    encoding(path).is_some()
}

/// Refuses before tracking if the encoder is missing.
pub(super) fn refuse_without_program(path: &Path) -> Result<(), Failure> {
    refuse_without(path, PROGRAM)
}

fn refuse_without(path: &Path, program: &str) -> Result<(), Failure> {
    let asked = Command::new(program).arg("-version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status();
    if asked.is_ok_and(|status| status.success()) {
        return Ok(());
    }
    let file = path.display();
    Err(Failure::Usage(format!(
        "--overlay {file}: videos are written by the program {program}, which is missing here; install it (on Debian: apt install ffmpeg), or give a folder for pictures"
    )))
}

/// A video being written.
pub(super) struct VideoFile {
    path: PathBuf,
    /// Stamps and pictures, until the rate is known.
    held: Vec<(Timestamp, RgbImage)>,
    encoder: Option<Encoder>,
}

impl VideoFile {
    /// Creates nothing until the first picture comes.
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), held: Vec::new(), encoder: None }
    }

    /// Adds a picture; all have the same size.
    pub fn write(&mut self, timestamp: Timestamp, picture: RgbImage) -> Result<(), Failure> {
        match &mut self.encoder {
            Some(encoder) => encoder.add(timestamp, picture),
            None => {
                self.held.push((timestamp, picture));
                if self.held.len() > INTERVALS { self.begin() } else { Ok(()) }
            }
        }
    }

    /// Starts ffmpeg and passes it the held pictures.
    fn begin(&mut self) -> Result<(), Failure> {
        let Some((first, picture)) = self.held.first() else { return Ok(()) };
        let mut encoder = Encoder::start(&self.path, picture.dimensions(), (*first, interval_ns(&self.held)))?;
        for (timestamp, picture) in self.held.drain(..) {
            encoder.add(timestamp, picture)?;
        }
        self.encoder = Some(encoder);
        Ok(())
    }

    /// Finishes the file. Without pictures there is none.
    pub fn finish(mut self) -> Result<(), Failure> {
        self.begin()?;
        self.encoder.take().map_or(Ok(()), Encoder::finish)
    }
}

/// Returns the median interval between stamps.
fn interval_ns(held: &[(Timestamp, RgbImage)]) -> i64 {
    let mut intervals: Vec<i64> = held.windows(2).map(|pair| pair[1].0.ns_since(pair[0].0)).collect();
    intervals.sort_unstable();
    intervals.get(intervals.len() / 2).copied().filter(|interval| *interval > 0).unwrap_or(SINGLE_FRAME_NS)
}

/// A running ffmpeg.
struct Encoder {
    path: PathBuf,
    child: Child,
    /// `None` once the last picture is written.
    pictures: Option<ChildStdin>,
    /// Its error output, once it has ended.
    complaints: Option<JoinHandle<String>>,
    pacing: Pacing,
    last: Option<RgbImage>,
}

impl Encoder {
    fn start(path: &Path, (width, height): (u32, u32), (first, interval_ns): (Timestamp, i64)) -> Result<Self, Failure> {
        // Truncates the file, and refuses anything but a plain file with our own message.
        safe_file::replace(path).map_err(Failure::output(path))?;
        let arguments = encoding(path).unwrap_or(H264_AT_ONCE);
        // The prefix keeps a name with a colon or a leading dash from being read as a protocol or
        // an option.
        let mut output = OsString::from("file:");
        output.push(path);
        let mut child = Command::new(PROGRAM)
            .args(["-hide_banner", "-nostats", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args(["-video_size", &format!("{width}x{height}"), "-framerate", &format!("1000000000/{interval_ns}"), "-i", "pipe:0"])
            // The codecs halve the chroma resolution, so sides must be even.
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2,scale=out_color_matrix=bt709"])
            .args(["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709"])
            .args(arguments.split(' '))
            .arg(output)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            // Keep Ctrl-C in the terminal from ffmpeg: this program handles it and then finishes
            // the video properly.
            .process_group(0)
            .spawn()
            .map_err(Failure::output(path))?;
        let (pictures, complaints) = (child.stdin.take(), child.stderr.take());
        let pacing = Pacing { first, interval_ns, written: 0 };
        // From here on, dropping the encoder on a failure ends the child process.
        let mut encoder = Self { path: path.to_owned(), child, pictures, complaints: None, pacing, last: None };
        let listener = std::thread::Builder::new().name(PROGRAM.to_owned()).spawn(move || complaints.map_or_else(String::new, last_words));
        encoder.complaints = Some(listener.map_err(Failure::output(path))?);
        Ok(encoder)
    }

    fn add(&mut self, timestamp: Timestamp, picture: RgbImage) -> Result<(), Failure> {
        let repeats = self.pacing.repeats_before(timestamp);
        let pictures = self.pictures.as_mut().ok_or_else(|| io::Error::other("it has ended"));
        let written = pictures.and_then(|to| {
            for again in self.last.iter().cycle().take(if self.last.is_some() { repeats } else { 0 }) {
                to.write_all(again)?;
            }
            to.write_all(&picture)
        });
        self.last = Some(picture);
        written.map_err(|e| self.failure(&e.to_string()))
    }

    fn finish(mut self) -> Result<(), Failure> {
        self.pictures = None;
        match self.child.wait() {
            Ok(status) if status.success() => Ok(()),
            Ok(status) => Err(self.failure(&status.to_string())),
            Err(e) => Err(self.failure(&e.to_string())),
        }
    }

    /// Returns the failure. ffmpeg's own message says more than the pipe's error.
    fn failure(&mut self, otherwise: &str) -> Failure {
        self.pictures = None;
        let said = self.complaints.take().and_then(|listener| listener.join().ok()).filter(|said| !said.is_empty());
        let reason = said.unwrap_or_else(|| otherwise.to_owned());
        Failure::output(&self.path)(io::Error::other(format!("{PROGRAM}: {reason}")))
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        // After `finish` the child has ended, so there is nothing to kill.
        self.pictures = None;
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Returns ffmpeg's last line. Its output is read to the end, or it would block on a full pipe.
fn last_words(mut from: ChildStderr) -> String {
    let mut said = Vec::new();
    let mut piece = [0; 4096];
    while let Ok(1..) = from.read(&mut piece).inspect(|&n| said.extend_from_slice(&piece[..n])) {
        // Keep only the end, enough for the last line.
        said.drain(..said.len().saturating_sub(8 * piece.len()));
    }
    String::from_utf8_lossy(&said).lines().map(str::trim).rfind(|line| !line.is_empty()).unwrap_or_default().to_owned()
}

/// Maps stamps to picture numbers of the video.
struct Pacing {
    first: Timestamp,
    interval_ns: i64,
    written: i64,
}

impl Pacing {
    /// Returns how often to repeat the previous picture before the one of this stamp, and counts
    /// that one as written.
    fn repeats_before(&mut self, timestamp: Timestamp) -> usize {
        let since_ns = timestamp.ns_since(self.first);
        let due = since_ns.saturating_add(self.interval_ns / 2).div_euclid(self.interval_ns);
        let most = MAX_STAND_NS / self.interval_ns;
        let missing = (due - self.written).max(0);
        if missing > most {
            self.first = self.first.after_ns((missing - most).saturating_mul(self.interval_ns));
        }
        let repeats = missing.min(most);
        self.written += repeats + 1;
        repeats as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn video_outputs_are_recognised_by_name() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("a.mp4")).unwrap();
        assert!(["x.mp4", "x.MKV", "a/b.webm", "x.mov", "x.avi"].iter().all(|name| is_video(&folder.path().join(name))));
        assert!(["a.mp4", "overlay", "x.2026", "x.png", ".mp4"].iter().all(|name| !is_video(&folder.path().join(name))));
    }

    #[test]
    fn a_missing_ffmpeg_is_named_with_a_hint() {
        let refused = refuse_without(Path::new("seen.mp4"), "no-such-program-as-this").unwrap_err();
        assert!(
            matches!(&refused, Failure::Usage(said) if said.contains("seen.mp4") && said.contains("install") && said.contains("folder"))
        );
    }

    #[test]
    fn missing_rows_repeat_frames_and_jitter_does_not() {
        let mut pacing = Pacing { first: Timestamp::from_ns(5_000), interval_ns: 100, written: 0 };
        let stamps = [5_000, 5_110, 5_190, 5_300, 5_700, 5_790];
        assert_eq!(stamps.map(|ns| pacing.repeats_before(Timestamp::from_ns(ns))), [0, 0, 0, 0, 3, 0]);
        // Faster than the rate: every frame is shown.
        assert_eq!([5_820, 5_840, 5_860].map(|ns| pacing.repeats_before(Timestamp::from_ns(ns))), [0, 0, 0]);
        assert_eq!(
            [i64::MAX, i64::MIN]
                .map(|ns| Pacing { first: Timestamp::default(), interval_ns: 1 << 30, written: 0 }.repeats_before(Timestamp::from_ns(ns))),
            [9, 0]
        );
        // After a jump of hours the video continues at its rate.
        let mut pacing = Pacing { first: Timestamp::default(), interval_ns: 1_000_000_000, written: 0 };
        assert_eq!([0, 3_600_000_000_000, 3_601_000_000_000].map(|ns| pacing.repeats_before(Timestamp::from_ns(ns))), [0, 10, 0]);
    }

    #[test]
    fn the_rate_is_the_median_of_the_first_intervals() {
        let held = |stamps: &[i64]| stamps.iter().map(|ns| (Timestamp::from_ns(*ns), RgbImage::new(1, 1))).collect::<Vec<_>>();
        assert_eq!(interval_ns(&held(&[0, 33, 500, 533])), 33);
        assert_eq!(interval_ns(&held(&[7])), SINGLE_FRAME_NS);
    }
}
