//! Motions that the prediction does not contain. Each one gives a prior with which the solved frame
//! is solved once more. `solve::jump_instant` weighs jumps within the frame afterwards, without
//! solving again.
//!
//! - `velocity_jump`: the velocity jumped since the last frame
//! - `velocity_by_blur`: the velocity that motion blur shows
//!
//! # How to add a hypothesis
//! 1. Here: a file with a function that returns the prior, and its numeric tests.
//! 2. `frame_problem`: a method `solve_with_…` that decides whether the frame calls for it, and
//!    solves with that prior.
//! 3. `Aligner::align`: its turn among the others.
//! 4. A jump within the frame is instead a member of the mixture in `solve::jump_instant`, which
//!    `FrameProblem::allow_for_jumps` evaluates.
//! 5. Its thresholds go to `align/tuning.rs` and docs/tuning.md. `tests/pipeline/stops.rs` and
//!    `cargo bench --bench bars` show what it does.
//!
//! Uses `align::solve`.

pub mod velocity_by_blur;
pub mod velocity_jump;
