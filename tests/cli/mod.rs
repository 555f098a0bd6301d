//! The built binary on good and bad input: exit codes, messages and files.

mod bad_clip;
mod bad_config;
mod causes;
mod export;
mod files;
mod good;
mod kept_views;
mod mistakes;
mod other_tracker;
mod outputs;
mod overlay;
mod plain_surface;
mod poster;
mod ratings;
mod readme;
mod reasons;
mod refine;
mod report;
pub mod scene;
mod terminal;
mod timecode;
mod usage;
