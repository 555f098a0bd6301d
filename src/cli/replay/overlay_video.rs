//! `--overlay FILE.mp4`: the overlay's pictures as a video, encoded by an installed ffmpeg as a child process.
//!
//! Videos have one rate and clips need not. So the rate is that of the clip's first frames, every frame is shown, and where
//! rows are missing the last picture stands until the next one, or the video would run ahead of its clip.

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

/// The program that encodes.
const PROGRAM: &str = "ffmpeg";
/// Intervals between frames whose median is the rate: the least number whose median one gap does not change. Their pictures are held in
/// memory until it is known; raised, more are.
const INTERVALS: usize = 3;
/// The rate of a clip of one frame, nanoseconds a frame: 25 a second. Any rate would do for a single picture.
const SINGLE_FRAME_NS: i64 = 1_000_000_000 / 25;
/// The longest that one picture stands for missing rows, nanoseconds: stamps may jump by hours. Chosen, not tuned. Raised, a jump makes a
/// longer still in the video.
const LONGEST_STAND_NS: i64 = 10_000_000_000;

/// Ends of names that mean a video, and how ffmpeg is to encode it. The qualities (`-crf`) are chosen, not tuned; raised, videos are
/// smaller and worse.
const FORMS: [(&str, &str); 6] = [
    ("mp4", H264_AT_ONCE),
    ("m4v", H264_AT_ONCE),
    ("mov", H264_AT_ONCE),
    ("mkv", "-c:v libx264 -preset veryfast -crf 20 -pix_fmt yuv420p"),
    ("webm", "-c:v libvpx-vp9 -b:v 0 -crf 30 -deadline realtime -cpu-used 8 -row-mt 1 -pix_fmt yuv420p"),
    ("avi", "-c:v mjpeg -q:v 3 -pix_fmt yuvj420p"),
];
/// H.264 with the index in front, so that a browser plays it while it loads.
const H264_AT_ONCE: &str = "-c:v libx264 -preset veryfast -crf 20 -pix_fmt yuv420p -movflags +faststart";

/// How a file of this name is encoded; `None` where the name means a folder.
fn encoding(path: &Path) -> Option<&'static str> {
    let extension = path.extension()?.to_str()?.to_ascii_lowercase();
    FORMS.iter().find(|(end, _)| *end == extension && !path.is_dir()).map(|(_, arguments)| *arguments)
}

/// Whether a path means a video file and not a folder of pictures.
pub(super) fn is_video(path: &Path) -> bool {
    encoding(path).is_some()
}

/// Refuses before anything is tracked where the program that encodes is missing.
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

/// A video under way.
pub(super) struct VideoFile {
    path: PathBuf,
    /// Stamps and pictures, until the rate is known.
    held: Vec<(Timestamp, RgbImage)>,
    encoder: Option<Encoder>,
}

impl VideoFile {
    /// Nothing is made before the first picture comes.
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), held: Vec::new(), encoder: None }
    }

    /// Adds a picture; all are of one size.
    pub fn write(&mut self, timestamp: Timestamp, picture: RgbImage) -> Result<(), Failure> {
        match &mut self.encoder {
            Some(encoder) => encoder.add(timestamp, picture),
            None => {
                self.held.push((timestamp, picture));
                if self.held.len() > INTERVALS { self.begin() } else { Ok(()) }
            }
        }
    }

    /// Starts ffmpeg and hands it what was held.
    fn begin(&mut self) -> Result<(), Failure> {
        let Some((first, picture)) = self.held.first() else { return Ok(()) };
        let mut encoder = Encoder::start(&self.path, picture.dimensions(), (*first, interval_ns(&self.held)))?;
        for (timestamp, picture) in self.held.drain(..) {
            encoder.add(timestamp, picture)?;
        }
        self.encoder = Some(encoder);
        Ok(())
    }

    /// Ends the file. Without a picture there is none.
    pub fn finish(mut self) -> Result<(), Failure> {
        self.begin()?;
        self.encoder.take().map_or(Ok(()), Encoder::finish)
    }
}

/// The median of the intervals between stamps.
fn interval_ns(held: &[(Timestamp, RgbImage)]) -> i64 {
    let mut intervals: Vec<i64> = held.windows(2).map(|pair| pair[1].0.ns_since(pair[0].0)).collect();
    intervals.sort_unstable();
    intervals.get(intervals.len() / 2).copied().filter(|interval| *interval > 0).unwrap_or(SINGLE_FRAME_NS)
}

