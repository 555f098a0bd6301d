//! What aligned frames say of the shutter (readout and exposure). A clue is one frame's estimate
//! with its information; clues are gathered over many frames and never used within one.

use crate::motion::MotionError;
use crate::track::align::learned::clue::Clue;

/// One frame's clues on the shutter it was taken with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShutterClue {
    /// On the readout, seconds.
    pub readout: ReadoutClue,
    /// How fast the picture moves through the frame, pixels per second. An error of the model that
    /// displaces rows by x pixels looks like a readout error of x over this speed.
    pub speed_px_s: f64,
    /// On the exposure, relative to itself; `None` where the frame is too sharp to tell.
    pub exposure: Option<Clue>,
    /// Whether the frame was solved with the readout taken as unknown, so that no velocity jump
    /// could absorb the effect of a wrong one.
    pub is_open: bool,
    /// Whether the readout may be learnt from it: the motion of the frame was predicted, and
    /// predicted fast enough.
    pub may_teach: bool,
}

/// One frame's clue on the readout that it was solved with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadoutClue {
    /// The change of readout that the rows ask for with the predicted motion taken as given,
    /// seconds.
    pub clue: Clue,
    /// Fraction of a readout change that shows in `clue`. The predicted motion was estimated with
    /// the same readout and hides the rest.
    pub shown: f64,
    /// Derivative of the solved motion by the readout, per second.
    pub motion_by_readout: MotionError,
}

/// A request for a frame's clue on its readout.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadoutQuestion {
    /// Derivative of the predicted motion by the readout that the frames before were solved with,
    /// per second.
    pub expected_by_readout: MotionError,
    /// Whether the readout may be so far off that a velocity jump would explain it.
    pub is_open: bool,
    /// Whether the readout may be learnt from the answer. Otherwise it only widens the covariance.
    pub may_teach: bool,
    /// Minimum speed of the picture, pixels per second; a slower frame gives no answer.
    pub min_speed_px_s: f64,
}
