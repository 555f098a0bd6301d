//! The pose stage: turns observations into reported poses in the stage frame with their covariance,
//! applies the filter if configured, and predicts while coasting.

mod filter;
mod stage;

pub use filter::{FilterKind, FilterSettings, KalmanSettings, OneEuroSettings};
pub use stage::{BodyEstimate, PoseEstimate, PoseStage};
