//! Logs of poses, ours or another tracker's, and the delays that are looked for between them.

use std::path::Path;

use super::failure::Failure;
use crate::delay::log::{self, PoseLog};
use crate::safe_file;

/// Maximum size of a log, bytes: days at 200 lines a second. Raised, a wrong file takes more
/// memory.
const MAX_LOG: u64 = 1 << 30;

/// Reads a log, which has rows. `failure` makes the failure of a file that is no log.
pub(super) fn read(file: &Path, failure: fn(String) -> Failure) -> Result<PoseLog, Failure> {
    let name = file.display();
    let bytes = safe_file::read(file, MAX_LOG).map_err(|e| Failure::Usage(format!("{name}: {e}; name a readable file")))?;
    log::read(&bytes).map_err(|e| failure(format!("{name}: {e}")))
}

/// Parses the largest delay that is looked for; beyond a minute, logs are of different clocks.
pub(super) fn delay_range(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|s| (0.05..=60.0).contains(s)).ok_or_else(|| "give seconds from 0.05 to 60".to_owned())
}
