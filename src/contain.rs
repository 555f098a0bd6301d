//! Holding a panic of other people's code where it happens.
//!
//! Decoders and drivers are fed with whatever a cable or a stranger's file delivers. A panic in one of them is a damaged
//! picture or a lost camera, not the end of the program, and no news for the terminal: who calls has a sentence for it.

use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    /// How many calls of [`contained`] this thread is in.
    static DEPTH: Cell<u32> = const { Cell::new(0) };
}

/// Runs `work`; a panic in it becomes its message, and nothing is printed.
///
/// # Errors
/// What the panic said.
pub fn contained<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    quieten();
    DEPTH.set(DEPTH.get() + 1);
    let outcome = catch_unwind(AssertUnwindSafe(work));
    DEPTH.set(DEPTH.get() - 1);
    outcome.map_err(|panic| message(&*panic))
}

/// Makes the process' panic hook silent where a panic is contained; every other panic goes to the hook that was there.
fn quieten() {
    /// The hook is set once for the process.
    static QUIET: Once = Once::new();
    QUIET.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |panic| {
            // A thread that ends has no depth any more.
            if DEPTH.try_with(Cell::get).unwrap_or(0) == 0 {
                before(panic);
            }
        }));
    });
}

/// From now on panics that nobody contains go to `report` instead of stderr; contained ones stay silent.
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
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "it said no word".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_its_message_and_the_depth_is_what_it_was() {
        let number = std::hint::black_box(7);
        assert_eq!(contained(|| number), Ok(7));
        let inner = contained(|| contained(|| assert!(number < 0, "number {number}")).unwrap_err());
        assert_eq!(inner, Ok("number 7".to_owned()));
        assert_eq!(contained(|| panic!("plain")), Err::<(), _>("plain".to_owned()));
        assert_eq!(DEPTH.get(), 0);
    }
}
