//! `stagepose calibrate` and `stagepose board` as a user runs them.

mod bad;
mod good;
mod live;
pub mod rendered;
mod scene;
mod slips;
