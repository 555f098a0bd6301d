//! The pictures: named ones, whole folders, or those of a clip that are worth having.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;

use super::{CalibrateArguments, live};
use crate::calibrate::board::Board;
use crate::calibrate::pick::ViewPicker;
use crate::calibrate::session::{Inspected, inspect};
use crate::capture::{CaptureError, ClipOptions, RowContent, decode_grey, open_clip};
use crate::cli::failure::Failure;
use crate::cli::interrupt;

/// What counts as a picture in a folder.
const EXTENSIONS: [&str; 7] = ["png", "jpg", "jpeg", "pgm", "ppm", "pnm", "pbm"];

/// Every picture that the arguments name, looked through for the board.
pub(super) fn inspected(arguments: &CalibrateArguments, board: &Board) -> Result<Vec<Inspected>, Failure> {
    if arguments.device.is_some() || arguments.play.is_some() {
        return live::taken(arguments, board);
    }
    let files = files_of(&arguments.images)?;
    if files.is_empty() && arguments.clip.is_none() {
        return Err(Failure::Usage("there are no pictures; give picture files, folders of pictures, --clip or --device".to_owned()));
    }
    interrupt::watch();
    let bar = bar(Some(files.len() as u64));
    let mut pictures: Vec<Inspected> = files
        .into_par_iter()
        .filter(|_| !interrupt::is_interrupted())
        .map(|file| {
            let seen = look_at(file, board);
            bar.inc(1);
            seen
        })
        .collect();
    bar.finish_and_clear();
    if let Some(clip) = &arguments.clip {
        pictures.extend(picked(clip, board)?);
    }
    if interrupt::is_interrupted() {
        return Err(Failure::Calibration("interrupted; nothing is written".to_owned()));
    }
    Ok(pictures)
}

fn look_at(file: PathBuf, board: &Board) -> Inspected {
    let decoded = std::fs::read(&file).map_err(|e| format!("cannot be read: {e}"));
    match decoded.and_then(|bytes| decode_grey(&bytes).map_err(|e| e.to_string())) {
        Ok(picture) => inspect(file, &picture, board),
        Err(reason) => Inspected::unreadable(file, reason),
    }
}

/// The files themselves, and the pictures of the folders in the order of their names.
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
            if EXTENSIONS.contains(&extension.as_str()) && file.is_file() {
                inside.push(file);
            }
        }
        if inside.is_empty() {
            return Err(Failure::Usage(format!("{}: the folder has no pictures; give one with PNG, JPEG or PGM files", path.display())));
        }
        inside.sort();
        files.append(&mut inside);
    }
    Ok(files)
}

/// The frames of a clip that are worth having.
fn picked(clip: &Path, board: &Board) -> Result<Vec<Inspected>, Failure> {
    let mut source = open_clip(clip, ClipOptions { fps: None })?;
    let bar = bar(source.rows());
    let mut picker = ViewPicker::new(*board);
    let (mut rows, mut readable, mut first_reason) = (0, 0, None);
    while let Some(row) = source.next_row().filter(|_| !interrupt::is_interrupted()) {
        bar.inc(1);
        rows += 1;
        match row.content {
            RowContent::Frame(frame) => {
                readable += 1;
                picker.look_at(PathBuf::from(format!("{} frame {}", clip.display(), row.sequence)), &frame.image);
            }
            RowContent::Undecodable(reason) | RowContent::Skipped(reason) => {
                first_reason.get_or_insert(reason);
            }
        }
    }
    bar.finish_and_clear();
    if readable == 0 && !interrupt::is_interrupted() {
        return Err(Failure::NoFrame { clip: clip.to_owned(), rows, first: first_reason });
    }
    Ok(picker.finish())
}

/// A bar on a terminal, nothing otherwise.
fn bar(total: Option<u64>) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let (bar, template) = match total {
        Some(total) => (ProgressBar::new(total), "{bar:32} {pos}/{len} pictures, {eta} left"),
        None => (ProgressBar::new_spinner(), "{spinner} {pos} pictures"),
    };
    bar.set_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar
}
