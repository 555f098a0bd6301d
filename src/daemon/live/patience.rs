//! How long the pipeline bears a camera that is silent, blocked or gone.

use std::time::Duration;

/// How long the pipeline bears what.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Patience {
    /// One wait for a picture.
    pub read: Duration,
    /// No picture at all, before the camera is opened again (and 15 frame times at least).
    pub silence: Duration,
    /// A call that does not come back, before it is interrupted; twice this, before it is left behind.
    pub blocked: Duration,
    /// Between two tries to open.
    pub between_openings: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        let ms = Duration::from_millis;
        Self { read: ms(100), silence: ms(1500), blocked: ms(3000), between_openings: ms(300) }
    }
}
