//! What an alignment is asked for. A caller states all of it with each call; the aligner remembers
//! none of it.

use super::solve::shutter_clue::ReadoutQuestion;
use crate::motion::MotionEstimate;

/// Where an alignment starts.
#[derive(Debug, Clone, Copy)]
pub struct Start<'a> {
    /// The predicted motion.
    pub expected: &'a MotionEstimate,
    /// Seconds since the last frame if the body is followed, as its velocity may have jumped since;
    /// `None` for a body that was just found.
    pub since_s: Option<f64>,
    /// Whether to start only at the level that holds the usual start error. Otherwise alignment
    /// starts there and, where that does not fit, again at the level that holds the whole
    /// uncertainty.
    pub is_nearby_only: bool,
}

impl<'a> Start<'a> {
    /// Starts from a motion predicted from the last frame, `since_s` ago.
    pub fn predicted(expected: &'a MotionEstimate, since_s: f64) -> Self {
        Self { since_s: Some(since_s), ..Self::found(expected) }
    }

    /// Starts from a pose that was found in this frame.
    pub fn found(expected: &'a MotionEstimate) -> Self {
        Self { expected, since_s: None, is_nearby_only: false }
    }
}

/// What to align, and how.
#[derive(Debug, Clone, Copy)]
pub struct AlignRequest<'a> {
    /// Where alignment starts.
    pub start: Start<'a>,
    /// Whether a pose of the body was reported before. Then whatever differs from the body is taken
    /// to be in front of it, wherever the body is found. Before that, its picture or size may
    /// differ from the configured one, and a part that fits by chance must not be taken for its
    /// visible part.
    pub was_reported: bool,
    /// The question about the shutter; with one, the solution has a
    /// [`ShutterClue`](super::solve::shutter_clue::ShutterClue).
    pub readout: Option<ReadoutQuestion>,
}

impl<'a> AlignRequest<'a> {
    /// Requests the alignment of a body without a question about the shutter.
    pub fn new(start: Start<'a>, was_reported: bool) -> Self {
        Self { start, was_reported, readout: None }
    }
}
