//! The record files, written line by line as the samples come.

use std::io::{BufWriter, Write};

use crate::cli::failure::Failure;
use crate::cli::output_file::OutputFile;
use crate::record::PoseSample;

/// Lines on their way to a file.
pub(in crate::cli) struct Output(BufWriter<OutputFile>);

impl Output {
    /// Begins anew in a file; what was in it is gone.
    pub fn begin(file: OutputFile) -> Result<Self, Failure> {
        file.begin()?;
        Ok(Self(BufWriter::new(file)))
    }

    /// Begins a new file where the one that was written to has been moved away or removed (a log rotation).
    pub fn reopen(&mut self) -> Result<(), Failure> {
        self.flush()?;
        self.0.get_mut().reopen()
    }

    fn write_line(&mut self, line: &str) -> Result<(), Failure> {
        let written = writeln!(self.0, "{line}");
        written.map_err(Failure::output(&self.0.get_ref().name))
    }

    /// Brings everything written so far to the file: a full disk shows here at the latest.
    fn flush(&mut self) -> Result<(), Failure> {
        let flushed = self.0.flush();
        flushed.map_err(Failure::output(&self.0.get_ref().name))
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
    /// Begins the wanted files.
    pub fn begin(poses: Option<OutputFile>, tum: Option<OutputFile>, every_line: bool) -> Result<Self, Failure> {
        let (poses, tum) = (poses.map(Output::begin).transpose()?, tum.map(Output::begin).transpose()?);
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
