//! Reads timestamps.csv in EuRoC's format: a header, then one line per picture with nanoseconds and
//! file name.

use std::io::Read;

use crate::frame::Timestamp;

/// One line of the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StampRow {
    /// The stamp, or what is wrong with it.
    pub stamp: Result<Timestamp, String>,
    /// The picture's file name as written; empty where the line has none.
    pub file: String,
}

/// Why a timestamps.csv cannot be read.
#[derive(Debug)]
pub enum TimestampsError {
    /// The first line is not `#timestamp [ns],filename`; holds the line found, shortened.
    Header(String),
    /// The file has no lines.
    Empty,
    /// The file cannot be read.
    Read(std::io::Error),
}

/// Reads all lines. Skips blank lines and later `#` lines; keeps lines with a bad stamp.
///
/// # Errors
/// When the header is missing or the input cannot be read.
pub fn read_timestamps(input: impl Read) -> Result<Vec<StampRow>, TimestampsError> {
    let mut reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).trim(csv::Trim::All).quoting(false).from_reader(input);
    let mut rows = Vec::new();
    let mut header_seen = false;
    let mut record = csv::ByteRecord::new();
    while reader.read_byte_record(&mut record).map_err(read_error)? {
        let field = |n: usize| String::from_utf8_lossy(record.get(n).unwrap_or_default()).trim_start_matches('\u{feff}').to_owned();
        let (first, second) = (field(0), field(1));
        if !header_seen {
            check_header(&first, &second)?;
            header_seen = true;
        } else if stands_for_a_row(first.as_bytes(), second.as_bytes()) {
            let stamp = first.parse().map(Timestamp::from_ns).map_err(|_| unreadable(&first));
            rows.push(StampRow { stamp, file: second });
        }
    }
    if header_seen { Ok(rows) } else { Err(TimestampsError::Empty) }
}

fn unreadable(text: &str) -> String {
    let hint = if text.parse::<f64>().is_ok() { "; are they seconds? multiply them by 1000000000 and leave out the fraction" } else { "" };
    format!("\"{}\" is not a time stamp in whole nanoseconds{hint}", shortened(text))
}

/// Whether a line after the header stands for a row, that is, is neither a comment nor empty.
pub fn is_row(line: &[u8]) -> bool {
    let mut fields = line.split(|byte| *byte == b',').map(<[u8]>::trim_ascii);
    stands_for_a_row(fields.next().unwrap_or_default(), fields.next().unwrap_or_default())
}

fn stands_for_a_row(first: &[u8], second: &[u8]) -> bool {
    !first.starts_with(b"#") && (!first.is_empty() || !second.is_empty())
}

fn check_header(first: &str, second: &str) -> Result<(), TimestampsError> {
    let plain = |s: &str| s.chars().filter(|c| !c.is_whitespace()).collect::<String>().to_ascii_lowercase();
    let good = plain(first) == "#timestamp[ns]" && plain(second) == "filename";
    if good { Ok(()) } else { Err(TimestampsError::Header(shortened(&format!("{first},{second}")))) }
}

pub(super) fn shortened(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(60).collect()
}

fn read_error(e: csv::Error) -> TimestampsError {
    let message = e.to_string();
    match e.into_kind() {
        csv::ErrorKind::Io(source) => TimestampsError::Read(source),
        _ => TimestampsError::Read(std::io::Error::other(message)),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn rows_keep_their_order_and_their_faults() {
        let text = "#timestamp [ns],filename\r\n10,a.png\r\n\r\nx,b.png\n20 , c d.png\n30\n# note\n";
        let rows = read_timestamps(text.as_bytes()).unwrap();
        let files: Vec<_> = rows.iter().map(|r| r.file.as_str()).collect();
        assert_eq!(files, ["a.png", "b.png", "c d.png", ""]);
        assert_eq!(
            (rows[0].stamp.clone(), rows[2].stamp.clone(), rows[3].stamp.clone()),
            (Ok(Timestamp::from_ns(10)), Ok(Timestamp::from_ns(20)), Ok(Timestamp::from_ns(30)))
        );
        assert!(rows[1].stamp.as_ref().unwrap_err().contains("\"x\""));
    }

    #[test]
    fn other_headers_are_refused() {
        for text in ["10,a.png\n", "#timestamp [s],filename\n1,a\n", "timestamp,filename\n"] {
            assert!(matches!(read_timestamps(text.as_bytes()), Err(TimestampsError::Header(_))), "{text}");
        }
        assert!(matches!(read_timestamps(&b""[..]), Err(TimestampsError::Empty)));
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let _ = read_timestamps(&bytes[..]);
            let _ = read_timestamps(&[b"#timestamp [ns],filename\n", &bytes[..]].concat()[..]);
        }

        #[test]
        fn written_data_reads_back(stamps in prop::collection::vec((any::<i64>(), "[a-z0-9_./-]{1,20}"), 0..20)) {
            let mut text = "#timestamp [ns],filename\n".to_owned();
            stamps.iter().for_each(|(t, f)| text += &format!("{t},{f}\n"));
            let rows = read_timestamps(text.as_bytes()).unwrap();
            let back: Vec<_> = rows.into_iter().map(|r| (r.stamp.unwrap().ns(), r.file)).collect();
            prop_assert_eq!(back, stamps);
        }
    }
}
