//! The record files, written line by line as the samples come.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use crate::cli::failure::Failure;
use crate::record::PoseSample;

/// The file name that means standard output.
pub(super) const STDOUT: &str = "-";

/// A file or stdout, with its name for messages.
pub(in crate::cli) struct Output {
    file: PathBuf,
    writer: BufWriter<Box<dyn Write>>,
    /// Device and number of a plain file; none of pipes, devices and stdout.
    identity: Option<(u64, u64)>,
}

/// What tells a plain file from all others, whatever its name.
fn identity(metadata: &Metadata) -> Option<(u64, u64)> {
    metadata.is_file().then(|| (metadata.dev(), metadata.ino()))
}

impl Output {
    /// Creates the file, replacing what is there.
    pub fn create(file: &Path) -> Result<Self, Failure> {
        if file == Path::new(STDOUT) {
            return Ok(Self { file: file.to_owned(), writer: BufWriter::new(Box::new(io::stdout())), identity: None });
        }
        Self::of(file, File::create(file).map_err(Failure::output(file))?)
    }

    fn of(file: &Path, opened: File) -> Result<Self, Failure> {
        let identity = identity(&opened.metadata().map_err(Failure::output(file))?);
        Ok(Self { file: file.to_owned(), writer: BufWriter::new(Box::new(opened)), identity })
    }

    /// Begins a new file where the one that was written to has been moved away or removed (a log rotation).
    pub fn reopen(&mut self) -> Result<(), Failure> {
        self.flush()?;
        let there = fs::metadata(&self.file).ok().and_then(|metadata| identity(&metadata));
        if self.identity.is_none() || there == self.identity {
            return Ok(());
        }
        let opened = OpenOptions::new().create(true).append(true).open(&self.file).map_err(Failure::output(&self.file))?;
        *self = Self::of(&self.file, opened)?;
        Ok(())
    }

    fn write_line(&mut self, line: &str) -> Result<(), Failure> {
        writeln!(self.writer, "{line}").map_err(Failure::output(&self.file))
    }

    /// Brings everything written so far to the file: a full disk shows here at the latest.
    fn flush(&mut self) -> Result<(), Failure> {
        self.writer.flush().map_err(Failure::output(&self.file))
    }

    /// Writes a whole text.
    pub fn write_all_and_flush(&mut self, text: &str) -> Result<(), Failure> {
        self.write_line(text)?;
        self.flush()
    }
}

/// `--poses` and `--tum`.
pub(in crate::cli) struct Records {
    poses: Option<Output>,
    tum: Option<Output>,
    /// A reader that follows the clip in real time wants every line when it is due.
    every_line: bool,
    begun: bool,
}

impl Records {
    /// Creates the wanted files before anything is tracked, so that a wrong path is known at once.
    pub fn create(poses: Option<&Path>, tum: Option<&Path>, every_line: bool) -> Result<Self, Failure> {
        let (poses, tum) = (poses.map(Output::create).transpose()?, tum.map(Output::create).transpose()?);
        Ok(Self { poses, tum, every_line, begun: false })
    }

    /// Writes the lines of one sample.
    pub fn write(&mut self, sample: &PoseSample) -> Result<(), Failure> {
        if let Some(poses) = &mut self.poses {
            poses.write_line(&sample.to_json_line())?;
        }
        if let (Some(tum), Some(line)) = (&mut self.tum, sample.to_tum_line()) {
            tum.write_line(&line)?;
        }
        // The first line goes out at once: a full disk is known before the work is done.
        if self.every_line || !self.begun {
            self.begun = true;
            self.finish()?;
        }
        Ok(())
    }

    /// As [`Output::reopen`].
    pub fn reopen(&mut self) -> Result<(), Failure> {
        self.poses.iter_mut().chain(&mut self.tum).try_for_each(Output::reopen)
    }

    /// Brings everything to the files.
    pub fn finish(&mut self) -> Result<(), Failure> {
        self.poses.iter_mut().chain(&mut self.tum).try_for_each(Output::flush)
    }
}
