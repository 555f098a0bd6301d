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
//! - `body`: what is remembered of a body; with `align::learned` the only memory
//!
//! The files in this folder define the order of a frame: `body_tracker` runs it, `body_search`
//! finds missing bodies, `failure` says why a frame has no pose, `two_view` describes the frame by
//! a homography and an essential matrix, `tile_observer` measures single frames for the survey,
//! `settings` holds what is configured, `tuning` what is tuned.

#[macro_use]
mod tuning;

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
mod tile_observer;
mod two_view;

pub use acquire::candidate::{SurfaceMatch, SurfaceView};
pub use acquire::view_bank::ViewStore;
pub use align::{AlignKernels, Alignment, Clue, UsedPixel};
pub(crate) use body::agreement;
pub use body::learnt_camera::{LearntCamera, LearntError, LearntTime, MAX_LEARNT_BYTES};
pub use body::pixel_watch::{Displaced, UsedPixels};
pub use body::reason::Reason;
pub use body::shutter_news::ShutterNews;
pub use body::track_state::State;
pub use body_tracker::{BodyObservation, BodyTracker, FrameObservation};
#[cfg(feature = "calibrate")]
pub(crate) use frame::frame_look::{FrameLook, PictureFault};
pub use model_error::lens_doubt::covariance_by_lens;
pub use model_error::misfit::{ModelNews, ModelReport, Part};
pub use model_error::moments::Mixture;
pub use patches::verify::Verified;
pub use scene::repetition::periods;
#[cfg(test)]
pub use scene::shape::tests::folds;
pub use scene::shape::{BentShape, ShapePoint, ShapeWay, SurfaceShape};
pub use scene::surface::{BodySpec, ReferenceKind, SurfaceDoubt, SurfaceError, SurfaceSpec};
pub use settings::TrackerSettings;
pub use tile_observer::{KnownRates, ObservedFrame, ObservedTile, TileObserver};
pub use tuning::TUNING;
