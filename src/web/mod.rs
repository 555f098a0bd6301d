//! The HTTP server (feature `http`): `GET /` is the page, `GET /ws` sends every record as a line of JSON (contract C3), `GET /ws/view` the
//! picture with its record to whoever asks for a frame, `GET /ws/events` what happens, `GET /api/v1/pose` the last record, `GET /api/v1/state` what is known and since
//! when, `GET /api/v1/scene` the camera and the surfaces, and whatever routes the caller adds. It has one thread for answers and one for
//! pictures, listens on loopback unless the config says otherwise, answers only for this machine's hosts and to pages of its own, takes only
//! small requests, and lets go of a client that does not read. What may take its time (`api`: recordings, the config, the set, health) is done on
//! threads that stand back behind the tracker. Whoever changes something is on this machine, or paired (`keys`).

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
mod priority;
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
mod view;

#[cfg(feature = "http")]
pub use api::{about, judge_model, routes};
pub use hosts::{AllowedHosts, page_address};
#[cfg(feature = "http")]
pub use keys::code_file;
#[cfg(feature = "http")]
pub use server::{Server, Site};
