//! An index of where the lines of large files begin. A recording of an hour has a hundred thousand
//! rows, and a request must not wait until all rows before the one it wants are read. A file is
//! scanned once; when it grows, only the new part is scanned. A recording in progress is read as
//! far as it is written.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::capture::timestamps::{StampRow, TimestampsError, is_row, read_timestamps};
use crate::safe_file;

/// Interval between indexed rows. Chosen: 64 records are 0.1 MB, which are read quickly. Raised,
/// more rows must be read before the wanted one; lowered, an hour takes more memory than its 13 kB.
const EACH: u64 = 64;
/// Maximum number of indexed files; a folder with a season's recordings has fewer. Raised, only
/// more memory.
const MAX_FILES: usize = 1000;
/// Bytes before the end of the scanned part by which the file is recognised. Chosen: a record's
/// last numbers. Raised, nothing is gained.
const TAIL: usize = 64;
/// The index of a clip.
const STAMPS: &str = "timestamps.csv";

/// What counts as a row in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Every line.
    Records,
    /// The data rows of a timestamps.csv: not its header, nor empty lines or comments.
    Stamps,
}

impl Kind {
    fn is_row(self, line: &[u8]) -> bool {
        self == Self::Records || is_row(line)
    }
}

/// What is known of a file.
#[derive(Debug, Default)]
struct Known {
    /// The header of a timestamps.csv.
    header: Vec<u8>,
    /// Bytes of complete lines so far, and the number of rows among them.
    read: u64,
    rows: u64,
    /// Where each indexed row begins.
    places: Vec<u64>,
    /// The last bytes before `read`.
    tail: Vec<u8>,
}

impl Known {
    /// Whether the index still fits this file.
    fn is_of(&self, file: &mut File) -> io::Result<bool> {
        if file.metadata()?.len() < self.read {
            return Ok(false);
        }
        let mut tail = vec![0; self.tail.len()];
        file.seek(SeekFrom::Start(self.read - self.tail.len() as u64))?;
        file.read_exact(&mut tail)?;
        Ok(tail == self.tail)
    }

    /// Indexes what has been appended to the file.
    fn follow(&mut self, file: &mut File, kind: Kind) -> io::Result<()> {
        file.seek(SeekFrom::Start(self.read))?;
        let (mut reader, mut line) = (BufReader::with_capacity(1 << 18, &*file), Vec::new());
        loop {
            line.clear();
            let length = reader.read_until(b'\n', &mut line)? as u64;
            if !line.ends_with(b"\n") {
                return Ok(());
            }
            if kind == Kind::Stamps && self.header.trim_ascii().is_empty() {
                self.header.clone_from(&line);
            } else if kind.is_row(&line) {
                if self.rows.is_multiple_of(EACH) {
                    self.places.push(self.read);
                }
                self.rows += 1;
            }
            self.read += length;
            self.tail.extend_from_slice(&line[line.len().saturating_sub(TAIL)..]);
            self.tail.drain(..self.tail.len().saturating_sub(TAIL));
        }
    }

    /// Returns the nearest indexed position at or before a row, and the number of rows in between.
    fn before(&self, row: u64) -> (u64, u64) {
        let k = (row / EACH).min((self.places.len() as u64).saturating_sub(1));
        // Without any indexed row, at most a header has been read.
        self.places.get(k as usize).map_or((self.read, row), |place| (*place, row - k * EACH))
    }
}

/// The indexes of all requested files.
#[derive(Debug, Default)]
pub(super) struct LineIndex(Mutex<HashMap<PathBuf, Known>>);

impl LineIndex {
    /// Returns `count` lines of a clip's file of records, starting at `from`, each with a line end.
    pub fn records(&self, clip: &Path, name: &str, from: u64, count: u64) -> io::Result<Vec<u8>> {
        let mut text = Vec::new();
        self.each((clip, name), Kind::Records, from, count, |line| {
            text.extend_from_slice(line);
            if !line.ends_with(b"\n") {
                text.push(b'\n');
            }
        })?;
        Ok(text)
    }

    /// Returns a row of a clip's timestamps.csv; `None` if it has fewer rows.
    pub fn stamp(&self, clip: &Path, row: u64) -> Result<Option<StampRow>, TimestampsError> {
        let mut text = Vec::new();
        let header = self.each((clip, STAMPS), Kind::Stamps, row, 1, |line| text.extend_from_slice(line)).map_err(TimestampsError::Read)?;
        Ok(read_timestamps([header, text].concat().as_slice())?.pop())
    }

