//! What is known of a clip's camera before its first row, from the clip or from a file.

use std::path::{Path, PathBuf};

use super::failure::Failure;
use crate::daemon::learnt_of_clip;
use crate::daemon::learnt_state::MAX_LEARNT_BYTES;
use crate::safe_file;
use crate::track::LearntCamera;

/// The `--learnt FILE` option.
#[derive(Debug, Clone, Default, clap::Args)]
pub(super) struct LearntArguments {
    /// Start with what this file says was learnt of the camera [default: what the clip says, else
    /// nothing]
    #[arg(long = "learnt", value_name = "FILE")]
    file: Option<PathBuf>,
}

impl LearntArguments {
    /// Returns what is known before the clip's first row, and a word for its source.
    pub fn of(&self, clip: &Path) -> Result<(LearntCamera, &'static str), Failure> {
        if let Some(file) = &self.file {
            let unusable = |reason: String| Failure::Usage(format!("{}: {reason}", file.display()));
            let bytes = safe_file::read(file, MAX_LEARNT_BYTES).map_err(|e| unusable(format!("{e}; name a readable file")))?;
            return LearntCamera::from_bytes(&bytes).map(|learnt| (learnt, "file")).map_err(|e| unusable(e.to_string()));
        }
        let learnt = learnt_of_clip(clip).unwrap_or_else(|reason| {
            tracing::warn!("{reason}");
            LearntCamera::default()
        });
        Ok((learnt, if learnt.is_empty() { "nothing" } else { "clip" }))
    }
}
