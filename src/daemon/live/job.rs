//! A job as people hear of it.

use serde::{Deserialize, Serialize};

/// How a job is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// It is under way.
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
    /// What it is.
    pub kind: String,
    /// How much is done, 0 to 1.
    pub done: f64,
    /// How it is doing.
    pub state: JobState,
    /// What it works on, what came of it, or why it failed.
    pub text: String,
}
