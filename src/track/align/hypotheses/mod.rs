//! What a frame may show of a body: the list of hypotheses, each a start and a prior.
//!
//! [`HYPOTHESES`] is asked in order. A hypothesis that the frame, as solved so far, calls for is
//! solved by the same minimiser as all others (`frame_problem`), and its solution replaces the one
//! before. What remains open after that, a velocity jump within the frame, is not solved again:
//! `jump_within_frame` weighs its instants by their likelihoods, and the mixture is the result.
//!
//! - `unchanged`: the frame shows what the last one did
//! - `expected`: the predicted motion
//! - `enlargement`: the picture is smooth, or linear, between its pixels
//! - `velocity_jump`: the velocity jumped since the last frame
//! - `blurred`: a newly found body moves (`velocity_by_blur` has the estimate)
//! - `occluded`: less than half of the body is in view
//!
//! # How to add a hypothesis
//! 1. A file here: the prior with its numeric tests, and an [`Hypothesis`] that says when the frame
//!    calls for it and solves with that prior.
//! 2. Its place in [`HYPOTHESES`].
//! 3. Its thresholds in `align/tuning.rs` and docs/tuning.md. `tests/pipeline/stops.rs` and `cargo
//!    bench --bench bars` show what it does.

mod blurred;
mod enlargement;
mod expected;
pub mod jump_within_frame;
pub mod occluded;
mod unchanged;
pub mod velocity_by_blur;
pub mod velocity_jump;

use super::frame_problem::FrameProblem;

/// A hypothesis on what a frame shows.
pub trait Hypothesis: Sync {
    /// Its name in the log.
    fn name(&self) -> &'static str;

    /// Whether the frame, as solved so far, calls for it.
    fn is_called_for(&self, frame: &mut FrameProblem) -> bool;

    /// Solves the frame with its start and prior. `None` if no solution remains.
    fn solve(&self, frame: &mut FrameProblem) -> Option<()>;
}

/// All hypotheses, in the order in which they are asked.
const HYPOTHESES: [&dyn Hypothesis; 7] = [
    &unchanged::Unchanged,
    &expected::Expected,
    &enlargement::OtherEnlargement,
    &velocity_jump::VelocityJump,
    &blurred::Blurred,
    &occluded::Occluded,
    &blurred::BlurredBehindOccluder,
];

/// Solves a frame with every hypothesis that it calls for. `None` if no solution remains.
pub fn solve_by_hypotheses(frame: &mut FrameProblem) -> Option<()> {
    for hypothesis in HYPOTHESES {
        if hypothesis.is_called_for(frame) {
            tracing::trace!(hypothesis = hypothesis.name());
            hypothesis.solve(frame)?;
        }
    }
    Some(())
}
