//! Reads the rows of a clip that is measured, and counts what could be decoded.

use std::path::Path;

use super::failure::Failure;
use super::interrupt;
use crate::capture::{ClipEntry, ClipOptions, EntryContent, FrameSource, open_clip};
use crate::config::Settings;

/// Opens a clip at the size of the config's calibration and logs its notes. `fps`: of a clip
/// without stamps.
pub(super) fn open(settings: &Settings, clip: &Path, fps: Option<f64>) -> Result<Box<dyn FrameSource>, Failure> {
    let source = open_again(settings, clip, fps)?;
    source.notes().iter().for_each(|note| tracing::warn!("{note}"));
    Ok(source)
}

/// Opens a clip like [`open`], without its notes.
pub(super) fn open_again(settings: &Settings, clip: &Path, fps: Option<f64>) -> Result<Box<dyn FrameSource>, Failure> {
    let calibrated = settings.lens.size(&settings.camera);
    match open_clip(clip, ClipOptions { fps, calibrated, is_stopped: Some(interrupt::is_interrupted) }) {
        Err(_) if interrupt::is_interrupted() => Err(Failure::Interrupted),
        opened => Ok(opened?),
    }
}

/// Counts the rows of a clip.
#[derive(Debug, Default)]
pub(super) struct RowCount {
    rows: usize,
    readable: usize,
    /// Why the first row that cannot be decoded cannot.
    first_reason: Option<String>,
}

impl RowCount {
    /// Counts a row.
    ///
    /// # Errors
    /// When the user interrupted the command.
    pub fn add(&mut self, row: &ClipEntry) -> Result<(), Failure> {
        if interrupt::is_interrupted() {
            return Err(Failure::Interrupted);
        }
        self.rows += 1;
        match &row.content {
            EntryContent::Frame(_) => self.readable += 1,
            EntryContent::Undecodable(reason) => drop(self.first_reason.get_or_insert_with(|| reason.to_string())),
            EntryContent::Skipped(_) => {}
        }
        Ok(())
    }

    /// Returns the number of rows.
    ///
    /// # Errors
    /// When none of them is a frame.
    pub fn finish(self, clip: &Path) -> Result<usize, Failure> {
        let Self { rows, readable, first_reason } = self;
        if readable == 0 {
            return Err(Failure::NoFrame { clip: clip.to_owned(), rows: rows as u64, first: first_reason });
        }
        Ok(rows)
    }
}
