//! The running tracker: its three stages as threads joined by bounded channels.
//!
//! [`Daemon`] runs capture, matcher and pose on a thread each; data flows one way, and a stage ends
//! when its input ends. [`track_entry`] runs the same steps on one row of a clip in the calling
//! thread. [`live`] owns a camera that may fail.

mod entries;
mod free_memory;
mod jobs;
mod kept_views;
pub mod learnt_state;
pub mod live;
#[cfg(feature = "cli")]
mod other_tracker;
mod own_command;
mod own_folders;
#[cfg(any(feature = "http", feature = "cli"))]
mod priority;
mod reason_watch;
pub mod recorder;
pub mod report;
mod retrack;
mod stale;
mod supervisor;
mod thread_time;
mod threads;
mod timecode;
mod unwritten;

pub use entries::track_entry;
pub use free_memory::give_back;
pub use jobs::Progress;
pub use kept_views::kept_views;
pub use learnt_state::{LearntFile, learnt_of_clip, utc_ahead_of_clip_ns};
#[cfg(feature = "cli")]
pub use other_tracker::OtherTrackerReader;
pub use own_command::{PROGRESS_EVERY, run_own};
pub use own_folders::{Keeping, state_folder};
#[cfg(any(feature = "http", feature = "cli"))]
pub use priority::stand_back;
#[cfg(test)]
pub use retrack::nothing_compared;
pub use retrack::retrack;
pub use supervisor::{Mode, RecordingWish, Supervisor};
pub use thread_time::thread_clock;
pub use threads::{Daemon, DaemonError, Delivery, RunningDaemon};
pub use timecode::TimecodeReader;
pub use unwritten::unwritten;
