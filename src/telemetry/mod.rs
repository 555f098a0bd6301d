//! What a running daemon counts: [`Statistics`] is filled without locks; [`health`] and [`metrics`] are pure functions from it to a page.

mod health;
mod histogram;
mod metrics;
mod statistics;

pub use health::health;
pub use metrics::metrics;
pub use statistics::{CameraState, RecorderState, STAGES, Statistics};

/// A page as a server gives it out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page {
    /// HTTP status.
    pub status: u16,
    /// MIME type.
    pub content_type: &'static str,
    /// The text.
    pub body: String,
}
