//! Handles Ctrl-C: the first one asks the command to finish with what it has, the second one ends
//! the process at once.
//!
//! A driver that hangs or a disk that is gone cannot be asked. If the first signal has not ended
//! the process within [`GRACE_S`], a timer does.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use nix::sys::signal::{SigHandler, Signal, signal};

/// Set by the first SIGINT or SIGTERM. It is static because a signal handler has no other state.
static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Maximum duration of an orderly shutdown, seconds; a recorder flushes its queue meanwhile.
/// Chosen, not tuned. Raised, a hung shutdown lasts longer; lowered, a slow disk loses the end of a
/// recording.
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
    /// Message written when [`GRACE_S`] is over. It is a constant because a signal handler must not
    /// format.
    const LAST_WORDS: &[u8] = b"stagepose: interrupted, but something did not end in time; ended without it\n";
    // SAFETY: `write` and `_exit` are async-signal-safe; the bytes live as long as the program.
    unsafe {
        nix::libc::write(2, LAST_WORDS.as_ptr().cast(), LAST_WORDS.len());
        nix::libc::_exit(1);
    }
}

/// Ignores SIGXFSZ, so that a file at the size limit is an error like a full disk and does not kill
/// the process.
pub(super) fn outlive_file_limits() {
    // SAFETY: ignoring a signal runs no code.
    let _ = unsafe { signal(Signal::SIGXFSZ, SigHandler::SigIgn) };
}

/// Installs handlers for SIGINT and SIGTERM. If the system refuses, the signals end the process as
/// usual.
pub(super) fn watch() {
    for number in [Signal::SIGINT, Signal::SIGTERM] {
        // SAFETY: the handler stores an atomic or calls `_exit`; both are async-signal-safe.
        let _ = unsafe { signal(number, SigHandler::Handler(on_signal)) };
    }
    // SAFETY: the handler calls nothing but `write` and `_exit`, which are async-signal-safe.
    let _ = unsafe { signal(Signal::SIGALRM, SigHandler::Handler(on_alarm)) };
}

/// Whether Ctrl-C has been pressed.
pub(super) fn is_interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

/// Sleeps until `due` after `begun`, in short naps so that Ctrl-C is noticed; returns false if it
/// was pressed.
pub(super) fn wait_until(begun: Instant, due: Duration) -> bool {
    loop {
        let left = due.saturating_sub(begun.elapsed());
        if is_interrupted() || left.is_zero() {
            return !is_interrupted();
        }
        std::thread::sleep(left.min(Duration::from_millis(50)));
    }
}

/// Set by SIGHUP and by SIGUSR1; cleared when taken.
static RELOAD: AtomicBool = AtomicBool::new(false);
static SAVE: AtomicBool = AtomicBool::new(false);

extern "C" fn on_service_signal(number: nix::libc::c_int) {
    match number {
        nix::libc::SIGHUP => RELOAD.store(true, Ordering::Relaxed),
        _ => SAVE.store(true, Ordering::Relaxed),
    }
}

/// Installs handlers for SIGHUP and SIGUSR1, for a service.
pub(super) fn watch_service() {
    for number in [Signal::SIGHUP, Signal::SIGUSR1] {
        // SAFETY: the handler stores an atomic, which is async-signal-safe.
        let _ = unsafe { signal(number, SigHandler::Handler(on_service_signal)) };
    }
}

/// Returns true once per SIGHUP.
pub(super) fn take_reload() -> bool {
    RELOAD.swap(false, Ordering::Relaxed)
}

/// Returns true once per SIGUSR1.
pub(super) fn take_save() -> bool {
    SAVE.swap(false, Ordering::Relaxed)
}
