//! Clips from the fixture and from real cameras, tracked by the built binary and held to what is known of them.

mod fixture;
mod kiosk;
mod postcard;
mod replayed;
pub mod shared;
mod teabox;
