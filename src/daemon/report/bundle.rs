//! A report's zip, written sequentially: to a file, or to a download.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

use zip::ZipWriter;
use zip::result::ZipError;
use zip::write::{SimpleFileOptions, StreamWriter};

use crate::safe_file;

/// Maximum bytes taken of one file, since reports are sent by mail. A cut file's name says so.
/// Chosen, not tuned. Raised, reports of long recordings grow too large for mail.
const MAX_BYTES: u64 = 32 << 20;

/// A zip that is being written.
pub(super) struct Bundle<W: Write> {
    zip: ZipWriter<StreamWriter<W>>,
    contents: Vec<String>,
}

impl<W: Write> Bundle<W> {
    pub fn begin(to: W) -> Self {
        Self { zip: ZipWriter::new_stream(to), contents: Vec::new() }
    }

    /// Adds bytes under a name.
    pub fn add(&mut self, name: &str, content: impl AsRef<[u8]>) -> io::Result<()> {
        let bytes = content.as_ref();
        self.zip.start_file(name, SimpleFileOptions::default()).map_err(io_error)?;
        self.zip.write_all(bytes)?;
        self.contents.push(format!("{name} ({})", size(bytes.len() as u64)));
        Ok(())
    }

    /// Adds a file; an unreadable one is replaced by a text with the reason.
    pub fn add_file(&mut self, name: &str, file: &Path) -> io::Result<()> {
        self.add_opened(name, file, || safe_file::open(file))
    }

    /// As [`add_file`](Self::add_file), for a file in a folder; links inside the folder are not
    /// followed.
    pub fn add_below(&mut self, name: &str, folder: &Path, file: &Path) -> io::Result<()> {
        self.add_opened(name, &folder.join(file), || safe_file::open_below(folder, file))
    }

    fn add_opened(&mut self, name: &str, file: &Path, open: impl FnOnce() -> io::Result<File>) -> io::Result<()> {
        let read = || -> io::Result<Vec<u8>> {
            let mut bytes = Vec::new();
            open()?.take(MAX_BYTES).read_to_end(&mut bytes)?;
            Ok(bytes)
        };
        match read() {
            Ok(bytes) if bytes.len() as u64 == MAX_BYTES => self.add(&format!("{name}.first-{}", size(MAX_BYTES)), &bytes),
            Ok(bytes) => self.add(name, &bytes),
            Err(e) => self.add(&format!("{name}.missing.txt"), format!("{}: cannot be read ({e})\n", file.display())),
        }
    }

    /// Completes the zip and returns its list of contents.
    pub fn finish(self) -> io::Result<Vec<String>> {
        self.zip.finish().map_err(io_error)?.flush()?;
        Ok(self.contents)
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
