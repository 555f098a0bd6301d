//! `timecode.csv`: the timecode of a recording's rows, beside their records.
//!
//! One line per row that has a timecode: the row's stamp, its timecode, how far into the frame the
//! stamp lies, the rate, and the state.

use std::fmt::Write;

use thiserror::Error;

use super::code::Timecode;
use super::track::{StampedTimecode, TimecodeState};
use crate::frame::Timestamp;

/// The file's name in a recording.
pub const NAME: &str = "timecode.csv";
/// Its first line.
pub const HEAD: &str = "#timestamp [ns],timecode,fraction of the frame,rate,state,seconds without\n";
/// How long after a row its timecode still counts on, seconds; see the track's lock. Raised, a gap
/// between rows is filled.
const MAX_AFTER_S: f64 = 0.2;

/// Returns the line of a row, with its line end.
pub fn line(timestamp: Timestamp, timecode: &StampedTimecode) -> String {
    let StampedTimecode { code, fraction, rate, state } = timecode;
    let without_s = if let TimecodeState::FreeWheeling { for_s } = state { *for_s } else { 0.0 };
    let mut line = String::new();
    // Writing to a string does not fail.
    let _ = writeln!(line, "{},{code},{fraction:.6},{rate},{},{without_s:.3}", timestamp.ns(), state.word());
    line
}

/// Why a text is not such a file. Lines are counted from 1.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum TimecodeFileError {
    /// The bytes are not UTF-8.
    #[error("it is not text; give the timecode.csv of a recording, or a WAV file with timecode")]
    NotText,
    /// A line is damaged.
    #[error("line {line} has no {wanted}; give the timecode.csv of a recording as it was written")]
    Line {
        /// The line.
        line: usize,
        /// What is missing.
        wanted: &'static str,
    },
    /// Stamps do not rise.
    #[error("line {line}: its stamp is not later than the one before; give the timecode.csv of one recording as it was written")]
    Order {
        /// The line.
        line: usize,
    },
    /// There is no line.
    #[error("it has no timecode")]
    Empty,
}

/// The timecodes of a recording's rows.
#[derive(Debug, Clone, PartialEq)]
pub struct TimecodeRows(Vec<(Timestamp, StampedTimecode)>);

impl TimecodeRows {
    /// Reads a file.
    ///
    /// # Errors
    /// The first line that is damaged.
    pub fn parse(bytes: &[u8]) -> Result<Self, TimecodeFileError> {
        let text = std::str::from_utf8(bytes).map_err(|_| TimecodeFileError::NotText)?;
        let mut rows: Vec<(Timestamp, StampedTimecode)> = Vec::new();
        for (k, content) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#')) {
            let row = row(content).map_err(|wanted| TimecodeFileError::Line { line: k + 1, wanted })?;
            if rows.last().is_some_and(|last| last.0 >= row.0) {
                return Err(TimecodeFileError::Order { line: k + 1 });
            }
            rows.push(row);
        }
        if rows.is_empty() { Err(TimecodeFileError::Empty) } else { Ok(Self(rows)) }
    }

    /// Returns the timecode of an instant: a row's own, or shortly after it the one that follows
    /// from it.
    pub fn at(&self, at: Timestamp) -> Option<StampedTimecode> {
        let next = self.0.partition_point(|(stamp, _)| *stamp <= at);
        let (stamp, row) = self.0.get(next.checked_sub(1)?)?;
        let since_s = at.seconds_since(*stamp);
        if since_s > MAX_AFTER_S {
            return None;
        }
        let frames = row.fraction + since_s * row.rate.fps();
        let whole = frames.floor();
        let code = Timecode::of_number(i64::from(row.code.number(row.rate)) + whole as i64, row.rate);
        Some(StampedTimecode { code, fraction: frames - whole, ..*row })
    }
}

