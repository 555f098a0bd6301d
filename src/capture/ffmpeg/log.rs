//! Parses ffmpeg's stderr line by line: pictures announced by the `showinfo` filter, and
//! complaints.

use crate::frame::Timestamp;

/// What showinfo states about one picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Announced {
    pub stamp: Option<Timestamp>,
    pub width: u32,
    pub height: u32,
    /// Bits per sample as written to the pipe: 8, or up to 16 in two bytes, little-endian.
    pub bits: u32,
    /// Width and height of a pixel, if the file states that they differ.
    pub pixel_shape: Option<(u32, u32)>,
    /// Whether the picture holds two fields that were taken one after the other.
    pub is_interlaced: bool,
}

/// State of ffmpeg's stderr, run with `-loglevel level+info`.
#[derive(Debug, Default)]
pub(super) struct Log {
    /// Seconds per tick, as a ratio.
    time_base: Option<(i64, i64)>,
    /// The first errors; the cause comes first.
    complaints: Vec<String>,
    /// Whether an error reports a file that ends too early.
    is_cut_off: bool,
}

/// Maximum number of complaints kept: the first is the most useful. Raised, a damaged file takes
/// more memory.
const MAX_COMPLAINTS: usize = 8;
/// Substrings of the messages in which ffmpeg's demuxers report a file that ends too early.
const CUT_OFF: [&str; 5] = ["moov atom not found", "partial file", "ended prematurely", "premature end", "truncat"];
/// Log levels of ffmpeg at which something is wrong with the file.
const COMPLAINT_LEVELS: [&str; 3] = ["[error] ", "[fatal] ", "[panic] "];

impl Log {
    /// Parses a line; returns a picture if the line announces one.
    pub fn note(&mut self, line: &str) -> Option<Announced> {
        if let Some((_, complaint)) = COMPLAINT_LEVELS.iter().find_map(|level| line.split_once(level)) {
            self.complain(complaint.trim());
        }
        let (_, message) = line.split_once("showinfo").and_then(|(_, rest)| rest.split_once("] "))?;
        if let Some(base) = word_after(message, "config in time_base:") {
            let (numerator, denominator) = base.trim_end_matches(',').split_once('/')?;
            self.time_base = Some((numerator.parse().ok()?, denominator.parse().ok()?));
            return None;
        }
        let (width, height) = word_after(message, " s:")?.split_once('x')?;
        let ticks = word_after(message, " pts:").and_then(|t| t.parse::<i64>().ok());
        let shape =
            word_after(message, " sar:").and_then(|s| s.split_once('/')).and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
        Some(Announced {
            stamp: ticks.zip(self.time_base).and_then(|(ticks, base)| stamp_of(ticks, base)),
            width: width.parse().ok()?,
            height: height.parse().ok()?,
            bits: word_after(message, " fmt:").map_or(8, bits_of),
            pixel_shape: shape.filter(|(w, h)| *w > 0 && *h > 0 && w != h),
            is_interlaced: matches!(word_after(message, " i:"), Some("T" | "B")),
        })
    }

    fn complain(&mut self, complaint: &str) {
        let lower = complaint.to_ascii_lowercase();
        self.is_cut_off |= CUT_OFF.iter().any(|words| lower.contains(words));
        if self.complaints.len() < MAX_COMPLAINTS && !complaint.is_empty() {
            self.complaints.push(complaint.to_owned());
        }
    }

    /// Whether ffmpeg reports that the file ends too early.
    pub fn is_cut_off(&self) -> bool {
        self.is_cut_off
    }

    /// Returns the first complaint.
    pub fn complaint(&self) -> Option<&str> {
        self.complaints.first().map(String::as_str)
    }
}

/// Returns the bits per sample of a grey format ("gray", "gray10le") or of the RGB formats that are
/// requested.
fn bits_of(format: &str) -> u32 {
    match format {
        "rgb48le" => 16,
        other => other.strip_prefix("gray").and_then(|rest| rest.trim_end_matches("le").parse().ok()).unwrap_or(8),
    }
}

pub(super) fn word_after<'a>(line: &'a str, name: &str) -> Option<&'a str> {
    line.split_once(name)?.1.split_whitespace().next()
}

/// Converts ticks of numerator / denominator seconds to a stamp, rounded.
fn stamp_of(ticks: i64, (numerator, denominator): (i64, i64)) -> Option<Timestamp> {
    let doubled = (i128::from(ticks) * i128::from(numerator)).checked_mul(2_000_000_000)?;
    let denominator = i128::from(denominator);
    let ns = (denominator > 0).then(|| (doubled + denominator).div_euclid(2 * denominator))?;
    i64::try_from(ns).ok().map(Timestamp::from_ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = "[Parsed_showinfo_2 @ 0x55] [info] n:   1 pts:    512 pts_time:0.04    pos:    40462 fmt:gray sar:1/1 s:640x480 i:P iskey:0 type:B ";

    #[test]
    fn showinfo_lines_become_stamps() {
        let mut log = Log::default();
        assert_eq!(log.note("[Parsed_showinfo_2 @ 0x55] [info] config in time_base: 1/12800, frame_rate: 25/1"), None);
        let stamp = Some(Timestamp::from_ns(40_000_000));
        let plain = Announced { stamp, width: 640, height: 480, bits: 8, pixel_shape: None, is_interlaced: false };
        assert_eq!(log.note(LINE), Some(plain));
        assert_eq!(log.note("[Parsed_showinfo_2 @ 0x55] [info] color_range:unknown color_space:unknown"), None);
        assert_eq!(log.note(&LINE.replace("512", "NOPTS")).unwrap().stamp, None);
        let other = LINE.replace("sar:1/1", "sar:4/3").replace("i:P", "i:T").replace("fmt:gray", "fmt:gray12le");
        assert_eq!(log.note(&other), Some(Announced { bits: 12, pixel_shape: Some((4, 3)), is_interlaced: true, ..plain }));
        assert_eq!(log.note(&LINE.replace("sar:1/1", "sar:0/1")), Some(plain), "a shape that is not known is none");
        assert_eq!(stamp_of(1, (1001, 30_000)), Some(Timestamp::from_ns(33_366_667)));
        assert_eq!(stamp_of(-1, (1, 3)), Some(Timestamp::from_ns(-333_333_333)));
        assert_eq!((stamp_of(1, (1, 0)), stamp_of(i64::MAX, (i64::MAX, 1))), (None, None));
    }

    #[test]
    fn the_first_error_is_kept_and_truncation_is_detected() {
        let mut log = Log::default();
        log.note("[info] Input #0, truncated, from 'a.mp4':");
        assert_eq!((log.complaint(), log.is_cut_off()), (None, false));
        log.note("[Parsed_extractplanes_0 @ 0x55] [error] Requested planes not available.");
        log.note("[error] Conversion failed!");
        assert_eq!((log.complaint(), log.is_cut_off()), (Some("Requested planes not available."), false));
        log.note("[mov,mp4 @ 0x55] [error] stream 0, offset 0x30a5: partial file");
        assert!(log.is_cut_off());
    }
}
