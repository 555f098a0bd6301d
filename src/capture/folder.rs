//! Clips that are folders (pictures with a timestamps.csv, or just pictures in the order of their
//! names), and single pictures.

use std::path::{Component, Path, PathBuf};

use super::error::CaptureError;
use super::foreign;
use super::grey::MAX_PICTURE_FILE;
use super::order::AHEAD;
use super::picture_stream::{Picture, PictureData, PictureStream};
use super::rate::FrameRate;
use super::timestamps::{StampRow, TimestampsError, read_timestamps, shortened};
use super::{remarks, stamp_unit};
use crate::camera::utf16;
use crate::frame::Timestamp;
use crate::safe_file;

/// Names of a stamp file: this project's and EuRoC's.
const STAMP_FILES: [&str; 2] = ["timestamps.csv", "data.csv"];
/// Subfolders of the clip's folder that are searched for a named picture.
const PICTURE_FOLDERS: [&str; 3] = ["frames", "", "data"];
/// File extensions, in any case, that count as pictures where no list names them.
pub const PICTURE_EXTENSIONS: [&str; 7] = ["png", "jpg", "jpeg", "pgm", "ppm", "pnm", "pbm"];

/// Maximum size of a stamp file, bytes: about five million rows, a day at 60 per second. All rows
/// are held in memory. Raised, a wrong file takes more of it.
const MAX_STAMP_FILE: u64 = 256 << 20;

/// Opens a folder as a clip. The rates apply to pictures without stamps: `given`, else `default`.
pub(super) fn open(folder: &Path, given: Option<FrameRate>, default: FrameRate) -> Result<Box<dyn PictureStream>, CaptureError> {
    for name in STAMP_FILES {
        let csv = folder.join(name);
        match safe_file::read(&csv, MAX_STAMP_FILE) {
            Ok(bytes) => return stamped(folder, &csv, &utf16::as_utf8(&bytes)),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {}
            Err(e) => return Err(CaptureError::reading(&csv, e)),
        }
    }
    let mut files = pictures_in(folder)?;
    if files.is_empty() && folder.join("frames").is_dir() {
        files = pictures_in(&folder.join("frames"))?;
    }
    if let Some((first, second)) = counted_otherwise(&files) {
        tracing::warn!(
            "{}: pictures are taken in the order of their names, letter by letter: {first} comes before {second}; number them with leading zeros",
            folder.display()
        );
    }
    if files.is_empty() {
        let path = folder.to_owned();
        let found = foreign::in_folder(folder).or_else(|| foreign::in_folder(&folder.join("frames")));
        return Err(found.map_or(CaptureError::Empty { path: path.clone() }, |found| CaptureError::OtherPictures { path, found }));
    }
    let note = (given.is_none() && files.len() > 1).then(|| remarks::rate_made_up(&default.to_string()));
    Ok(Box::new(NamedPictures { files: files.into_iter(), rate: given.unwrap_or(default), next: 0, note }))
}

/// Opens a single picture as a clip of one frame.
pub(super) fn single(file: &Path, rate: FrameRate) -> Box<dyn PictureStream> {
    Box::new(NamedPictures { files: vec![file.to_owned()].into_iter(), rate, next: 0, note: None })
}

fn stamped(folder: &Path, csv: &Path, bytes: &[u8]) -> Result<Box<dyn PictureStream>, CaptureError> {
    let path = csv.to_owned();
    let rows = read_timestamps(bytes).map_err(|e| match e {
        TimestampsError::Header(found) => CaptureError::TimestampsHeader { path, found },
        TimestampsError::Empty => CaptureError::Empty { path },
        TimestampsError::Read(source) => CaptureError::reading(csv, source),
    })?;
    if let Some(row) = rows.iter().find(|row| leads_outside(&row.file)) {
        return Err(CaptureError::OutsideClip { path: csv.to_owned(), line: line_with(bytes, &row.file), name: shortened(&row.file) });
    }
    let stamps: Vec<Timestamp> = rows.iter().filter_map(|row| row.stamp.clone().ok()).collect();
    let doubt = stamp_unit::doubt(&stamps).map(|words| format!("{}: {words}", csv.display()));
    Ok(Box::new(StampedPictures { folder: folder.to_owned(), rows: rows.into_iter(), doubt }))
}

