//! Ctrl-C: the first one asks the work to end with what is there, the second one ends it at once.

use std::sync::atomic::{AtomicBool, Ordering};

use nix::sys::signal::{SigHandler, Signal, signal};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

extern "C" fn on_signal(number: nix::libc::c_int) {
    if INTERRUPTED.swap(true, Ordering::Relaxed) {
        // SAFETY: `_exit` is async-signal-safe and takes nothing but a number.
        unsafe { nix::libc::_exit(128 + number) }
    }
}

/// Takes SIGINT and SIGTERM over. Where the system refuses, they end the process as ever.
pub(super) fn watch() {
    for number in [Signal::SIGINT, Signal::SIGTERM] {
        // SAFETY: the handler stores an atomic or calls `_exit`; both are async-signal-safe.
        let _ = unsafe { signal(number, SigHandler::Handler(on_signal)) };
    }
}

/// True from the first Ctrl-C on.
pub(super) fn is_interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

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
