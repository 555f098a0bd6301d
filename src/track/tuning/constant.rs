//! The constants of all rooms as one constant.

use super::frame_order::{self, FrameOrderTuning};
use crate::track::acquire::tuning::{self as acquire, AcquireTuning};
use crate::track::align::tuning::{self as align, AlignTuning};
use crate::track::body::tuning::{self as body, BodyTuning};
use crate::track::frame::tuning::{self as frame, FrameTuning};
use crate::track::model_error::tuning::{self as model_error, ModelErrorTuning};
use crate::track::patches::tuning::{self as patches, PatchesTuning};
use crate::track::scene::tuning::{self as scene, SceneTuning};

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
    scene: scene::TUNING,
    frame: frame::TUNING,
    patches: patches::TUNING,
    align: align::TUNING,
    model_error: model_error::TUNING,
    acquire: acquire::TUNING,
    body: body::TUNING,
    frame_order: frame_order::TUNING,
};
