//! stagepose tells where a stage camera is.
#![warn(missing_docs)]

pub mod camera;
pub mod capture;
pub mod cli;
pub mod config;
pub mod daemon;
pub mod features;
pub mod frame;
pub mod geometry;
pub mod matching;
pub mod pose;
pub mod record;
pub mod simulate;
pub mod track;

pub use daemon::{Daemon, Tracker, TrackerSetup};
