//! A job as reported to clients.

use serde::{Deserialize, Serialize};

/// The state of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// It is running.
    Running,
    /// It is done.
    Done,
    /// It failed, or was cancelled.
    Failed,
}

/// A job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// Its number, from 1.
    pub job: u64,
    /// Its kind.
    pub kind: String,
    /// The share done, 0 to 1.
    pub done: f64,
    /// Its state.
    pub state: JobState,
    /// What it works on, its result, or why it failed.
    pub text: String,
}
