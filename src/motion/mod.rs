//! Motion models, shared by following, coasting, prediction and resampling.
//!
//! A [`Motion`] is a pose with velocity and acceleration. A [`MotionEstimate`] adds the uncertainty
//! and propagates it from frame to frame with white jerk ([`ProcessNoise`]). A [`UniformMotion`] is
//! the line through the last poses. [`MotionHistory`] extrapolates the last measured motion while
//! nothing is seen, and [`Reach`] limits predictions to the body's recent motion.

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

/// Maximum acceleration of a camera or a body, m/s²: ten times gravity, which no hand reaches.
/// Raised, nearer copies pass for a motion; lowered, a shaken camera jumps.
pub const MAX_ACCELERATION: f64 = 100.0;
