//! A pipe, standard input or a file that is read until someone asks to stop.

use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::fd::AsFd;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use nix::libc;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

/// Interval of looks at the stop, milliseconds. Raised, the daemon ends later; lowered, it wakes
/// more often while nothing comes.
const LOOK_MS: u16 = 100;

/// An input whose `read` returns 0 at its end and at the stop.
#[derive(Debug)]
pub(super) struct Input {
    file: File,
    is_regular: bool,
    has_read: bool,
    stop: Arc<AtomicBool>,
}

impl Input {
    /// Opens a file or a pipe, without waiting for a pipe's writer; `None` for standard input.
    ///
    /// # Errors
    /// The system's error.
    pub fn open(path: Option<&Path>, stop: Arc<AtomicBool>) -> io::Result<Self> {
        let file = match path {
            Some(path) => OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path)?,
            None => File::from(io::stdin().as_fd().try_clone_to_owned()?),
        };
        let kind = file.metadata()?.file_type();
        if kind.is_dir() {
            return Err(io::ErrorKind::IsADirectory.into());
        }
        Ok(Self { file, is_regular: kind.is_file(), has_read: kind.is_fifo() && path.is_none(), stop })
    }

    /// Whether it is a file on a disk.
    pub fn is_regular(&self) -> bool {
        self.is_regular
    }
}

impl Read for Input {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while !self.stop.load(Ordering::Relaxed) {
            let mut wanted = [PollFd::new(self.file.as_fd(), PollFlags::POLLIN)];
            match poll(&mut wanted, PollTimeout::from(LOOK_MS)) {
                Ok(0) | Err(nix::errno::Errno::EINTR) => continue,
                Ok(_) => {}
                Err(error) => return Err(error.into()),
            }
            match self.file.read(buffer) {
                // A pipe without a writer is always at its end; one may come.
                Ok(0) if !self.is_regular && !self.has_read && !buffer.is_empty() => {
                    std::thread::sleep(Duration::from_millis(LOOK_MS.into()));
                }
                Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted) => {}
                read => {
                    self.has_read |= read.as_ref().is_ok_and(|count| *count > 0);
                    return read;
                }
            }
        }
        Ok(0)
    }
}
