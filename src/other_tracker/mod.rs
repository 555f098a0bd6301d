//! Another tracker beside this one: how far its poses are from ours, after the alignment that no
//! two trackers share.
//!
//! Two trackers have frames and sensors of their own. [`aligned`] finds the two rigid transforms
//! between them (the other's world in ours, and its sensor on our camera), from the poses that both
//! have of one instant ([`pairs`]). The differences that remain are those that a receiver would see
//! ([`Differences`]).

mod align;
mod differences;
mod pairs;
#[cfg(test)]
mod synthetic;

pub use align::{Alignment, aligned};
pub use differences::{Differences, Spread, judged};
pub use pairs::pairs;
