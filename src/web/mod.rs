//! The HTTP server (feature `http`).
//!
//! Routes:
//! - `GET /` is the page;
//! - `GET /ws` sends every record as a line of JSON (contract C3);
//! - `GET /ws/view` sends the picture with its record to a client that asks for a frame;
//! - `GET /ws/events` sends events;
//! - `GET /api/v1/pose` is the last record;
//! - `GET /api/v1/state` is the known state and its age;
//! - `GET /api/v1/scene` is the camera and the surfaces, with `?format=` as a file for other
//!   programs;
//! - and the routes that the caller adds.
//!
//! One thread answers requests; two assemble the messages with pictures. The server listens on
//! loopback by default. It answers only for this machine's hosts and only to its own pages, takes
//! only small requests, and drops a client that does not read. Work that takes time (`api`:
//! recordings, the config, the set, health) runs on threads with lower priority than the tracker's.
//! Only clients on this machine and paired browsers may make changes (`keys`).

#[cfg(feature = "http")]
mod answers;
#[cfg(feature = "http")]
mod api;
#[cfg(feature = "http")]
mod assets;
#[cfg(feature = "http")]
mod call;
#[cfg(feature = "http")]
mod camera_motion;
#[cfg(feature = "http")]
mod connection;
#[cfg(feature = "http")]
mod content;
#[cfg(feature = "http")]
mod download;
#[cfg(feature = "http")]
mod entrance;
#[cfg(feature = "http")]
mod events;
#[cfg(feature = "http")]
mod feed;
#[cfg(feature = "http")]
mod guard;
mod hosts;
#[cfg(feature = "http")]
mod hub;
#[cfg(feature = "http")]
mod keys;
#[cfg(feature = "http")]
mod lanes;
#[cfg(feature = "http")]
mod lifetime;
#[cfg(feature = "http")]
mod packing;
#[cfg(feature = "http")]
mod places;
#[cfg(feature = "http")]
mod replies;
#[cfg(feature = "http")]
mod reply;
#[cfg(feature = "http")]
mod routes;
#[cfg(feature = "http")]
mod scene;
#[cfg(feature = "http")]
mod server;
#[cfg(feature = "http")]
mod stage_files;
#[cfg(feature = "http")]
mod view;

#[cfg(feature = "http")]
pub use api::{about, judge_model, routes};
pub use hosts::{AllowedHosts, page_address};
#[cfg(feature = "http")]
pub use keys::code_file;
#[cfg(feature = "http")]
pub use server::{Server, Site};
#[cfg(feature = "http")]
pub use stage_files::StageSource;
