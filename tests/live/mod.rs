//! A live camera that fails in every way, and the daemon that must cope with it. No hardware is
//! needed.

mod faults;
mod faulty;
#[cfg(feature = "http")]
mod first_words;
pub mod program;
#[cfg(feature = "http")]
mod setup;
mod soak;
