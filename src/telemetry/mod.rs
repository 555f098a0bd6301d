//! What a running daemon counts: [`Statistics`] is filled without locks; [`health`] and [`metrics`] are pure functions from it to a page.

mod health;
mod histogram;
mod metrics;
mod page;
mod statistics;

pub use health::health;
pub use metrics::metrics;
pub use page::Page;
pub use statistics::{CameraState, RecorderState, Statistics};
