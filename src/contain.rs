//! Contains panics in third-party code.
//!
//! Decoders and drivers process whatever a cable or an unknown file delivers. A panic in one of
//! them means a damaged picture or a lost camera, not the end of the program. Nothing is printed:
//! the caller reports it in its own words.

use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    /// How many nested calls of [`contained`] this thread is in.
    static DEPTH: Cell<u32> = const { Cell::new(0) };
}

/// Runs `work`. A panic in it is returned as its message, and nothing is printed.
///
/// # Errors
/// The panic's message.
pub fn contained<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    quieten();
    DEPTH.set(DEPTH.get() + 1);
    let outcome = catch_unwind(AssertUnwindSafe(work));
    DEPTH.set(DEPTH.get() - 1);
    outcome.map_err(|panic| message(&*panic))
}

/// Silences the process's panic hook for contained panics; all others go to the previous hook.
fn quieten() {
    /// Guards the hook, which is installed once per process.
    static QUIET: Once = Once::new();
    QUIET.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |panic| {
            // The thread-local is gone while a thread shuts down.
            if DEPTH.try_with(Cell::get).unwrap_or(0) == 0 {
                before(panic);
            }
        }));
    });
}

/// Sends uncontained panics to `report` instead of stderr from now on; contained ones stay silent.
pub fn report_others(report: impl Fn(String) + Send + Sync + 'static) {
    quieten();
    set_hook(Box::new(move |panic| {
        if DEPTH.try_with(Cell::get).unwrap_or(0) == 0 {
            report(panic.to_string());
        }
    }));
}

fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "no message".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_contained_panic_returns_its_message_and_restores_depth() {
        let number = std::hint::black_box(7);
        assert_eq!(contained(|| number), Ok(7));
        let inner = contained(|| contained(|| assert!(number < 0, "number {number}")).unwrap_err());
        assert_eq!(inner, Ok("number 7".to_owned()));
        assert_eq!(contained(|| panic!("plain")), Err::<(), _>("plain".to_owned()));
        assert_eq!(DEPTH.get(), 0);
    }
}
