//! The built binary on good and bad input: exit code, message, files.

mod bad_clip;
mod bad_config;
mod examples;
mod files;
mod good;
mod outputs;
mod poster;
mod reasons;
mod report;
pub mod scene;
mod terminal;
mod usage;