/// Reads a line; the error is what it does not have.
fn row(line: &str) -> Result<(Timestamp, StampedTimecode), &'static str> {
    let mut fields = line.trim_end().split(',');
    let mut field = || fields.next().unwrap_or_default();
    let stamp = field().parse().map(Timestamp::from_ns).map_err(|_| "stamp in whole nanoseconds")?;
    let code = field().parse().map_err(|()| "timecode such as 01:02:03:04")?;
    let fraction = field().parse().ok().filter(|f| (0.0..=1.0).contains(f)).ok_or("fraction from 0 to 1")?;
    let rate: super::TimecodeRate = field().parse().map_err(|()| "rate such as 25 or 29.97df")?;
    let word = field();
    let for_s = field().parse().ok().filter(|s: &f64| s.is_finite() && *s >= 0.0).ok_or("seconds without timecode")?;
    let state = match word {
        "locked" => TimecodeState::Locked,
        "free-wheeling" => TimecodeState::FreeWheeling { for_s },
        _ => return Err("state `locked` or `free-wheeling`"),
    };
    let code: Timecode = code;
    if code.frames >= rate.count() || code.is_drop != rate.is_drop() {
        return Err("timecode that fits its rate");
    }
    Ok((stamp, StampedTimecode { code, fraction, rate, state }))
}

#[cfg(test)]
mod tests {
    use super::super::TimecodeRate;
    use super::*;

    fn stamped(code: &str, rate: TimecodeRate, state: TimecodeState) -> StampedTimecode {
        StampedTimecode { code: code.parse().unwrap(), fraction: 0.25, rate, state }
    }

    #[test]
    fn rows_return_as_written() {
        let rows = [
            (40, stamped("01:02:03:04", TimecodeRate::Fps25, TimecodeState::Locked)),
            (1_000_000_040, stamped("01:02:04:04", TimecodeRate::Fps25, TimecodeState::FreeWheeling { for_s: 0.96 })),
            (2_000_000_000, stamped("23:59:59;29", TimecodeRate::Fps29_97Drop, TimecodeState::Locked)),
        ];
        let text: String = HEAD.to_owned() + &rows.iter().map(|(ns, row)| line(Timestamp::from_ns(*ns), row)).collect::<String>();
        let read = TimecodeRows::parse(text.as_bytes()).unwrap();
        for (ns, row) in &rows {
            assert_eq!(read.at(Timestamp::from_ns(*ns)), Some(*row));
        }
        assert_eq!((read.at(Timestamp::from_ns(39)), read.at(Timestamp::from_ns(900_000_000))), (None, None));
        // 0.75 of a frame later the next frame begins; after 23:59:59;29 comes 00:00:00;00.
        let next = read.at(Timestamp::from_ns(2_030_000_000)).unwrap();
        assert_eq!(next.code.to_string(), "00:00:00;00");
    }

    #[test]
    fn every_damaged_line_is_named() {
        for (bad, part) in [
            ("x,01:02:03:04,0.5,25,locked,0", "stamp"),
            ("1,01:02:03:31,0.5,25,locked,0", "timecode"),
            ("1,01:02:03:04,1.5,25,locked,0", "fraction"),
            ("1,01:02:03:04,NaN,25,locked,0", "fraction"),
            ("1,01:02:03:04,0.5,26,locked,0", "rate"),
            ("1,01:02:03:04,0.5,25,asleep,0", "state"),
            ("1,01:02:03:04,0.5,25,locked", "seconds"),
            ("1,01:02:03:24,0.5,24,locked,0", "fits its rate"),
            ("1,01:02:03;04,0.5,25,locked,0", "fits its rate"),
        ] {
            let error = TimecodeRows::parse(format!("{HEAD}{bad}\n").as_bytes()).unwrap_err();
            assert!(matches!(error, TimecodeFileError::Line { line: 2, wanted } if wanted.contains(part)), "{bad}: {error}");
        }
        let row = "7,01:02:03:04,0.5,25,locked,0\n";
        assert_eq!(TimecodeRows::parse(row.repeat(2).as_bytes()), Err(TimecodeFileError::Order { line: 2 }));
        assert_eq!(TimecodeRows::parse(HEAD.as_bytes()), Err(TimecodeFileError::Empty));
        assert_eq!(TimecodeRows::parse(&[0xFF]), Err(TimecodeFileError::NotText));
    }
}
