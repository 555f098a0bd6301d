//! What happens to a body in one frame.

use crate::geometry::{Body, Camera, Pose};
use crate::motion::MotionEstimate;
use crate::track::align::ShutterClue;
use crate::track::body::learnt_readout::ReadoutDoubt;
use crate::track::body::reason::Reason;
use crate::track::patches::verify::Refusal;

/// One frame's attempts to find a body. Begins empty in each frame; nothing of it reaches the next.
#[derive(Debug, Default)]
pub struct Attempt {
    /// How well the readout time is known; `None` if the frame is not asked about it.
    pub readout_doubt: Option<ReadoutDoubt>,
    /// Maximum time to the next frame, seconds.
    pub to_next_s: f64,
    /// The last frame's motion, if the body was aligned there.
    pub motion_before: Option<MotionEstimate>,
    /// The predicted pose from which the body was followed, successfully or not.
    pub followed_from: Option<Pose<Body, Camera>>,
    /// Poses from features from which alignment started, successfully or not.
    pub tried: Vec<Pose<Body, Camera>>,
    /// Whether the last alignment fits what is visible of the body, but too little is visible.
    pub is_seen_in_part: bool,
    /// What the frame says about the shutter, if it was asked and the body was aligned.
    pub clue: Option<ShutterClue>,
    /// The refusal of the pose that passed the most checks.
    pub refusal: Option<Refusal>,
    /// Why the frame has no verified pose.
    pub reason: Option<Reason>,
}

impl Attempt {
    /// Begins a frame; keeps the buffer.
    pub fn begin(&mut self, readout_doubt: Option<ReadoutDoubt>, to_next_s: f64) {
        let mut tried = std::mem::take(&mut self.tried);
        tried.clear();
        *self = Self { readout_doubt, to_next_s, tried, ..Self::default() };
    }

    /// Keeps the refusal that passed the most checks.
    pub fn refuse(&mut self, refusal: Refusal) {
        if self.refusal.is_none_or(|other| refusal.stage() > other.stage()) {
            self.refusal = Some(refusal);
        }
    }
}
