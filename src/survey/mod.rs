//! What a clip of a known stage reveals about the camera and the stage itself: [`shutter`]
//! estimates readout and exposure from a shaken clip, [`stage`] surveys the stage as it hangs and
//! the lens from a walk (C11).
//!
//! A survey takes an iterator of frames from any source, and may read them several times.

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