/// A running ffmpeg.
struct Encoder {
    path: PathBuf,
    child: Child,
    /// Gone once the last picture is in.
    pictures: Option<ChildStdin>,
    /// What it says of errors, once it has ended.
    complaints: Option<JoinHandle<String>>,
    pacing: Pacing,
    last: Option<RgbImage>,
}

impl Encoder {
    fn start(path: &Path, (width, height): (u32, u32), (first, interval_ns): (Timestamp, i64)) -> Result<Self, Failure> {
        // Empties the file, and refuses what is no plain one, in words of our own.
        safe_file::replace(path).map_err(Failure::output(path))?;
        let arguments = encoding(path).unwrap_or(H264_AT_ONCE);
        // The prefix keeps a name with a colon or a leading dash from being read as a protocol or an option.
        let mut output = OsString::from("file:");
        output.push(path);
        let mut child = Command::new(PROGRAM)
            .args(["-hide_banner", "-nostats", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args(["-video_size", &format!("{width}x{height}"), "-framerate", &format!("1000000000/{interval_ns}"), "-i", "pipe:0"])
            // The codecs halve the colours' size, so sides must be even.
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2,scale=out_color_matrix=bt709"])
            .args(["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709"])
            .args(arguments.split(' '))
            .arg(output)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            // Ctrl-C in the terminal is for this program, which then ends the video as it should.
            .process_group(0)
            .spawn()
            .map_err(Failure::output(path))?;
        let (pictures, complaints) = (child.stdin.take(), child.stderr.take());
        let pacing = Pacing { first, interval_ns, written: 0 };
        // From here on a failure ends the program that was started.
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

    /// What ffmpeg said itself says more than what became of the pipe.
    fn failure(&mut self, otherwise: &str) -> Failure {
        self.pictures = None;
        let said = self.complaints.take().and_then(|listener| listener.join().ok()).filter(|said| !said.is_empty());
        let reason = said.unwrap_or_else(|| otherwise.to_owned());
        Failure::output(&self.path)(io::Error::other(format!("{PROGRAM}: {reason}")))
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        // Where it was finished there is nothing to kill and nothing lost.
        self.pictures = None;
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The last line that ffmpeg says; read to the end, or it would block on a full pipe.
fn last_words(mut from: ChildStderr) -> String {
    let mut said = Vec::new();
    let mut piece = [0; 4096];
    while let Ok(1..) = from.read(&mut piece).inspect(|&n| said.extend_from_slice(&piece[..n])) {
        // A few lines are enough to find the last one in.
        said.drain(..said.len().saturating_sub(8 * piece.len()));
    }
    String::from_utf8_lossy(&said).lines().map(str::trim).rfind(|line| !line.is_empty()).unwrap_or_default().to_owned()
}

/// Which picture of the video is due at which stamp.
struct Pacing {
    first: Timestamp,
    interval_ns: i64,
    written: i64,
}

impl Pacing {
    /// How often the picture before has to be shown again before the one of this stamp, which is counted in.
    fn repeats_before(&mut self, timestamp: Timestamp) -> usize {
        let since_ns = timestamp.ns_since(self.first);
        let due = since_ns.saturating_add(self.interval_ns / 2).div_euclid(self.interval_ns);
        let most = LONGEST_STAND_NS / self.interval_ns;
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
    fn names_tell_videos_from_folders() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("a.mp4")).unwrap();
        assert!(["x.mp4", "x.MKV", "a/b.webm", "x.mov", "x.avi"].iter().all(|name| is_video(&folder.path().join(name))));
        assert!(["a.mp4", "overlay", "x.2026", "x.png", ".mp4"].iter().all(|name| !is_video(&folder.path().join(name))));
    }

    #[test]
    fn a_missing_program_is_named_with_the_mend() {
        let refused = refuse_without(Path::new("seen.mp4"), "no-such-program-as-this").unwrap_err();
        assert!(
            matches!(&refused, Failure::Usage(said) if said.contains("seen.mp4") && said.contains("install") && said.contains("folder"))
        );
    }

    #[test]
    fn missing_rows_are_bridged_and_jitter_is_not() {
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
        // After a jump of hours the video goes on at its rate.
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
