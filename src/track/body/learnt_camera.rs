//! What a camera's pictures taught, as a small snapshot that outlives a session: bytes to whoever keeps it.
//!
//! The text is one statement a line, the first names the form. More statements come with later versions; each version refuses all others.

use std::fmt::Write as _;

use thiserror::Error;

/// The first line.
const HEAD: &str = "stagepose learnt camera";
/// Version of the form.
const VERSION: u32 = 1;
/// Longest snapshot that is read, bytes: far more than any has. A round figure.
pub const MAX_LEARNT_BYTES: u64 = 64 << 10;
/// Longest time of a shutter that is believed, seconds, as in a config.
const MAX_S: f64 = crate::camera::Shutter::MAX_S;

/// A time that was learnt, and how sure it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LearntTime {
    /// Seconds. A readout is below 0 where the rows are read from the bottom up.
    pub seconds: f64,
    /// One standard deviation, seconds.
    pub sigma_s: f64,
}

/// What is known of a camera by its pictures. `None`: nothing, or it is configured.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct LearntCamera {
    /// First row to last.
    pub readout: Option<LearntTime>,
    /// How long each row is exposed.
    pub exposure: Option<LearntTime>,
}

/// Why bytes are no snapshot that this version can use.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum LearntError {
    /// Something else.
    #[error(
        "this is not what a camera taught; give a file that `stagepose run` or `record` keeps, or leave it out, and the camera is learnt anew"
    )]
    Foreign,
    /// Of another version.
    #[error("what was learnt is of version {0}, this program reads version 1; leave it out, and the camera is learnt anew")]
    Version(String),
    /// A line that does not fit.
    #[error("line {0} of what was learnt is damaged; leave it out, and the camera is learnt anew")]
    Line(usize),
}

impl LearntCamera {
    /// Whether there is nothing to keep.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// As text, to be kept.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut text = format!("{HEAD} {VERSION}\n");
        for (name, time) in [("readout_s", self.readout), ("exposure_s", self.exposure)] {
            if let Some(LearntTime { seconds, sigma_s }) = time {
                // Writing to a string cannot fail.
                let _ = writeln!(text, "{name} {seconds:?} {sigma_s:?}");
            }
        }
        text.into_bytes()
    }

    /// Reads what [`to_bytes`](Self::to_bytes) wrote.
    ///
    /// # Errors
    /// When it is something else, of another version, or damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, LearntError> {
        let text = std::str::from_utf8(bytes).map_err(|_| LearntError::Foreign)?;
        let mut lines = text.lines().enumerate();
        let version = lines.next().and_then(|(_, line)| line.strip_prefix(HEAD)).ok_or(LearntError::Foreign)?.trim();
        if version.parse() != Ok(VERSION) {
            return Err(LearntError::Version(version.chars().take(12).collect()));
        }
        let mut learnt = Self::default();
        for (number, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
            let damaged = LearntError::Line(number + 1);
            let words: Vec<&str> = line.split_whitespace().take(4).collect();
            let &[name, seconds, sigma_s] = words.as_slice() else { return Err(damaged) };
            let (Ok(seconds), Ok(sigma_s)) = (seconds.parse::<f64>(), sigma_s.parse::<f64>()) else { return Err(damaged) };
            let is_possible = seconds.abs() <= MAX_S && sigma_s > 0.0 && sigma_s <= MAX_S;
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

#[cfg(test)]
mod tests {
    use super::*;

    fn learnt() -> LearntCamera {
        LearntCamera {
            readout: Some(LearntTime { seconds: -0.0201, sigma_s: 2e-4 }),
            exposure: Some(LearntTime { seconds: 0.012, sigma_s: 1e-3 }),
        }
    }

    #[test]
    fn what_is_kept_comes_back() {
        for learnt in [learnt(), LearntCamera { readout: None, ..learnt() }, LearntCamera::default()] {
            assert_eq!(LearntCamera::from_bytes(&learnt.to_bytes()), Ok(learnt));
        }
    }

    #[test]
    fn other_versions_and_other_files_are_refused_with_a_sentence() {
        let text = String::from_utf8(learnt().to_bytes()).unwrap();
        let later = LearntCamera::from_bytes(text.replace("camera 1", "camera 2").as_bytes()).unwrap_err();
        assert_eq!(later, LearntError::Version("2".to_owned()));
        assert!(later.to_string().contains("version 2") && later.to_string().contains("learnt anew"));
        for foreign in [&b""[..], b"\xff\xfe", b"[camera]\n", b"stagepose"] {
            assert_eq!(LearntCamera::from_bytes(foreign), Err(LearntError::Foreign));
        }
    }

    #[test]
    fn damaged_lines_are_named() {
        let head = "stagepose learnt camera 1\n";
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
            "readout_s 0.01 0.001 7",
        ] {
            assert_eq!(LearntCamera::from_bytes(format!("{head}{line}\n").as_bytes()), Err(LearntError::Line(2)), "{line}");
        }
    }
}
