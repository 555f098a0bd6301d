//! Probes a video before its pictures are read: ffmpeg decodes one picture and its log is parsed.

use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::{Command, Stdio};

use super::log::{Log, word_after};
use crate::capture::remarks;

/// A video as described by ffmpeg.
#[derive(Debug, Default)]
pub(super) struct Probe {
    /// ffmpeg's version, if it has a number; development builds have none.
    pub version: Option<(u32, u32)>,
    /// ffmpeg's name of the pixel format, if a picture was decoded.
    pub pixels: Option<String>,
    /// Remarks about the file, one sentence each.
    pub notes: Vec<String>,
    /// The complaints, and whether the file is cut off.
    pub log: Log,
}

/// Containers that hold only coded pictures: ffmpeg makes up their stamps from a rate.
const WITHOUT_STAMPS: [&str; 14] =
    ["h264", "hevc", "vvc", "m4v", "mjpeg", "mpjpeg", "mjpeg_2000", "cavsvideo", "dirac", "vc1", "h261", "h263", "mpegvideo", "obu"];

/// Builds ffmpeg's command line up to and including its input. Pixels stay as they lie in the file,
/// whatever rotation the file asks for.
pub(super) fn command(program: &OsStr, path: &Path) -> Command {
    // The prefix keeps a name with a colon or a leading dash from being parsed as a protocol or an
    // option.
    let mut input = OsString::from("file:");
    input.push(path);
    let mut command = Command::new(program);
    command.args(["-nostdin", "-nostats", "-loglevel", "level+info", "-noautorotate", "-i"]).arg(input);
    // `V` excludes cover art.
    command.args(["-map", "0:V:0", "-an", "-sn", "-dn"]);
    command
}

impl Probe {
    /// Runs ffmpeg on a file up to its first picture.
    ///
    /// # Errors
    /// When ffmpeg cannot be run.
    pub fn of(program: &OsStr, path: &Path, has_own_rate: bool) -> std::io::Result<Self> {
        let arguments = ["-vf", "showinfo", "-frames:v", "1", "-f", "null", "-"];
        let output = command(program, path).args(arguments).stdin(Stdio::null()).output()?;
        let mut probe = Self::default();
        let info = probe.read(&String::from_utf8_lossy(&output.stderr));
        if let Some(degrees) = info.turned {
            let is_mirrored = display_matrix(program, path).is_some_and(|[a, b, c, d]| a * d < b * c);
            probe.notes.extend(remarks::shown_turned(degrees, is_mirrored));
        }
        if !has_own_rate && WITHOUT_STAMPS.contains(&info.container.as_str()) {
            probe.notes.push(remarks::rate_made_up(&info.rate.unwrap_or_else(|| "25".to_owned())));
        }
        Ok(probe)
    }

    fn read(&mut self, text: &str) -> StreamInfo {
        let mut info = StreamInfo::default();
        for line in text.lines() {
            self.log.note(line);
            if let Some(version) = word_after(line, "ffmpeg version ").filter(|_| self.version.is_none()) {
                let mut numbers = version.trim_start_matches('n').split(['.', '-']).map_while(|n| n.parse().ok());
                self.version = numbers.next().map(|major| (major, numbers.next().unwrap_or(0)));
            }
            if line.contains("showinfo") && line.contains(" pts:") && self.pixels.is_none() {
                self.pixels = word_after(line, " fmt:").map(str::to_owned);
            }
            info.note(line);
        }
        info
    }
}

/// The relevant part of ffmpeg's description of its input and output.
#[derive(Debug, Default)]
struct StreamInfo {
    container: String,
    /// Frames per second of the first video stream.
    rate: Option<String>,
    /// Counterclockwise rotation that the file asks for, degrees.
    turned: Option<f64>,
    /// Whether the output section has begun. The input section lists all streams, the output only
    /// the one that is read.
    is_output: bool,
}

