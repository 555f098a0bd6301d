//! Ctrl-C: the first one asks the work to end with what is there, the second one ends it at once.
//!
//! What cannot be asked - a driver that does not come back, a disk that is gone - does not keep the process: where the
//! first signal has not ended it within [`GRACE_S`], a timer does.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use nix::sys::signal::{SigHandler, Signal, signal};

/// Set by the first SIGINT or SIGTERM. A static, because a signal handler can reach nothing else.
static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// How long an ordered end may take, seconds: a recorder brings what waits to the disk. Chosen, not tuned. Raised, a hung end lasts longer;
/// lowered, a slow disk loses the end of a recording.
const GRACE_S: u32 = 10;

extern "C" fn on_signal(number: nix::libc::c_int) {
    let first = !INTERRUPTED.swap(true, Ordering::Relaxed);
    // SAFETY: `_exit` and `alarm` are async-signal-safe and take nothing but a number.
    unsafe {
        if !first {
            nix::libc::_exit(128 + number);
        }
        nix::libc::alarm(GRACE_S);
    }
}

extern "C" fn on_alarm(_: nix::libc::c_int) {
    /// What is written when [`GRACE_S`] is over. Bytes that are ready, for a signal handler must not format.
    const LAST_WORDS: &[u8] = b"stagepose: interrupted, but something did not end in time; ended without it\n";
    // SAFETY: `write` and `_exit` are async-signal-safe; the bytes live as long as the program.
    unsafe {
        nix::libc::write(2, LAST_WORDS.as_ptr().cast(), LAST_WORDS.len());
        nix::libc::_exit(1);
    }
}

/// A file that reaches the size that is allowed is an error like a full disk, not the end of the process.
pub(super) fn outlive_file_limits() {
    // SAFETY: ignoring a signal runs no code.
    let _ = unsafe { signal(Signal::SIGXFSZ, SigHandler::SigIgn) };
}

/// Takes SIGINT and SIGTERM over. Where the system refuses, they end the process as ever.
pub(super) fn watch() {
    for number in [Signal::SIGINT, Signal::SIGTERM] {
        // SAFETY: the handler stores an atomic or calls `_exit`; both are async-signal-safe.
        let _ = unsafe { signal(number, SigHandler::Handler(on_signal)) };
    }
    // SAFETY: the handler calls nothing but `write` and `_exit`, which are async-signal-safe.
    let _ = unsafe { signal(Signal::SIGALRM, SigHandler::Handler(on_alarm)) };
}

/// True from the first Ctrl-C on.
pub(super) fn is_interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

/// Waits until this long after `begun`, in short naps, so that Ctrl-C is heard in a long pause; false where it came first.
pub(super) fn wait_until(begun: Instant, due: Duration) -> bool {
    loop {
        let left = due.saturating_sub(begun.elapsed());
        if is_interrupted() || left.is_zero() {
            return !is_interrupted();
        }
        std::thread::sleep(left.min(Duration::from_millis(50)));
    }
}

/// Set by SIGHUP and by SIGUSR1, until they are taken.
static RELOAD: AtomicBool = AtomicBool::new(false);
static SAVE: AtomicBool = AtomicBool::new(false);

extern "C" fn on_service_signal(number: nix::libc::c_int) {
    match number {
        nix::libc::SIGHUP => RELOAD.store(true, Ordering::Relaxed),
        _ => SAVE.store(true, Ordering::Relaxed),
    }
}

/// Takes SIGHUP and SIGUSR1 over, for a service.
pub(super) fn watch_service() {
    for number in [Signal::SIGHUP, Signal::SIGUSR1] {
        // SAFETY: the handler stores an atomic, which is async-signal-safe.
        let _ = unsafe { signal(number, SigHandler::Handler(on_service_signal)) };
    }
}

/// True once for every SIGHUP.
pub(super) fn take_reload() -> bool {
    RELOAD.swap(false, Ordering::Relaxed)
}

/// True once for every SIGUSR1.
pub(super) fn take_save() -> bool {
    SAVE.swap(false, Ordering::Relaxed)
}
