//! How long the pipeline tolerates a camera that is silent, blocked or gone.

use std::time::Duration;

/// The pipeline's time limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Patience {
    /// A single wait for a picture.
    pub read: Duration,
    /// Time without any picture before the camera is reopened (at least 15 frame times).
    pub silence: Duration,
    /// Time that a call may block before it is interrupted; after twice this, its thread is
    /// abandoned.
    pub blocked: Duration,
    /// Pause between two attempts to open.
    pub between_openings: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        let ms = Duration::from_millis;
        Self { read: ms(100), silence: ms(1500), blocked: ms(3000), between_openings: ms(300) }
    }
}
