//! What aligned frames say of the shutter: clues that are gathered over many frames, never used within one.

use super::system::schur_complement::Clue;

/// What a frame says of the shutter it was taken with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShutterClue {
    /// On the readout, seconds.
    pub readout: Clue,
    /// How fast the picture moves through the frame, pixels per second: what the model is off shows in the rows beside that.
    pub speed_px_s: f64,
    /// On the exposure, as a share of itself; `None` where the frame is too sharp to tell.
    pub exposure: Option<Clue>,
}
