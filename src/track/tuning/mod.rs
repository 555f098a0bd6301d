//! All tuning constants of `track`: one struct per room, together one [`Tuning`].
//!
//! To change a constant, edit its line in the room's `tuning.rs`, then run `cargo bench --bench
//! bars`, which renders ten scenes and compares with the committed figures. docs/tuning.md says
//! where each value was measured.

#[macro_use]
mod declare;
pub mod frame_order;

use self::frame_order::FrameOrderTuning;
use super::acquire::tuning::AcquireTuning;
use super::align::tuning::AlignTuning;
use super::body::tuning::BodyTuning;
use super::frame::tuning::FrameTuning;
use super::model_error::tuning::ModelErrorTuning;
use super::patches::tuning::PatchesTuning;
use super::scene::tuning::SceneTuning;

/// The tuning constants of all rooms.
#[derive(Clone, Copy, Debug)]
pub struct Tuning {
    /// Surfaces, shapes and reference pictures.
    pub scene: SceneTuning,
    /// A frame's levels and rays.
    pub frame: FrameTuning,
    /// Anchors near a pose.
    pub patches: PatchesTuning,
    /// Alignment.
    pub align: AlignTuning,
    /// What residuals say about lens, shape, layout and shutter.
    pub model_error: ModelErrorTuning,
    /// Candidates for a body's pose.
    pub acquire: AcquireTuning,
    /// What is remembered of a body.
    pub body: BodyTuning,
    /// The order of a frame.
    pub frame_order: FrameOrderTuning,
}

/// The values in use.
pub const TUNING: Tuning = Tuning {
    scene: super::scene::tuning::TUNING,
    frame: super::frame::tuning::TUNING,
    patches: super::patches::tuning::TUNING,
    align: super::align::tuning::TUNING,
    model_error: super::model_error::tuning::TUNING,
    acquire: super::acquire::tuning::TUNING,
    body: super::body::tuning::TUNING,
    frame_order: frame_order::TUNING,
};
