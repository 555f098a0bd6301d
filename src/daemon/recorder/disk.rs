//! Writes such that a full disk or a killed process leaves only whole files and whole lines.

use std::collections::HashMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::safe_file;

/// The recorder's interface to a disk; tests substitute one that fills up.
pub trait Disk: Send {
    /// Creates a folder and its parents.
    fn make_folder(&mut self, folder: &Path) -> io::Result<()>;
    /// Writes a new file, whole or not at all.
    fn write_file(&mut self, file: &Path, bytes: &[u8]) -> io::Result<()>;
    /// Appends to a file, whole or not at all.
    fn append(&mut self, file: &Path, bytes: &[u8]) -> io::Result<()>;
    /// Syncs the lines appended since the last call to the medium.
    fn sync(&mut self);
    /// Closes the files in a folder that is finished or about to be moved or removed.
    fn let_go(&mut self, folder: &Path);
}

/// The machine's disk.
#[derive(Debug, Default)]
pub struct RealDisk {
    /// Files open for appending.
    open: HashMap<PathBuf, Appended>,
}

/// A file open for appending.
#[derive(Debug)]
struct Appended {
    file: File,
    length: u64,
    /// Whether lines were appended since the last sync.
    is_dirty: bool,
}

/// Adds the file's name to an error.
fn at(file: &Path) -> impl Fn(io::Error) -> io::Error + '_ {
    move |e| io::Error::new(e.kind(), format!("{}: {e}", file.display()))
}

impl Disk for RealDisk {
    fn make_folder(&mut self, folder: &Path) -> io::Result<()> {
        fs::create_dir_all(folder).map_err(at(folder))
    }

    fn write_file(&mut self, file: &Path, bytes: &[u8]) -> io::Result<()> {
        safe_file::write_whole(file, bytes).map_err(at(file))
    }

    fn append(&mut self, file: &Path, bytes: &[u8]) -> io::Result<()> {
        if !self.open.contains_key(file) {
            let opened = OpenOptions::new().create(true).append(true).open(file).map_err(at(file))?;
            let length = opened.metadata().map_err(at(file))?.len();
            self.open.insert(file.to_owned(), Appended { file: opened, length, is_dirty: false });
        }
        let Some(open) = self.open.get_mut(file) else { return Ok(()) };
        open.is_dirty = true;
        if let Err(e) = open.file.write_all(bytes) {
            let _ = open.file.set_len(open.length);
            return Err(at(file)(e));
        }
        open.length += bytes.len() as u64;
        Ok(())
    }

    fn sync(&mut self) {
        for open in self.open.values_mut() {
            if std::mem::take(&mut open.is_dirty) {
                // If syncing fails, the next write will report it.
                let _ = open.file.sync_data();
            }
        }
    }

    fn let_go(&mut self, folder: &Path) {
        self.open.retain(|file, _| !file.starts_with(folder));
    }
}
