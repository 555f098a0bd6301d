//! The body moves as predicted, within the uncertainty of the prediction. This is the usual case.

use super::Hypothesis;
use crate::track::align::frame_problem::FrameProblem;

/// The predicted motion, from coarse to fine.
pub struct Expected;

impl Hypothesis for Expected {
    fn name(&self) -> &'static str {
        "expected"
    }

    fn is_called_for(&self, frame: &mut FrameProblem) -> bool {
        !frame.buffers.has_kept
    }

    fn solve(&self, frame: &mut FrameProblem) -> Option<()> {
        frame.coarse_to_fine().map(drop)
    }
}
