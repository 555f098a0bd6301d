//! `record`: like `run`, and records a clip that replays to the same records.

use std::path::PathBuf;

use super::failure::Failure;
use super::run::{LiveArguments, live};
use crate::daemon::recorder::taken_by_earlier;

/// Track with a camera and record the clip: pictures as received, stamps, records, events, config.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  stagepose record take1 --config stage.toml --seconds 60\n  stagepose replay take1 --config \
                  take1/config/stage.toml --poses again.jsonl\n\nThe replay reproduces take1/poses.jsonl byte for byte. A full disk ends \
                  the recording, not the tracking.")]
pub(super) struct RecordArguments {
    /// The clip's folder: new, or without anything of an earlier recording
    clip: PathBuf,
    #[command(flatten)]
    live: LiveArguments,
}

pub(super) fn run(arguments: &RecordArguments) -> Result<(), Failure> {
    // Refuse at once, not when a camera has come.
    if let Some(taken) = taken_by_earlier(&arguments.clip) {
        return Err(Failure::ClipIsThere(taken));
    }
    live(&arguments.live, Some(arguments.clip.clone()))
}
