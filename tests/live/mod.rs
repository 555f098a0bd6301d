//! A live camera that does everything wrong, and the daemon that has to bear it; no hardware.

mod faults;
mod faulty;
#[cfg(feature = "http")]
mod first_words;
pub mod program;
#[cfg(feature = "http")]
mod setup;
mod soak;
