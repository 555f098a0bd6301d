//! The pose stage: turns observations into reported poses in the stage frame with their covariance,
//! applies the filter if configured, and predicts while coasting. The pose of a fixed camera is
//! configured; where the stage is seen, it is only checked.

mod filter;
mod fixed;
mod measured;
mod stage;

pub use filter::{FilterKind, FilterSettings, KalmanSettings, OneEuroSettings};
pub use fixed::FixedCamera;
pub use stage::{BodyEstimate, PoseEstimate, PoseStage};
