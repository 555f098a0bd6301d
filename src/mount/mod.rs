//! The pose of the filming camera on the rig, `T_tracking_filming`, measured from views that both
//! cameras took at the same time.
//!
//! The tracking camera measures its own pose, but the picture on air comes from another camera,
//! bolted to the same rig. If both see the same stage, each pair of views gives the mount directly:
//! T_tracking_filming = T_stage_tracking⁻¹ T_stage_filming. If each has a board of its own, two
//! poses are unknown, the mount and the relation of the boards, and only the rig's motion between
//! the views separates them (AX = YB in robotics): if the rig rotates about one axis only, the
//! shift along that axis is undetermined.
//!
//! [`still_pairs`] finds the views in two clips. [`solve`] weights them by their covariances and
//! rejects those that contradict the others. [`judge`] states how far to trust the result, and
//! [`next_view`] what would improve it.

mod advice;
mod residual;
mod sight;
mod solve;
#[cfg(test)]
mod solve_tests;
mod standing;
mod start;
mod still;
mod views;

pub use crate::calibrate::judge::Verdict;
pub use advice::{NextView, is_doubt_of_lenses, judge, next_view, worst_sigmas};
pub use sight::ObservationModel;
pub use solve::{Solution, Unsolvable, Used, solve};
pub use standing::{StandingRow, standing};
pub use still::{StillPair, Unpaired, still_pairs};
pub use views::{Stages, View, ViewPair};
