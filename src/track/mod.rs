//! Tracking: what bodies are made of, and how a frame becomes a verified pose of each of them.
//!
//! `surface`, `shape` and `reference` prepare the pictures; `view_bank` describes them from all sides; `feature_search` matches a frame's features with that bank; `acquire` proposes poses from them;
//! `registration` and `verify` refine a proposal against the picture and judge it; `align` follows a body from frame
//! to frame, pixel by pixel; `track_state` decides what a verified pose means in time;
//! `frame_interval` measures how often frames come; `two_view` describes the frame by
//! homography and essential matrix; `lens_doubt` and `shape_doubt` tell what the doubt about lens and shapes leaves open; `tile_residuals` are the displacements that a solution leaves, `model_error` is what
//! they say of the pose by a `smooth_field` of shifts, `model_study` finds which part of the model they speak against (its unknowns: `model_unknowns`; what it found: `misfit`), which `model_watch` says once, `focal_clue` what they say of the focal length, and `lens_watch` withholds poses where the lens was moved; `moments` withholds those of frames that show two moments at once; `reason` says why a frame has no pose, `failure` finds it, with
//! `frame_look`; `unexplained` is what of a frame no followed body explains, where missing ones are looked for, in `search_windows` (`expected_view` draws what should be seen, from an `averaged_picture` of each surface); `planar_ambiguity` tells a flat surface from its mirror image in tilt; `tracked_body` holds what is known of one
//! body; `body_search` looks for those that are not followed; `pixel_watch` shows what a pose rests on to whoever asks; `matcher` runs them all on a frame.

mod acquire;
pub(crate) mod agreement;
mod align;
mod averaged_picture;
mod bilinear;
mod body_search;
mod clock_steps;
mod corner_ways;
mod expected_candidate;
mod expected_view;
mod failure;
mod feature_search;
mod fitted_anchor;
mod focal_clue;
mod focal_step;
mod frame_interval;
mod frame_look;
mod learnt_camera;
mod learnt_readout;
mod lens_doubt;
mod lens_watch;
mod matched_focal;
mod matcher;
mod misfit;
mod model_error;
mod model_study;
mod model_unknowns;
mod model_watch;
mod moments;
mod pixel_watch;
mod planar_ambiguity;
mod reason;
mod rectangle;
mod reference;
mod registration;
mod repetition;
mod row_motion;
mod search_windows;
mod settings;
mod shape;
mod shape_doubt;
mod shutter_news;
mod smooth_field;
mod surface;
mod surface_doubt;
#[cfg(test)]
mod synthetic;
mod tile_observer;
mod tile_residuals;
mod track_state;
mod tracked_body;
mod two_view;
mod unexplained;
mod unexplained_cells;
mod verify;
mod view_bank;

pub use acquire::{SurfaceMatch, SurfaceView};
pub use align::{AlignKernels, Alignment, Clue, UsedPixel};
pub(crate) use feature_search::LOWE_RATIO;
#[cfg(feature = "calibrate")]
pub(crate) use frame_look::{FrameLook, PictureFault};
pub use learnt_camera::{LARGEST_LEARNT_BYTES, LearntCamera, LearntError, LearntTime};
pub use learnt_readout::{MODEL_ERROR_PX, VAGUE_READOUT_S};
pub use lens_doubt::covariance_by_lens;
pub use matcher::{BodySighting, Matcher, Sighting};
pub use misfit::{ModelNews, ModelReport, Part};
pub use moments::Mixture;
pub use pixel_watch::{Displaced, UsedPixels};
pub use reason::Reason;
pub use repetition::periods;
pub use settings::TrackerSettings;
#[cfg(test)]
pub use shape::tests::folds;
pub use shape::{BentShape, ShapePoint, ShapeWay, SurfaceShape};
pub use shutter_news::ShutterNews;
pub use surface::{BodySpec, ReferenceKind, SurfaceDoubt, SurfaceError, SurfaceSpec};
pub use tile_observer::{KnownRates, ObservedFrame, ObservedTile, TileObserver};
pub use track_state::State;
pub use verify::Verified;
pub use view_bank::ViewStore;
