//! The pose stage: from what a frame showed to what is said of the camera - poses turned into the stage
//! frame with their covariance, the filter where one is wanted, and the prediction while coasting.

mod filter;
mod stage;

pub use filter::{FilterKind, FilterSettings, KalmanSettings, OneEuroSettings};
pub use stage::{BodyEstimate, PoseEstimate, PoseStage};
