//! The running tracker: the three stages of the design as threads joined by bounded channels, and the same
//! stages without threads.
//!
//! [`Tracker`] is the library's plain form: a frame in, a pose sample out. [`Daemon`] runs capture, matcher
//! and pose on a thread each; data moves one way, and a stage ends when its input ends. [`latest`] owns
//! drop-oldest, [`live`] a camera that may fail.

pub mod live;
mod reason_watch;
pub mod recorder;
mod stale;
mod threads;
mod tracker;

pub use crate::latest;
pub use threads::{Daemon, DaemonError, Delivery, RunningDaemon};
pub use tracker::{Tracker, TrackerSetup};
