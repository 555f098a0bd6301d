//! TUM trajectories: `t tx ty tz qx qy qz qw`, seconds and a quaternion from the camera's axes to
//! the world's.

use nalgebra::Vector3;

use super::{LogError, LoggedPose, lines, rotation};
use crate::frame::Timestamp;

/// Largest stamp, seconds: what nanoseconds in 64 bits hold.
const LATEST_S: f64 = 9e9;
/// Characters of a wrong word that a message repeats.
const REPEATED: usize = 40;

pub(super) fn read(bytes: &[u8]) -> Result<Vec<LoggedPose>, LogError> {
    let rows = lines(bytes).filter(|(_, text)| !text.starts_with(b"#"));
    rows.map(|(line, text)| row(text).map_err(|problem| LogError::Line { line, problem })).collect()
}

/// Reads a line; words are separated by blanks, or by commas as in spreadsheets.
fn row(text: &[u8]) -> Result<LoggedPose, String> {
    let text = String::from_utf8_lossy(text);
    let words: Vec<&str> = text.split(|c: char| c == ',' || c.is_whitespace()).filter(|word| !word.is_empty()).collect();
    let words: [&str; 8] = words
        .try_into()
        .map_err(|words: Vec<&str>| format!("{} numbers, not the 8 of a TUM line (t tx ty tz qx qy qz qw)", words.len()))?;
    let mut numbers = [0.0; 8];
    for (number, word) in numbers.iter_mut().zip(words) {
        let shown = || word.chars().take(REPEATED).collect::<String>();
        *number = word.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| format!("\"{}\" is not a number", shown()))?;
    }
    let [t, px, py, pz, x, y, z, w] = numbers;
    if t.abs() > LATEST_S {
        return Err(format!("the stamp {} is not in seconds", words[0].chars().take(REPEATED).collect::<String>()));
    }
    Ok(LoggedPose { at: Timestamp::from_seconds(t), rotation: rotation([x, y, z, w])?, position: Vector3::new(px, py, pz) })
}
