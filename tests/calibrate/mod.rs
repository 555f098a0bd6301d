//! `stagepose calibrate` and `stagepose board` as a user runs them.

mod bad;
mod good;
mod live;
mod scene;
mod slips;
