//! `record`: as `run`, and everything is recorded as a clip that replays to the same records.

use std::path::PathBuf;

use super::failure::Failure;
use super::run::{LiveArguments, live};

/// Track with a camera and record the clip: pictures as received, stamps, records, events, config.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  stagepose record take1 --config stage.toml --seconds 60\n  stagepose replay take1 --config take1/config/stage.toml --poses again.jsonl\n\n\
    The replay gives take1/poses.jsonl byte for byte. A disk that is full ends the recording, not the tracking."
)]
pub(super) struct RecordArguments {
    /// The new folder
    clip: PathBuf,
    #[command(flatten)]
    live: LiveArguments,
}

pub(super) fn run(arguments: &RecordArguments) -> Result<(), Failure> {
    // Said at once, not when a camera has come.
    if arguments.clip.join("timestamps.csv").exists() {
        return Err(Failure::ClipIsThere(arguments.clip.clone()));
    }
    live(&arguments.live, Some(arguments.clip.clone()))
}
