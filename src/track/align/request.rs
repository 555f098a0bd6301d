//! What an alignment is asked for. A caller states all of it with each call; the aligner remembers
//! none of it.

use super::solve::shutter_clue::ReadoutQuestion;
use crate::motion::MotionEstimate;

/// What to align, and how.
#[derive(Debug, Clone, Copy)]
pub struct AlignRequest<'a> {
    /// The predicted motion, where alignment starts.
    pub expected: &'a MotionEstimate,
    /// Seconds since the last frame if the body is followed, as its velocity may have jumped since;
    /// `None` for a body that was just found.
    pub since_s: Option<f64>,
    /// Whether a pose of the body was reported before. Then whatever differs from the body is taken
    /// to be in front of it, wherever the body is found. Before that, its picture or size may
    /// differ from the configured one, and a part that fits by chance must not be taken for its
    /// visible part.
    pub was_reported: bool,
    /// Whether to start only at the level that holds the usual start error. Otherwise alignment
    /// starts there and, where that does not fit, again at the level that holds the whole
    /// uncertainty.
    pub is_nearby_only: bool,
    /// The question about the shutter; with one, the solution has a [`ShutterClue`].
    pub readout: Option<ReadoutQuestion>,
}

impl<'a> AlignRequest<'a> {
    /// Requests the alignment of a body that was just found and never reported.
    pub fn new(expected: &'a MotionEstimate) -> Self {
        Self { expected, since_s: None, was_reported: false, is_nearby_only: false, readout: None }
    }
}
