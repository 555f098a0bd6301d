//! The record files, written line by line as samples come.

use std::io::{BufWriter, Write};

use crate::cli::failure::Failure;
use crate::cli::output_file::OutputFile;
use crate::record::PoseSample;

/// A file written by lines.
pub(in crate::cli) struct Output(BufWriter<OutputFile>);

impl Output {
    /// Truncates a file and starts writing to it.
    pub fn begin(file: OutputFile) -> Result<Self, Failure> {
        file.begin()?;
        Ok(Self(BufWriter::new(file)))
    }

    /// Creates a new file if the current one has been moved away or removed (log rotation).
    pub fn reopen(&mut self) -> Result<(), Failure> {
        self.flush()?;
        self.0.get_mut().reopen()
    }

    /// Writes a line.
    pub fn write_line(&mut self, line: &str) -> Result<(), Failure> {
        let written = writeln!(self.0, "{line}");
        written.map_err(Failure::output(&self.0.get_ref().name))
    }

    /// Flushes to the file: a full disk shows here at the latest.
    pub fn flush(&mut self) -> Result<(), Failure> {
        let flushed = self.0.flush();
        flushed.map_err(Failure::output(&self.0.get_ref().name))
    }

    /// Writes a whole text.
    pub fn write_all_and_flush(&mut self, text: &str) -> Result<(), Failure> {
        self.write_line(text)?;
        self.flush()
    }
}

/// The files of `--poses`, `--parts` and `--tum`.
pub(in crate::cli) struct Records {
    poses: Option<Output>,
    parts: Option<Output>,
    tum: Option<Output>,
    /// Flush every line, for a reader that follows in real time.
    every_line: bool,
    begun: bool,
}

impl Records {
    /// Starts the wanted files.
    pub fn begin(poses: Option<OutputFile>, tum: Option<OutputFile>, every_line: bool) -> Result<Self, Failure> {
        let (poses, tum) = (poses.map(Output::begin).transpose()?, tum.map(Output::begin).transpose()?);
        Ok(Self { poses, parts: None, tum, every_line, begun: false })
    }

    /// Also writes what each record's covariances are made of.
    pub fn with_parts(self, parts: Option<OutputFile>) -> Result<Self, Failure> {
        Ok(Self { parts: parts.map(Output::begin).transpose()?, ..self })
    }

    /// Writes a sample's lines.
    pub fn write(&mut self, sample: &PoseSample) -> Result<(), Failure> {
        if let Some(poses) = &mut self.poses {
            poses.write_line(&sample.to_json_line())?;
        }
        if let Some(parts) = &mut self.parts {
            parts.write_line(&sample.to_parts_line())?;
        }
        if let (Some(tum), Some(line)) = (&mut self.tum, sample.to_tum_line()) {
            tum.write_line(&line)?;
        }
        // Flush the first line at once, so that a full disk is noticed early.
        if self.every_line || !self.begun {
            self.begun = true;
            self.finish()?;
        }
        Ok(())
    }

    /// As [`Output::reopen`].
    pub fn reopen(&mut self) -> Result<(), Failure> {
        self.poses.iter_mut().chain(&mut self.parts).chain(&mut self.tum).try_for_each(Output::reopen)
    }

    /// Flushes everything to the files.
    pub fn finish(&mut self) -> Result<(), Failure> {
        self.poses.iter_mut().chain(&mut self.parts).chain(&mut self.tum).try_for_each(Output::flush)
    }
}
