//! Clips of the fixture and of real cameras, tracked by the built binary and compared with what is
//! known about them.

mod fixture;
mod kiosk;
mod postcard;
mod replayed;
pub mod shared;
mod teabox;
