//! What aligned frames say of the shutter: clues that are gathered over many frames, never used within one.

use crate::motion::MotionError;
use crate::track::align::learned::clue::Clue;

/// What a frame says of the shutter it was taken with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShutterClue {
    /// On the readout, seconds.
    pub readout: ReadoutClue,
    /// How fast the picture moves through the frame, pixels per second: what the model is off shows in the rows beside that.
    pub speed_px_s: f64,
    /// On the exposure, as a share of itself; `None` where the frame is too sharp to tell.
    pub exposure: Option<Clue>,
    /// Whether the frame was solved as one of an unknown readout: its motion must not explain what a wrong one does.
    pub is_open: bool,
    /// Whether the readout may be learnt from it: the motion of the frame was predicted, and
    /// predicted fast enough.
    pub may_teach: bool,
}

/// What a frame says of the readout that it was solved with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadoutClue {
    /// The change that the rows ask for where the expected motion is taken as given, seconds.
    pub clue: Clue,
    /// Share of a change that shows in that: the expected motion, learnt with the same readout, hides the rest.
    pub shown: f64,
    /// Derivative of the motion that was found by the readout, per second.
    pub motion_by_readout: MotionError,
}

/// How a frame is asked for its readout.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadoutQuestion {
    /// Derivative of the expected motion by the readout that the frames before were solved with, per second.
    pub expected_by_readout: MotionError,
    /// Whether the readout may be so far off that a velocity which jumps would explain it.
    pub is_open: bool,
    /// Whether the readout may be learnt from the answer. Otherwise it only widens the covariance.
    pub may_teach: bool,
    /// There is no answer from a frame that moves more slowly, pixels per second.
    pub min_speed_px_s: f64,
}
