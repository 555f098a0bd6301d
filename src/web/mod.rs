//! What a running daemon tells of itself, and the HTTP server that gives it out.
//!
//! [`Statistics`] is filled by the daemon without locks; [`health`] and [`metrics`] are pure functions from it to a page. The server
//! (feature `http`) adds the pose: `GET /ws` sends every record as a line of JSON (contract C3), `GET /api/v1/pose` the last record,
//! `GET /api/v1/state` what is known and since when, and whatever routes the caller adds. It has one thread, listens on loopback unless
//! told otherwise, answers only for this machine's hosts and to pages of its own, takes only small requests without content, and lets go of
//! a client that does not read.

#[cfg(feature = "http")]
mod answers;
#[cfg(feature = "http")]
mod feed;
#[cfg(feature = "http")]
mod guard;
mod health;
mod histogram;
mod hosts;
mod metrics;
#[cfg(feature = "http")]
mod pace;
#[cfg(feature = "http")]
mod places;
#[cfg(feature = "http")]
mod routes;
#[cfg(feature = "http")]
mod server;
mod settings;
mod statistics;

pub use health::health;
pub use histogram::Histogram;
pub use hosts::{AllowedHosts, HostName};
pub use metrics::metrics;
#[cfg(feature = "http")]
pub use routes::{Reply, Request, Route};
#[cfg(feature = "http")]
pub use server::{Server, WebError};
pub use settings::HttpSettings;
pub use statistics::{CameraState, RecorderState, Statistics};

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
