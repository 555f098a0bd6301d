//! The record files, written line by line as the samples come.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::cli::failure::Failure;
use crate::record::PoseSample;

/// The file name that means standard output.
pub(super) const STDOUT: &str = "-";

/// A file or stdout, with its name for messages.
pub(in crate::cli) struct Output {
    file: PathBuf,
    writer: BufWriter<Box<dyn Write>>,
}

impl Output {
    /// Creates the file, replacing what is there.
    pub fn create(file: &Path) -> Result<Self, Failure> {
        let sink: Box<dyn Write> = match file == Path::new(STDOUT) {
            true => Box::new(io::stdout()),
            false => Box::new(File::create(file).map_err(Failure::output(file))?),
        };
        Ok(Self { file: file.to_owned(), writer: BufWriter::new(sink) })
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

    /// Brings everything to the files.
    pub fn finish(&mut self) -> Result<(), Failure> {
        self.poses.iter_mut().chain(&mut self.tum).try_for_each(Output::flush)
    }
}
