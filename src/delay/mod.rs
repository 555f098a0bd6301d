//! How much later one camera's stamps are than another's, measured from their turn rates.
//!
//! Two cameras on one rig turn together. While somebody pans back and forth, the rotations of both
//! are measured, and the delay is the shift in time at which they agree. The mount need not be
//! known: a constant 3x3 matrix, fitted together with the delay, maps one camera's turn rate to the
//! other's.
//!
//! [`Turns`] are the rotations of a camera over successive intervals: from poses, from a log of
//! another tracker ([`log`]), or from pictures of anything ([`Panorama`]). Rotations over whole
//! intervals are compared, not rates at instants: this makes cameras of different frame rates
//! comparable. [`measure_delay`] finds the delay and its sigma, [`judge`] says how far to trust it.
//!
//! [`filmed_clock`] measures one camera alone: how late its stamps are, from a screen that shows the
//! time.

pub mod filmed_clock;
mod judge;
#[cfg(test)]
mod judge_tests;
mod lagged;
pub mod log;
mod measure;
#[cfg(test)]
mod measure_tests;
mod panorama;
mod regression;
mod spline;
#[cfg(test)]
mod synthetic;
mod turns;

pub use crate::calibrate::judge::Verdict;
pub use judge::judge;
pub use measure::{Delay, Rival, Side, Undetermined, measure_delay};
pub use panorama::{Panorama, RowMean};
pub use turns::{Turn, Turns};
