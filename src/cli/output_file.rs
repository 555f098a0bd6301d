//! A file that a command writes. Neither opening nor writing can block the command forever.
//!
//! Besides plain files there are outputs that someone reads meanwhile: standard output, a named
//! pipe, a terminal. Their reader may stop reading, so every wait here ends at the latest when the
//! command is interrupted.

use std::fs::{File, Metadata};
use std::io::{self, Seek, SeekFrom, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use super::failure::Failure;
use super::interrupt;
use crate::safe_file;

/// The file name for standard output.
pub(super) const STDOUT: &str = "-";

/// An open output.
#[derive(Debug)]
pub(super) struct OutputFile {
    /// Its name, for messages.
    pub name: PathBuf,
    to: File,
    is_plain: bool,
    /// Maximum time that a reader may take nothing; `None` waits until an interrupt.
    patience: Option<Duration>,
}

/// Bytes written to a pipe at once: Linux's PIPE_BUF. A pipe that polls as writable takes that many
/// whole (pipe(7)). Raised, a write may block in the middle of a piece; lowered, there are more
/// system calls.
const PIPE_PIECE: usize = 4096;
/// Interval between checks for an interrupt. Chosen: shorter than a person notices. Raised, Ctrl-C
/// takes longer.
const LOOK: Duration = Duration::from_millis(100);

impl OutputFile {
    /// Opens or creates a file, or takes standard output for `-`. Existing content stays until
    /// [`begin`](Self::begin).
    ///
    /// # Errors
    /// When the system refuses, when nobody reads a named pipe, and for folders, disks and sockets.
    pub fn open(name: &Path) -> Result<Self, Failure> {
        let opened = if name == Path::new(STDOUT) { stdout() } else { safe_file::open_output(name) };
        let described = opened.and_then(|to| to.metadata().map(|about| (to, about.is_file())));
        let (to, is_plain) = described.map_err(Failure::output(name))?;
        Ok(Self { name: name.to_owned(), to, is_plain, patience: None })
    }

    /// Gives up a reader that takes nothing for this long; for outputs of a running show.
    pub fn with_patience(self, patience: Duration) -> Self {
        Self { patience: Some(patience), ..self }
    }

    /// Truncates the file.
    ///
    /// # Errors
    /// The system's error.
    pub fn begin(&self) -> Result<(), Failure> {
        if self.is_plain && self.name != Path::new(STDOUT) {
            self.to.set_len(0).map_err(Failure::output(&self.name))?;
        }
        Ok(())
    }

    /// Creates a new file if the plain one has been moved away or removed.
    ///
    /// # Errors
    /// The system's error when it creates the new one.
    pub fn reopen(&mut self) -> Result<(), Failure> {
        let same = |a: &Metadata, b: &Metadata| (a.dev(), a.ino()) == (b.dev(), b.ino());
        let is_there = || Some(same(&std::fs::metadata(&self.name).ok()?, &self.to.metadata().ok()?));
        if !self.is_plain || self.name == Path::new(STDOUT) || is_there() == Some(true) {
            return Ok(());
        }
        let opened = Self::open(&self.name)?;
        let patience = self.patience;
        *self = Self { patience, ..opened };
        // Another program may already have written to it.
        self.to.seek(SeekFrom::End(0)).map_err(Failure::output(&self.name)).map(|_| ())
    }

    /// Returns the open file, to compare it with others.
    pub fn file(&self) -> &File {
        &self.to
    }

    /// Waits until the reader has room.
    fn wait(&self) -> io::Result<()> {
        let begun = Instant::now();
        loop {
            let mut fds = [PollFd::new(self.to.as_fd(), PollFlags::POLLOUT)];
            match poll(&mut fds, PollTimeout::try_from(LOOK).unwrap_or(PollTimeout::ZERO)) {
                Ok(0) | Err(Errno::EINTR) => {}
                Ok(_) => return Ok(()),
                Err(e) => return Err(e.into()),
            }
            if interrupt::is_interrupted() {
                return Err(io::Error::other("interrupted while waiting for its reader"));
            }
            if self.patience.is_some_and(|patience| begun.elapsed() > patience) {
                return Err(io::Error::other("its reader does not read"));
            }
        }
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.is_plain {
            return self.to.write(bytes);
        }
        loop {
            self.wait()?;
            match self.to.write(&bytes[..bytes.len().min(PIPE_PIECE)]) {
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => {}
                written => return written,
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.to.flush()
    }
}

fn stdout() -> io::Result<File> {
    Ok(File::from(io::stdout().as_fd().try_clone_to_owned()?))
}

/// Writes a command's result to stdout.
pub(super) fn print(text: impl AsRef<[u8]>) -> Result<(), Failure> {
    io::stdout().write_all(text.as_ref()).map_err(Failure::output(Path::new("stdout")))
}

#[cfg(test)]
mod tests {
    use std::fs::OpenOptions;
    use std::os::unix::fs::OpenOptionsExt;

    use nix::libc;

    use super::*;

    #[test]
    fn opening_a_named_pipe_does_not_wait_for_a_reader() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
        assert!(OutputFile::open(&pipe).unwrap_err().to_string().contains("nobody reads; start its reader first"));
        let _reader = OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(&pipe).unwrap();
        let mut output = OutputFile::open(&pipe).unwrap().with_patience(Duration::from_millis(50));
        let error = output.write_all(&vec![7; 1 << 20]).unwrap_err();
        assert_eq!(error.to_string(), "its reader does not read");
    }

    #[test]
    fn an_existing_file_stays_until_the_output_begins() {
        let folder = tempfile::tempdir().unwrap();
        let name = folder.path().join("out");
        std::fs::write(&name, "before").unwrap();
        let mut output = OutputFile::open(&name).unwrap();
        assert_eq!(std::fs::read_to_string(&name).unwrap(), "before");
        output.begin().unwrap();
        output.write_all(b"now").unwrap();
        assert_eq!(std::fs::read_to_string(&name).unwrap(), "now");
        assert!(OutputFile::open(folder.path()).unwrap_err().to_string().contains("it is a folder"));
        OutputFile::open(Path::new("/dev/null")).unwrap().begin().unwrap();
    }
}
