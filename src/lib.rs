//! stagepose tells where a stage camera is.
#![warn(missing_docs)]

pub mod camera;
pub mod capture;
pub mod frame;
pub mod geometry;
pub mod record;
pub mod simulate;
pub mod track;