impl StreamInfo {
    fn note(&mut self, line: &str) {
        if let Some((_, rest)) = line.split_once("Input #0, ") {
            self.container = rest.split([',', ' ']).next().unwrap_or_default().to_owned();
        }
        self.is_output |= line.contains("Output #0, ");
        if line.contains(": Video: ") && self.rate.is_none() && !self.is_output {
            let part = line.split(", ").find_map(|part| part.strip_suffix(" fps").or_else(|| part.strip_suffix(" tbr")));
            self.rate = part.map(|rate| rate.trim().to_owned());
        }
        // Only the rotation of the stream that is read, or of its picture, counts.
        if (self.is_output || line.contains("showinfo"))
            && let Some(degrees) = word_after(line, "displaymatrix: rotation of ").and_then(|d| d.parse().ok())
        {
            self.turned = Some(degrees);
        }
    }
}

/// Parses ffmpeg's description of a file: returns its pixel format, and the rotation in degrees
/// with which to show it.
pub fn ffmpeg_account(text: &str) -> (Option<String>, Option<f64>) {
    let mut probe = Probe::default();
    let turned = probe.read(text).turned;
    (probe.pixels, turned)
}

/// Reads the first two rows and columns of the display matrix, which ffmpeg itself does not print.
/// Needs ffprobe; `None` without it.
fn display_matrix(program: &OsStr, path: &Path) -> Option<[f64; 4]> {
    let mut probe = program.to_owned().into_string().ok()?;
    let at = probe.rfind("ffmpeg")?;
    probe.replace_range(at..at + 6, "ffprobe");
    let mut input = OsString::from("file:");
    input.push(path);
    let wanted = ["-v", "error", "-select_streams", "V:0", "-show_entries", "stream_side_data=displaymatrix"];
    let output = Command::new(probe).args(wanted).args(["-of", "default=nw=1:nk=1"]).arg(input).stdin(Stdio::null()).output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let rows: Vec<Vec<f64>> = text
        .lines()
        .filter_map(|line| line.split_once(':'))
        .map(|(_, numbers)| numbers.split_whitespace().filter_map(|n| n.parse().ok()).collect())
        .collect();
    match rows.as_slice() {
        [first, second, ..] => Some([*first.first()?, *first.get(1)?, *second.first()?, *second.get(1)?]),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> (Probe, StreamInfo) {
        let mut probe = Probe::default();
        let info = probe.read(text);
        (probe, info)
    }

    #[test]
    fn ffmpeg_probe_output_is_parsed() {
        let (probe, info) = read(
            "[info] ffmpeg version 5.1.9-0+deb12u1 Copyright (c) 2000-2026 the FFmpeg developers\n\
             [info] Input #0, mov,mp4,m4a,3gp,3g2,mj2, from 'file:a.mp4':\n\
             [info]   Stream #0:0[0x1](und): Video: h264 (High) (avc1 / 0x31637661), yuv420p(tv, progressive), 640x360, 29.97 fps, 30 tbr\n\
             [info]     Side data:\n[info]       displaymatrix: rotation of 90.00 degrees\n\
             [Parsed_showinfo_0 @ 0x5] [info] n:   0 pts:      0 pts_time:0 fmt:yuv420p sar:1/1 s:640x360 i:P iskey:1\n\
             [info] Output #0, null, to 'pipe:':\n[info]       displaymatrix: rotation of -90.00 degrees\n",
        );
        assert_eq!((probe.version, probe.pixels.as_deref(), info.container.as_str()), (Some((5, 1)), Some("yuv420p"), "mov"));
        assert_eq!((info.rate.as_deref(), info.turned), (Some("29.97"), Some(-90.0)), "of the stream that is read");
        let (probe, _) = read("[info] ffmpeg version n7.0.1 Copyright\n");
        assert_eq!(probe.version, Some((7, 0)));
        let (probe, info) = read("[info] ffmpeg version N-11-gabc Copyright\n[info] Input #0, h264, from 'a':\n");
        assert_eq!((probe.version, probe.pixels, info.container.as_str(), info.turned), (None, None, "h264", None));
    }
}
