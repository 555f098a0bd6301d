//! Statistics of a running daemon.
//!
//! Threads fill [`Statistics`] without locks, and the log's last lines are kept. [`health`] and
//! [`metrics`] are pure functions from the statistics to a page.

mod budget;
mod health;
mod histogram;
mod log_tail;
mod metrics;
mod other_tracker;
mod statistics;
mod timecode;

pub use budget::{Budget, BudgetPart, MeanTimes, Origin};
pub use health::health;
pub use log_tail::{keep_log_line, log_tail};
pub use metrics::metrics;
pub use other_tracker::{OtherTrackerStatus, TrackerDifference};
pub use statistics::{CameraState, RecorderState, STAGES, Statistics};
pub use timecode::TimecodeStatus;

/// A page as a server returns it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page {
    /// HTTP status.
    pub status: u16,
    /// MIME type.
    pub content_type: &'static str,
    /// The text.
    pub body: String,
}
