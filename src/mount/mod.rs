//! Where the filming camera sits on the rig: `T_tracking_filming`, measured from views that both cameras took at once.
//!
//! The tracking camera tells where it is; the picture that goes on air comes from another one, bolted to the same rig. Where both see
//! the same stage, each pair of views gives the mount directly: T_tracking_filming = T_stage_tracking⁻¹ T_stage_filming. Where each has
//! a board of its own, two things are unknown, the mount and how the boards stand to one another, and only the rig's motion between the
//! views tells them apart (robotics' AX = YB): a rig that turned about one axis only leaves the shift along that axis open.
//!
//! [`still_pairs`] finds the views in two clips, [`solve`] weighs them by their covariances and leaves out those that contradict the others,
//! [`judge`] says how far to trust the result, and [`next_view`] what would better it.

mod advice;
mod residual;
mod sight;
mod solve;
#[cfg(test)]
mod solve_tests;
mod start;
mod still;
mod views;

pub use crate::calibrate::judge::Verdict;
pub use advice::{NextView, is_doubt_of_lenses, judge, next_view, worst_sigmas};
pub use sight::ObservationModel;
pub use solve::{Solution, Unsolvable, Used, solve};
pub use still::{StillPair, Unpaired, still_pairs};
pub use views::{Stages, View, ViewPair};