    /// Returns the number of completely written rows of a clip's timestamps.csv.
    pub fn rows(&self, clip: &Path) -> io::Result<u64> {
        self.each((clip, STAMPS), Kind::Stamps, 0, 0, |_| {})?;
        let known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(known.get(&clip.join(STAMPS)).map_or(0, |known| known.rows))
    }

    /// Calls `take` with `count` rows of a clip's file, starting at `from`; returns the file's
    /// header.
    fn each(&self, (clip, name): (&Path, &str), kind: Kind, from: u64, count: u64, mut take: impl FnMut(&[u8])) -> io::Result<Vec<u8>> {
        let mut file = safe_file::open_below(clip, Path::new(name))?;
        let path = clip.join(name);
        let ((place, mut between), header) = {
            let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            if all.len() >= MAX_FILES && !all.contains_key(&path) {
                all.clear();
            }
            let known = all.entry(path).or_default();
            if !known.is_of(&mut file)? {
                *known = Known::default();
            }
            known.follow(&mut file, kind)?;
            (known.before(from), known.header.clone())
        };
        if count == 0 {
            return Ok(header);
        }
        file.seek(SeekFrom::Start(place))?;
        let (mut reader, mut line, mut left) = (BufReader::new(file), Vec::new(), count);
        while left > 0 {
            line.clear();
            if reader.read_until(b'\n', &mut line)? == 0 {
                break;
            }
            match (kind.is_row(&line), between) {
                (false, _) => {}
                (true, 0) => {
                    take(&line);
                    left -= 1;
                }
                (true, _) => between -= 1,
            }
        }
        Ok(header)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn indexed_rows_match_a_full_read_while_the_file_grows() {
        let folder = tempfile::tempdir().unwrap();
        let clip = folder.path();
        let (csv, poses) = (clip.join("timestamps.csv"), clip.join("poses.jsonl"));
        let index = LineIndex::default();
        let mut text = "#timestamp [ns],filename\n".to_owned();
        let mut records = String::new();
        for from in [0, 1, 63, 64, 65, 200, 1000] {
            for k in from..from + 90 {
                text += &format!("{},{k}.jpg\r\n", 10 * k);
                text += ["", "\n", "# a remark\n", " , \n", ",,neither\n"][k % 5];
                records += &format!("{{\"sequence\":{k}}}\n{}", if k % 7 == 0 { "\n" } else { "" });
            }
            // The last line is only partly written.
            std::fs::write(&csv, format!("{text}9")).unwrap();
            std::fs::write(&poses, format!("{records}{{\"seq")).unwrap();
            let whole = read_timestamps(std::fs::read(&csv).unwrap().as_slice()).unwrap();
            assert_eq!(index.rows(clip).unwrap(), whole.len() as u64 - 1);
            for row in [0, 1, 62, 63, 64, 65, 88, 89, whole.len() / 2, whole.len() - 2, whole.len() - 1, whole.len(), 9999] {
                assert_eq!(index.stamp(clip, row as u64).unwrap().as_ref(), whole.get(row), "{row} of {}", whole.len());
            }
            let lines: Vec<&str> = records.lines().chain(["{\"seq"]).collect();
            for (from, count) in [(0, 3), (60, 9), (64, 1), (lines.len() - 2, 5), (lines.len(), 2), (77_777, 1)] {
                let wanted: String = lines.iter().skip(from).take(count).map(|line| format!("{line}\n")).collect();
                assert_eq!(
                    String::from_utf8(index.records(clip, "poses.jsonl", from as u64, count as u64).unwrap()).unwrap(),
                    wanted,
                    "{from}"
                );
            }
        }
        // A different file in its place, shorter or longer.
        for rows in [3, 4000] {
            let text: String = (0..rows).map(|k| format!("{{\"other\":{k}}}\n")).collect();
            std::fs::write(&poses, text).unwrap();
            assert_eq!(index.records(clip, "poses.jsonl", rows - 1, 2).unwrap(), format!("{{\"other\":{}}}\n", rows - 1).as_bytes());
        }
        let mut file = std::fs::OpenOptions::new().append(true).open(&csv).unwrap();
        file.write_all(b"99\n").unwrap();
        assert!(matches!(index.stamp(&clip.join("none"), 0), Err(TimestampsError::Read(_))));
        std::fs::write(&csv, "no header\n1,a.jpg\n").unwrap();
        assert!(matches!(index.stamp(clip, 0), Err(TimestampsError::Header(_))));
    }
}
