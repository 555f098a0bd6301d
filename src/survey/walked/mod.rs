//! Surveys the stage as it hangs, and the lens, from a walk with the camera past the stage.
//!
//! `stage` runs a survey: `walk` takes in the frames, `observers` measure their tiles, `adjustment`
//! solves for stage, lens and camera together, and `judgement` says what the result is worth.
//! `mapping` does without pictures of the stage: it paints them from the walk first.

mod adjustment;
mod camera_rates;
pub mod constraints;
mod dense_system;
pub mod judgement;
mod keyframes;
mod lively_part;
pub mod mapping;
mod normal_equations;
mod observers;
mod prior;
pub mod progress;
mod scales;
pub mod stage;
mod stage_model;
#[cfg(test)]
mod synthetic;
mod tile_derivatives;
pub mod unmodelled;
mod unseen_frames;
pub mod walk;
mod ways;
pub mod weak_parts;
