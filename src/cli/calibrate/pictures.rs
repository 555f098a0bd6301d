//! Collects the pictures: named files, whole folders, or useful frames of a clip.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use super::{CalibrateArguments, live};
use crate::calibrate::board::Board;
use crate::calibrate::origin::Origin;
use crate::calibrate::pick::ViewPicker;
use crate::calibrate::picture::{Inspected, inspect};
use crate::capture::{
    CaptureError, ClipOptions, EntryContent, MAX_PICTURE_FILE, PICTURE_EXTENSIONS, decode_oriented, foreign, open_clip, orientation_words,
    picture_size,
};
use crate::cli::failure::Failure;
use crate::cli::interrupt;
use crate::cli::replay::progress::Progress;
use crate::safe_file;

/// Templates of the progress bar, and of the counter if the total is unknown.
const PROGRESS_WORDS: [&str; 2] = ["{bar:32} {pos}/{len} pictures, {eta} left", "{spinner} {pos} pictures"];

/// Searches every picture that the arguments name for the board.
pub(super) fn inspected(arguments: &CalibrateArguments, board: &Board) -> Result<Vec<Inspected>, Failure> {
    if arguments.device.is_some() || arguments.play.is_some() {
        return live::taken(arguments, board);
    }
    let files = files_of(&arguments.images)?;
    if files.is_empty() && arguments.clip.is_none() {
        return Err(Failure::Usage("there are no pictures; give picture files, folders of pictures, --clip or --device".to_owned()));
    }
    interrupt::watch();
    let progress = Progress::with(Some(files.len() as u64), PROGRESS_WORDS);
    let looking = Looking::default();
    let mut pictures: Vec<Inspected> = files
        .into_par_iter()
        .filter(|_| !interrupt::is_interrupted())
        .map(|file| {
            let seen = looking.look_at(file, board);
            progress.advance();
            seen
        })
        .collect();
    progress.finish();
    looking.say_turned();
    if let Some(clip) = &arguments.clip {
        pictures.extend(picked(clip, board)?);
    }
    if interrupt::is_interrupted() {
        return Err(Failure::Calibration("interrupted; nothing is written".to_owned()));
    }
    Ok(pictures)
}

/// Pixels above which a picture is inspected alone. Inspection takes about 14 bytes per pixel, and
/// one large picture per processor would exceed a small machine's memory. Raised, more memory is
/// needed; lowered, large pictures take longer.
pub(super) const LARGE_PIXELS: u64 = 16_000_000;

/// State shared by threads that inspect pictures in parallel.
#[derive(Default)]
struct Looking {
    /// Held while a large picture is inspected.
    large: Mutex<()>,
    /// Number of pictures whose EXIF data says to show them rotated.
    turned: AtomicU64,
}

impl Looking {
    fn look_at(&self, file: PathBuf, board: &Board) -> Inspected {
        let bytes = match safe_file::read(&file, MAX_PICTURE_FILE) {
            Ok(bytes) => bytes,
            Err(e) => return Inspected::unreadable(file, format!("cannot be read: {e}")),
        };
        let is_large = picture_size(&bytes).is_some_and(|(w, h)| u64::from(w) * u64::from(h) > LARGE_PIXELS);
        let _alone = is_large.then(|| self.large.lock().unwrap_or_else(PoisonError::into_inner));
        match decode_oriented(&bytes) {
            Ok((picture, orientation)) => {
                self.turned.fetch_add(u64::from(orientation_words(orientation).is_some()), Ordering::Relaxed);
                inspect(file, &picture, board).taken_by(Origin::of_picture(&bytes))
            }
            Err(reason) => Inspected::unreadable(file, reason.to_string()),
        }
    }

    /// Notes how pictures with an EXIF rotation are handled.
    fn say_turned(&self) {
        let turned = self.turned.load(Ordering::Relaxed);
        if turned > 0 {
            note(&format!(
                "EXIF says to show {turned} of the pictures turned; they are used as stored in the file, like frames of the \
                 camera"
            ));
        }
    }
}

/// Prints a note on stderr. A closed terminal is no reason to stop.
fn note(sentence: &str) {
    let _ = std::io::stderr().write_all(format!("stagepose: note: {sentence}\n").as_bytes());
}

/// Returns the named files, and the folders' pictures in natural order: view2 before view10.
fn files_of(images: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let mut files = Vec::new();
    for path in images {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let mut inside = Vec::new();
        let unreadable = |source| CaptureError::NotReadable { path: path.clone(), source };
        for entry in std::fs::read_dir(path).map_err(unreadable)? {
            let file = entry.map_err(unreadable)?.path();
            let extension = file.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
            if PICTURE_EXTENSIONS.contains(&extension.as_str()) && file.is_file() {
                inside.push(file);
            }
        }
        if inside.is_empty() {
            let found = foreign::in_folder(path).map_or_else(String::new, |found| format!(" (it has {found})"));
            return Err(Failure::Usage(format!(
                "{}: the folder has no pictures; give one with PNG, JPEG or PGM files{found}",
                path.display()
            )));
        }
        alphanumeric_sort::sort_path_slice(&mut inside);
        files.append(&mut inside);
    }
    Ok(files)
}

/// Returns the name of a clip's frame, for messages.
pub(super) fn frame_name(clip: &Path, sequence: u64) -> PathBuf {
    PathBuf::from(format!("{} frame {sequence}", clip.display()))
}

/// Picks the useful frames of a clip.
fn picked(clip: &Path, board: &Board) -> Result<Vec<Inspected>, Failure> {
    let mut source = open_clip(clip, ClipOptions { is_stopped: Some(interrupt::is_interrupted), ..ClipOptions::default() })?;
    let progress = Progress::with(source.rows(), PROGRESS_WORDS);
    let mut picker = ViewPicker::new(*board);
    let (mut rows, mut readable, mut first_reason) = (0, 0, None);
    while let Some(row) = source.next_entry().filter(|_| !interrupt::is_interrupted()) {
        progress.advance();
        rows += 1;
        match row.content {
            EntryContent::Frame(frame) => {
                readable += 1;
                picker.look_at(frame_name(clip, row.sequence), &frame.image);
            }
            EntryContent::Undecodable(reason) | EntryContent::Skipped(reason) => {
                first_reason.get_or_insert(reason);
            }
        }
    }
    progress.finish();
    source.notes().iter().for_each(|sentence| note(sentence));
    if readable == 0 && !interrupt::is_interrupted() {
        return Err(Failure::NoFrame { clip: clip.to_owned(), rows, first: first_reason });
    }
    Ok(picker.finish())
}
