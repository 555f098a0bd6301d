//! All tuning constants of `track`: one struct per room, together one.
//!
//! To change a constant, edit its line in the room's `tuning.rs`, then run `cargo bench --bench
//! bars`, which renders ten scenes and compares with the committed figures. docs/tuning.md says
//! where each value was measured, and what half and double of it do, which `cargo bench --bench
//! bars --features tuning -- tuning` measures.

#[cfg(any(test, feature = "tuning"))]
pub mod adjustable;
#[cfg(not(feature = "tuning"))]
mod constant;
#[macro_use]
mod declare;
pub mod frame_order;
#[cfg(feature = "tuning")]
pub mod study;

#[cfg(not(feature = "tuning"))]
pub use constant::TUNING;
#[cfg(feature = "tuning")]
pub use study::TUNING;
