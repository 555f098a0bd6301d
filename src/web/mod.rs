//! The HTTP server: the pose as WebSocket stream and on request, and whatever routes the caller adds.
//!
//! `GET /ws` sends every record as a line of JSON (contract C3), `GET /api/v1/pose` the last record, `GET /api/v1/state` what is known
//! and since when. The server has one thread. It listens on loopback unless told otherwise, takes only small GET requests, and lets go of
//! a WebSocket client that does not read.

#[cfg(feature = "http")]
mod feed;
#[cfg(feature = "http")]
mod routes;
#[cfg(feature = "http")]
mod server;
mod settings;

#[cfg(feature = "http")]
pub use routes::{Reply, Request, Route};
#[cfg(feature = "http")]
pub use server::{Server, WebError};
pub use settings::HttpSettings;
