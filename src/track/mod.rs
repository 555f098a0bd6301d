//! Tracking turns a frame into an estimate of every body's pose.
//!
//! Each room is a folder and uses only the rooms above it; a test enforces the order.
//!
//! - `scene`: surfaces, shapes and reference pictures; immutable after load
//! - `frame`: one frame: its levels and the camera's rays; knows no body
//! - `patches`: near a given pose: where are the anchors, do they agree?
//! - `align`: takes a predicted motion; returns motion, covariance and evidence
//! - `model_error`: what residuals say about lens, shape, layout and shutter
//! - `acquire`: candidates for a body's pose, within a work budget
//! - `body`: what is remembered of a body; with `align::learned` the main memory
//!
//! Elsewhere only these remember something from frame to frame; a test holds the list, and names
//! all scratch space besides:
//!
//! - in `frame`: `FrameLevels` has the camera's curve, by which frames are decoded
//! - in `align`: `Aligner` owns what is learned; `Buffers` knows for how long the camera has been
//!   still, and whether its pixels are kept; `LevelProblem`, `Pixels`, `Appearance` and
//!   `TouchingPlanes` are kept while it is
//! - in `model_error`: evidence that grows over frames: `FieldSize`, `Jump`, `FocalMean`,
//!   `LensWatch`, `ModelStudy`, `ModelWatch`, `Evidence` and `MixtureWatch`
//! - in `acquire`: `UnexplainedCells`, in `Unexplained`, knows when each cell was last searched
//! - `BodySearch` knows which missing body has its turn, and `BodyTracker` owns everything
//!
//! The files in this folder define the order of a frame: `body_tracker` runs it, `body_search`
//! finds missing bodies, `failure` says why a frame has no pose, `two_view` describes the frame by
//! a homography and an essential matrix, `tile_observer` measures single frames for the survey,
//! `settings` holds what is configured, `tuning` what is tuned.

#[macro_use]
pub mod tuning;

mod acquire;
mod align;
mod body;
mod body_search;
mod body_tracker;
mod failure;
mod frame;
mod model_error;
mod patches;
mod scene;
mod settings;
#[cfg(test)]
pub(crate) mod synthetic;
#[cfg(feature = "cli")]
mod tile_observer;
mod two_view;

pub use acquire::view_bank::ViewStore;
pub use align::{AlignKernels, Alignment, UsedPixel};
pub use body::learnt_camera::{LearntCamera, LearntError, LearntTime};
pub use body::pixel_watch::UsedPixels;
pub use body::reason::Reason;
pub use body::track_state::State;
pub use body_tracker::{BodyObservation, BodyTracker, FrameObservation};
pub use patches::verify::Verified;
#[cfg(all(test, feature = "simulate"))]
pub use scene::shape::tests::folds;
pub use scene::shape::{BentShape, ShapeWay, SurfaceShape};
pub use scene::stage_map::{Facet, FacetTexture, MapFileError, StageMap};
pub use scene::surface::{BodySpec, ReferenceKind, SurfaceError, SurfaceSpec};
pub use settings::TrackerSettings;

// What only the rooms around the core use.
#[cfg(feature = "cli")]
pub use align::PixelShift;
#[cfg(feature = "calibrate")]
pub(crate) use frame::frame_look::{FrameLook, PictureFault};
#[cfg(feature = "calibrate")]
pub use model_error::lens_doubt::covariance_by_lens;
#[cfg(feature = "cli")]
pub use scene::stage_map::LIGHT_STEPS;
#[cfg(feature = "simulate")]
pub use scene::{shape::ShapePoint, surface::SurfaceDoubt};
#[cfg(feature = "cli")]
pub use tile_observer::{KnownRates, ObservedFrame, ObservedPixels, ObservedTile, TileObserver};
pub use tuning::TUNING;
#[cfg(feature = "daemon")]
pub use {
    acquire::candidate::{SurfaceMatch, SurfaceView},
    body::pixel_watch::Displaced,
    body::shutter_news::ShutterNews,
    model_error::misfit::{ModelNews, ModelReport, Part},
    model_error::moments::Mixture,
    scene::repetition::periods,
};
#[cfg(feature = "survey")]
pub use {align::Clue, body::agreement};
