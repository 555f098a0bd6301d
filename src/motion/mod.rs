//! How things move: one model for following, coasting, prediction and resampling.
//!
//! A [`Motion`] is a pose with its velocity and acceleration; a [`MotionEstimate`] adds how sure that is and carries it from frame to frame by
//! white jerk ([`ProcessNoise`]); a [`UniformMotion`] is the line that the last poses lie on. [`MotionHistory`] carries
//! the last measured motion on while nothing is seen, and [`Reach`] allows no prediction to go further than the body lately moved.

mod estimate;
mod history;
mod line;
mod object_motion;
mod process_noise;
mod reach;
mod recent;
mod state;

pub use estimate::{MotionEstimate, unseen};
pub use history::{FADE_S, MotionHistory};
pub use line::{Continuation, UniformMotion};
pub use process_noise::ProcessNoise;
pub use reach::Reach;
pub use recent::Recent;
pub use state::{Motion, MotionError, MotionMatrix};
