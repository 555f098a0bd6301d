//! A small text snapshot of what was learnt about a camera, to be kept from one session to the
//! next. The core exchanges bytes; the caller stores them.
//!
//! The first line states format and version; each further line is one statement. Later versions add
//! statements: each reads earlier versions, and refuses later ones.

use std::fmt::Write as _;

use thiserror::Error;

use crate::light::camera_curve::{Bend, KNOTS};
use crate::light::transfer::FULL;

/// Start of the first line.
const SNAPSHOT_HEAD: &str = "stagepose learnt camera";
/// Version of the format; raise it when the format changes.
const SNAPSHOT_VERSION: u32 = 2;
/// Maximum shutter time that is accepted, seconds; as in the config.
const MAX_SHUTTER_S: f64 = crate::camera::Shutter::MAX_S;

/// A learnt time and its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LearntTime {
    /// Seconds. A negative readout time means that rows are read from the bottom up.
    pub seconds: f64,
    /// One standard deviation, seconds.
    pub sigma_s: f64,
}

/// What is learnt about a camera. `None`: nothing, or the value is configured.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct LearntCamera {
    /// Readout time, first row to last.
    pub readout: Option<LearntTime>,
    /// Exposure time of each row.
    pub exposure: Option<LearntTime>,
    /// Corrections of the curve between light and grey at its knots, in units of light (white is
    /// 255).
    pub curve: Option<Bend>,
}

/// Why bytes are not a snapshot that this version can read.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum LearntError {
    /// Not a snapshot.
    #[error(
        "this is not what a camera taught; give a file that `stagepose run` or `record` keeps, or leave it out, and the camera is learnt anew"
    )]
    Foreign,
    /// A snapshot of another version.
    #[error("what was learnt is of version {0}, this program reads versions up to 2; leave it out, and the camera is learnt anew")]
    Version(String),
    /// A damaged line, by its number.
    #[error("line {0} of what was learnt is damaged; leave it out, and the camera is learnt anew")]
    Line(usize),
}

impl LearntCamera {
    /// Whether there is nothing to keep.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Serialises to text.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut text = format!("{SNAPSHOT_HEAD} {SNAPSHOT_VERSION}\n");
        for (name, time) in [("readout_s", self.readout), ("exposure_s", self.exposure)] {
            if let Some(LearntTime { seconds, sigma_s }) = time {
                // Writing to a string cannot fail.
                let _ = writeln!(text, "{name} {seconds:?} {sigma_s:?}");
            }
        }
        if let Some(bend) = self.curve {
            let _ = writeln!(text, "curve {}", bend.map(|correction| format!("{correction:?}")).join(" "));
        }
        text.into_bytes()
    }

    /// Parses what [`to_bytes`](Self::to_bytes) returned.
    ///
    /// # Errors
    /// If the bytes are something else, of another version, or damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, LearntError> {
        let text = std::str::from_utf8(bytes).map_err(|_| LearntError::Foreign)?;
        let mut lines = text.lines().enumerate();
        let version = lines.next().and_then(|(_, line)| line.strip_prefix(SNAPSHOT_HEAD)).ok_or(LearntError::Foreign)?.trim();
        if !version.parse().is_ok_and(|version: u32| (1..=SNAPSHOT_VERSION).contains(&version)) {
            return Err(LearntError::Version(version.chars().take(12).collect()));
        }
        let mut learnt = Self::default();
        for (number, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
            let damaged = LearntError::Line(number + 1);
            if let Some(corrections) = line.strip_prefix("curve ") {
                learnt.curve = Some(bend(corrections).ok_or(damaged)?);
                continue;
            }
            let words: Vec<&str> = line.split_whitespace().take(4).collect();
            let &[name, seconds, sigma_s] = words.as_slice() else { return Err(damaged) };
            let (Ok(seconds), Ok(sigma_s)) = (seconds.parse::<f64>(), sigma_s.parse::<f64>()) else { return Err(damaged) };
            let is_possible = seconds.abs() <= MAX_SHUTTER_S && sigma_s > 0.0 && sigma_s <= MAX_SHUTTER_S;
            let time = Some(LearntTime { seconds, sigma_s }).filter(|_| is_possible);
            match (name, time) {
                ("readout_s", Some(_)) => learnt.readout = time,
                ("exposure_s", Some(t)) if t.seconds > 0.0 => learnt.exposure = time,
                _ => return Err(damaged),
            }
        }
        Ok(learnt)
    }
}

/// Parses the corrections of a curve; `None` where they are damaged.
fn bend(text: &str) -> Option<Bend> {
    let corrections = text.split_whitespace().map(|word| word.parse().ok().filter(|correction: &f32| correction.abs() <= FULL));
    let corrections: Vec<f32> = corrections.take(KNOTS + 1).collect::<Option<_>>()?;
    corrections.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn learnt() -> LearntCamera {
        LearntCamera {
            readout: Some(LearntTime { seconds: -0.0201, sigma_s: 2e-4 }),
            exposure: Some(LearntTime { seconds: 0.012, sigma_s: 1e-3 }),
            curve: Some([0.5, 1.25, 3.0, 4.0, 2.0, -1.0, -2.5]),
        }
    }

    #[test]
    fn kept_data_reads_back() {
        for learnt in [learnt(), LearntCamera { readout: None, ..learnt() }, LearntCamera::default()] {
            assert_eq!(LearntCamera::from_bytes(&learnt.to_bytes()), Ok(learnt));
        }
    }

    #[test]
    fn other_versions_and_files_are_refused_with_the_reason() {
        let text = String::from_utf8(learnt().to_bytes()).unwrap();
        let later = LearntCamera::from_bytes(text.replace("camera 2", "camera 3").as_bytes()).unwrap_err();
        assert_eq!(later, LearntError::Version("3".to_owned()));
        assert!(later.to_string().contains("version 3") && later.to_string().contains("learnt anew"));
        for foreign in [&b""[..], b"\xff\xfe", b"[camera]\n", b"stagepose"] {
            assert_eq!(LearntCamera::from_bytes(foreign), Err(LearntError::Foreign));
        }
    }

    #[test]
    fn an_earlier_version_is_read() {
        let text = "stagepose learnt camera 1\nreadout_s 0.0201 0.0002\n";
        let readout = Some(LearntTime { seconds: 0.0201, sigma_s: 2e-4 });
        assert_eq!(LearntCamera::from_bytes(text.as_bytes()), Ok(LearntCamera { readout, ..LearntCamera::default() }));
    }

    #[test]
    fn damaged_lines_are_named() {
        let head = "stagepose learnt camera 2\n";
        for line in [
            "readout_s 0.01",
            "readout_s 0.01 0",
            "readout_s 0.01 -1",
            "readout_s NaN 0.1",
            "readout_s 0.01 inf",
            "readout_s 2 0.1",
            "exposure_s 0 0.1",
            "exposure_s -0.1 0.1",
            "tone 1 2",
            "curve 1 2 3 4 5 6",
            "curve 1 2 3 4 5 6 7 8",
            "curve 1 2 3 4 5 6 NaN",
            "curve 1 2 3 4 5 6 1e9",
            "readout_s 0.01 0.001 7",
        ] {
            assert_eq!(LearntCamera::from_bytes(format!("{head}{line}\n").as_bytes()), Err(LearntError::Line(2)), "{line}");
        }
    }
}
