//! The zip file of a report. It is new: nothing that is there is ever written over, and half a report does not stay.

use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};

use zip::ZipWriter;
use zip::result::ZipError;
use zip::write::SimpleFileOptions;

use crate::cli::failure::Failure;
use crate::safe_file;

/// Of one file at most this many bytes are taken: a report is to be sent by mail. The name of what is cut says so. Chosen, not tuned.
/// Raised, reports of long recordings grow too large for mail.
const MOST_BYTES: u64 = 32 << 20;

/// A zip file that is being written.
pub(super) struct Bundle {
    file: Unfinished,
    zip: ZipWriter<BufWriter<File>>,
    contents: Vec<String>,
}

/// A file that goes again unless it is finished.
struct Unfinished {
    path: PathBuf,
    is_whole: bool,
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        if !self.is_whole {
            // Where it cannot be removed there is nothing else to do about it.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

impl Bundle {
    /// Begins the file, which must not be there.
    pub fn create(target: &Path) -> Result<Self, Failure> {
        let file = OpenOptions::new().write(true).create_new(true).open(target).map_err(|e| match e.kind() {
            ErrorKind::AlreadyExists => Failure::Usage(format!("--output {}: is there already; give a new file", target.display())),
            _ => Failure::output(target)(e),
        })?;
        let path = target.to_owned();
        Ok(Self { file: Unfinished { path, is_whole: false }, zip: ZipWriter::new(BufWriter::new(file)), contents: Vec::new() })
    }

    /// Adds bytes under a name.
    pub fn add(&mut self, name: &str, content: impl AsRef<[u8]>) -> Result<(), Failure> {
        let bytes = content.as_ref();
        let written = self.zip.start_file(name, SimpleFileOptions::default()).map_err(io_error).and_then(|()| self.zip.write_all(bytes));
        written.map_err(Failure::output(&self.file.path))?;
        self.contents.push(format!("{name} ({})", size(bytes.len() as u64)));
        Ok(())
    }

    /// Adds a file; one that cannot be read leaves a sentence in its place.
    pub fn add_file(&mut self, name: &str, file: &Path) -> Result<(), Failure> {
        let read = || -> io::Result<Vec<u8>> {
            let mut bytes = Vec::new();
            safe_file::open(file)?.take(MOST_BYTES).read_to_end(&mut bytes)?;
            Ok(bytes)
        };
        match read() {
            Ok(bytes) if bytes.len() as u64 == MOST_BYTES => self.add(&format!("{name}.first-{}", size(MOST_BYTES)), &bytes),
            Ok(bytes) => self.add(name, &bytes),
            Err(e) => self.add(&format!("{name}.missing.txt"), format!("{}: cannot be read ({e})\n", file.display())),
        }
    }

    /// Completes the file and gives the list of what is in it.
    pub fn finish(self) -> Result<Vec<String>, Failure> {
        let Self { mut file, zip, contents } = self;
        let end = || -> io::Result<()> { zip.finish().map_err(io_error)?.into_inner()?.sync_all() };
        end().map_err(Failure::output(&file.path))?;
        file.is_whole = true;
        Ok(contents)
    }
}

fn io_error(error: ZipError) -> io::Error {
    match error {
        ZipError::Io(e) => e,
        other => io::Error::other(other),
    }
}

fn size(bytes: u64) -> String {
    match bytes {
        0..10_000 => format!("{bytes} bytes"),
        10_000..10_000_000 => format!("{} kB", bytes / 1000),
        _ => format!("{} MB", bytes / 1_000_000),
    }
}
