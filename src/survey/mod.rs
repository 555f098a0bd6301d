//! What a clip of a known stage says of the camera and of the stage itself: [`shutter`] finds readout and exposure from a shaken clip, [`stage`]
//! finds the stage as it hangs and the lens as it is from a walk (C11).
//!
//! A survey takes an iterator of frames, wherever they come from, and reads them as often as it needs.

mod adjustment;
mod camera_rates;
pub mod constraints;
mod dense_system;
pub mod judgement;
mod keyframes;
mod lively_part;
mod normal_equations;
mod observers;
mod prior;
pub mod progress;
mod scales;
pub mod shutter;
pub mod stage;
mod stage_model;
#[cfg(test)]
mod synthetic;
mod tile_derivatives;
pub mod walk;
mod ways;
pub mod weak_parts;