/// Returns the first line, from 1, that contains a text. The row reader skips blank lines without
/// counting them.
fn line_with(bytes: &[u8], text: &str) -> usize {
    let has = |line: &[u8]| String::from_utf8_lossy(line).contains(text);
    bytes.split(|byte| *byte == b'\n').position(has).map_or(1, |before| before + 1)
}

/// Whether a name leads out of the folder in which it is searched.
fn leads_outside(name: &str) -> bool {
    Path::new(name).components().any(|part| !matches!(part, Component::Normal(_) | Component::CurDir))
}

/// Returns the picture files of a folder in byte order of their names.
fn pictures_in(folder: &Path) -> Result<Vec<PathBuf>, CaptureError> {
    let unreadable = |e| CaptureError::reading(folder, e);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        let hidden = path.file_name().is_some_and(|n| n.as_encoded_bytes().starts_with(b"."));
        if PICTURE_EXTENSIONS.contains(&extension.as_str()) && !hidden && path.is_file() {
            files.push(path);
        }
    }
    files.sort_by(|a, b| a.as_os_str().as_encoded_bytes().cmp(b.as_os_str().as_encoded_bytes()));
    Ok(files)
}

/// Returns the first two consecutive names that people would sort the other way round: 10 comes
/// before 9.
fn counted_otherwise(files: &[PathBuf]) -> Option<(String, String)> {
    let pair = files.windows(2).find(|pair| alphanumeric_sort::compare_path(&pair[0], &pair[1]).is_gt())?;
    let name = |file: &PathBuf| file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Some((name(&pair[0]), name(&pair[1])))
}

/// Pictures named by a timestamps.csv.
struct StampedPictures {
    folder: PathBuf,
    rows: std::vec::IntoIter<StampRow>,
    doubt: Option<String>,
}

impl PictureStream for StampedPictures {
    fn next_picture(&mut self) -> Option<Picture> {
        let StampRow { stamp, file } = self.rows.next()?;
        if file.is_empty() {
            return Some(Picture { stamp, data: PictureData::Missing("the row names no picture".to_owned()) });
        }
        let candidates = PICTURE_FOLDERS.map(|place| self.folder.join(place).join(&file));
        let path = candidates.iter().find(|p| p.exists()).unwrap_or(&candidates[0]);
        Some(Picture { stamp, data: read(path) })
    }

    fn stamps_ahead(&self) -> Vec<Timestamp> {
        self.rows.as_slice().iter().filter_map(|row| row.stamp.as_ref().ok().copied()).take(AHEAD).collect()
    }

    fn doubt_of_stamps(&self) -> Option<String> {
        self.doubt.clone()
    }

    fn pictures(&self) -> Option<u64> {
        Some(self.rows.len() as u64)
    }
}

/// Pictures in the order of their names, at a constant rate.
struct NamedPictures {
    files: std::vec::IntoIter<PathBuf>,
    rate: FrameRate,
    next: u64,
    note: Option<String>,
}

impl PictureStream for NamedPictures {
    fn next_picture(&mut self) -> Option<Picture> {
        let path = self.files.next()?;
        let stamp = Ok(self.rate.stamp(self.next));
        self.next += 1;
        Some(Picture { stamp, data: read(&path) })
    }

    fn take_notes(&mut self) -> Vec<String> {
        self.note.take().into_iter().collect()
    }

    fn pictures(&self) -> Option<u64> {
        Some(self.files.len() as u64)
    }
}

fn read(path: &Path) -> PictureData {
    match safe_file::read(path, MAX_PICTURE_FILE) {
        Ok(bytes) => PictureData::Encoded(bytes),
        Err(e) => PictureData::Missing(format!("the picture {} cannot be read: {e}", path.display())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_in_non_numeric_order_are_detected() {
        let files = |names: &[&str]| names.iter().map(PathBuf::from).collect::<Vec<_>>();
        assert_eq!(counted_otherwise(&files(&["a/1.png", "a/10.png", "a/2.png"])), Some(("10.png".to_owned(), "2.png".to_owned())));
        assert_eq!(counted_otherwise(&files(&["a/01.png", "a/02.png", "a/10.png"])), None);
        assert_eq!(counted_otherwise(&files(&["B.png", "a.png", "a1.png"])), None);
        assert_eq!(counted_otherwise(&[]), None);
    }
}
