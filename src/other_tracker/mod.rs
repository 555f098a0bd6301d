//! Another tracker beside this one: how far its poses are from ours, after the alignment that no
//! two trackers share.
//!
//! Two trackers have frames and sensors of their own. [`aligned`] finds the two rigid transforms
//! between them (the other's world in ours, and its sensor on our camera), from the poses that both
//! have of one instant ([`pairs`]). The differences that remain are those that a receiver would see
//! ([`Differences`]).
//!
//! While both run, [`Heard`] reads the other's packets and says what is wrong with them, and
//! [`Beside`] compares the last minute of both.

mod align;
mod beside;
mod differences;
mod heard;
mod pairs;
#[cfg(test)]
mod synthetic;

pub use align::{Alignment, Unalignable, aligned};
pub use beside::{Beside, Comparison};
pub use differences::{Differences, Spread, judged};
pub use heard::{Heard, HeardState};
pub use pairs::pairs;
