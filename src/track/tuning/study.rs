//! What each tuning constant does: lists them, and scales one at a time. Only built with the
//! feature `tuning`, for `cargo bench --bench bars -- tuning`.

use super::adjustable::{Adjust, Adjustable};
use super::frame_order::{self, FrameOrderTuning};
use crate::track::acquire::tuning::{self as acquire, AcquireTuning};
use crate::track::align::tuning::{self as align, AlignTuning};
use crate::track::body::tuning::{self as body, BodyTuning};
use crate::track::frame::tuning::{self as frame, FrameTuning};
use crate::track::model_error::tuning::{self as model_error, ModelErrorTuning};
use crate::track::patches::tuning::{self as patches, PatchesTuning};
use crate::track::scene::tuning::{self as scene, SceneTuning};

/// The tuning constants of all rooms, as they are now.
#[derive(Clone, Copy, Debug)]
pub struct AdjustableTuning {
    /// Surfaces, shapes and reference pictures.
    pub scene: &'static Adjustable<SceneTuning>,
    /// A frame's levels and rays.
    pub frame: &'static Adjustable<FrameTuning>,
    /// Anchors near a pose.
    pub patches: &'static Adjustable<PatchesTuning>,
    /// Alignment.
    pub align: &'static Adjustable<AlignTuning>,
    /// What residuals say about lens, shape, layout and shutter.
    pub model_error: &'static Adjustable<ModelErrorTuning>,
    /// Candidates for a body's pose.
    pub acquire: &'static Adjustable<AcquireTuning>,
    /// What is remembered of a body.
    pub body: &'static Adjustable<BodyTuning>,
    /// The order of a frame.
    pub frame_order: &'static Adjustable<FrameOrderTuning>,
}

/// The values in use.
pub const TUNING: AdjustableTuning = AdjustableTuning {
    scene: &scene::TUNING,
    frame: &frame::TUNING,
    patches: &patches::TUNING,
    align: &align::TUNING,
    model_error: &model_error::TUNING,
    acquire: &acquire::TUNING,
    body: &body::TUNING,
    frame_order: &frame_order::TUNING,
};

/// A tuning constant.
#[derive(Debug, Clone, PartialEq)]
pub struct Constant {
    /// The room that declares it: a folder of `src/track`, or `frame_order`.
    pub room: &'static str,
    /// Its name.
    pub name: &'static str,
    /// Its value, as declared.
    pub value: String,
}

/// All rooms, in the order of the folders.
const ROOMS: [(&str, &dyn Adjust); 8] = [
    ("scene", &scene::TUNING),
    ("frame", &frame::TUNING),
    ("patches", &patches::TUNING),
    ("align", &align::TUNING),
    ("model_error", &model_error::TUNING),
    ("acquire", &acquire::TUNING),
    ("body", &body::TUNING),
    ("frame_order", &frame_order::TUNING),
];

/// Returns all tuning constants, in the order in which they are declared.
pub fn constants() -> Vec<Constant> {
    let of_room = |(room, values): (&'static str, &'static dyn Adjust)| {
        values.names().iter().map(move |name| Constant { room, name, value: values.value(name).unwrap_or_default() })
    };
    ROOMS.into_iter().flat_map(of_room).collect()
}

/// Multiplies the declared value of one constant by a factor; all others are as declared. Trackers
/// that exist keep what they computed with other values. False if there is no such constant.
pub fn scale(room: &str, name: &str, factor: f64) -> bool {
    restore();
    ROOMS.iter().any(|(own, values)| *own == room && values.scale(name, factor))
}

/// Uses all constants as declared.
pub fn restore() {
    ROOMS.iter().for_each(|(_, values)| values.restore());
}
