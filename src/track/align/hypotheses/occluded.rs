//! Something is in front of the body, and less than half of it is in view.
//!
//! Until that is known, the better half of the tiles takes part, and some of those show what
//! occludes the body and may pull its pose. A body that looked occluded while it was solved was not
//! solved to the end either.

use super::Hypothesis;
use crate::track::align::frame_problem::FrameProblem;
use crate::track::align::tuning::TUNING;

/// More than half of the body is occluded: only the tiles that fit take part.
pub struct Occluded;

impl Hypothesis for Occluded {
    fn name(&self) -> &'static str {
        "occluded"
    }

    fn is_called_for(&self, frame: &mut FrameProblem) -> bool {
        frame.by_blur.is_none() && (may_be_pulled(frame) || is_unsettled(frame))
    }

    fn solve(&self, frame: &mut FrameProblem) -> Option<()> {
        if may_be_pulled(frame) { frame.settle_by_what_fits().map(drop) } else { frame.settle_found() }
    }
}

/// Whether tiles that show something else may pull the pose of a body that was reported before.
fn may_be_pulled(frame: &mut FrameProblem) -> bool {
    frame.was_reported && !frame.known.is_sure && frame.verified().is_some_and(|(alignment, _)| alignment.may_be_pulled())
}

/// Whether a descent ended early because the body looked occluded.
fn is_unsettled(frame: &FrameProblem) -> bool {
    frame.is_found_again() && !frame.may_ask_blur() && frame.progress.last_moved_px >= TUNING.fine_converged_px
}
