//! A live camera as a source of rows. The camera may be missing, go, come back, stall, block or
//! panic.
//!
//! ```text
//!  reader thread (opens, reads, reopens)  --newest picture-->  capture stage (decodes)  --newest row-->  matcher
//!       ^ nudged, then abandoned where a driver blocks it
//! ```
//! If the next stage is slow, the oldest pictures and rows are dropped. [`Pulse`] tells the age of
//! the last picture, from which the pose stage makes stale messages.

mod event;
mod job;
mod patience;
mod pulse;
mod reader;
mod shutter;
mod source;

pub use event::{Event, EventListener, EventLog, StampedEvent};
pub use job::{Job, JobState};
pub use patience::Patience;
pub use pulse::Pulse;
pub(super) use reader::dropped;
pub use shutter::{contradiction, exposure_of};
pub use source::{LiveSource, LiveStop};

use std::sync::Arc;

use crate::telemetry::Statistics;

/// What the stages of a live daemon share.
#[derive(Debug, Clone, Default)]
pub struct LiveLink {
    /// Counts.
    pub statistics: Arc<Statistics>,
    /// Events.
    pub events: Arc<EventLog>,
    /// When the last picture came.
    pub pulse: Arc<Pulse>,
}
