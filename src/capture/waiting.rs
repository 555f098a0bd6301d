//! Reads from a pipe without blocking forever: the writer may be slow, stop, or never come.
//!
//! A blocking read cannot be cancelled. So this reader polls for a tenth of a second at a time, and
//! checks in between whether it should stop. Once it should, it reports the end of the pipe.

use std::fs::File;
use std::io::{self, Read};
use std::os::fd::AsFd;
use std::path::Path;
use std::time::{Duration, Instant};

use nix::libc;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

/// Interval between checks of the stop request (chosen: below what a person notices). Raised,
/// Ctrl-C takes longer.
const LOOK: Duration = Duration::from_millis(100);
/// How long a named pipe may lack a writer (chosen: both ends are started by hand or by one
/// script). Raised, a missing writer is reported later.
const WRITER_WAIT: Duration = Duration::from_secs(5);

/// A pipe that is read until a stop is requested.
pub(super) struct Waiting {
    file: File,
    is_stopped: fn() -> bool,
    /// Deadline for the first writer; `None` once data came.
    writer_until: Option<Instant>,
}

impl Waiting {
    /// Opens standard input.
    ///
    /// # Errors
    /// When it is closed.
    pub fn stdin(is_stopped: fn() -> bool) -> io::Result<Self> {
        let file = File::from(io::stdin().as_fd().try_clone_to_owned()?);
        Ok(Self { file, is_stopped, writer_until: None })
    }

    /// Opens a named pipe, with or without a writer.
    ///
    /// # Errors
    /// The system's error.
    pub fn named_pipe(path: &Path, is_stopped: fn() -> bool) -> io::Result<Self> {
        use std::os::unix::fs::OpenOptionsExt;
        let file = std::fs::OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path)?;
        Ok(Self { file, is_stopped, writer_until: Some(Instant::now() + WRITER_WAIT) })
    }
}

impl Read for Waiting {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        loop {
            if (self.is_stopped)() {
                return Ok(0);
            }
            let mut fds = [PollFd::new(self.file.as_fd(), PollFlags::POLLIN)];
            let look = PollTimeout::try_from(LOOK).unwrap_or(PollTimeout::ZERO);
            match poll(&mut fds, look) {
                Ok(0) if self.writer_until.is_none() => continue,
                // Without data, only a read can tell a pipe without a writer from a slow writer.
                Ok(_) => {}
                Err(nix::errno::Errno::EINTR) => continue,
                Err(e) => return Err(e.into()),
            }
            match (self.file.read(to), self.writer_until) {
                (Ok(0), Some(until)) if Instant::now() < until => std::thread::sleep(LOOK / 5),
                (Ok(0), Some(_)) => return Err(io::Error::other("nobody writes to this named pipe")),
                (Ok(n), _) => {
                    self.writer_until = None;
                    return Ok(n);
                }
                (Err(e), _) if e.kind() == io::ErrorKind::WouldBlock => self.writer_until = None,
                (Err(e), _) => return Err(e),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::*;

    fn pipe() -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pipe");
        nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).unwrap();
        (folder, path)
    }

    #[test]
    fn a_pipe_writer_may_start_late_and_pause() {
        let (_folder, path) = pipe();
        let mut reader = Waiting::named_pipe(&path, || false).unwrap();
        let writer = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(150));
            let mut to = std::fs::OpenOptions::new().write(true).open(path).unwrap();
            to.write_all(b"one").unwrap();
            std::thread::sleep(Duration::from_millis(250));
            to.write_all(b"two").unwrap();
        });
        let mut text = String::new();
        reader.read_to_string(&mut text).unwrap();
        assert_eq!(text, "onetwo");
        writer.join().unwrap();
    }

    #[test]
    fn waiting_for_a_silent_writer_ends_on_request() {
        static STOP: AtomicBool = AtomicBool::new(false);
        let (_folder, path) = pipe();
        let mut reader = Waiting::named_pipe(&path, || STOP.load(Ordering::Relaxed)).unwrap();
        let _writer = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
        let stopper = std::thread::spawn(|| {
            std::thread::sleep(Duration::from_millis(150));
            STOP.store(true, Ordering::Relaxed);
        });
        assert_eq!(reader.read(&mut [0; 8]).unwrap(), 0);
        stopper.join().unwrap();
    }
}
