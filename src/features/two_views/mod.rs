//! Published detectors and descriptors for two-view vision, compiled with the feature `two-views`.
//!
//! They are in `detectors` and `descriptors`; `choice` selects them by name, and `view_simulation`
//! runs them on simulated oblique views. `repeatability` compares detectors. The other modules are
//! forms of a picture that they need. Uses the modules of `features`, which use none of these.

mod choice;
pub mod descriptors;
pub mod detectors;
mod float_filters;
mod integral_image;
mod keypoint;
pub mod repeatability;
mod scale_space;
mod second_moments;
mod view_simulation;
mod watch;

pub use super::float_image::FloatImage;
pub use choice::{DescriptorKind, DetectorKind, FeatureSettings, detect, extract, extract_watched};
pub use keypoint::{Descriptors, Features, Keypoint, PictureForms};
pub use view_simulation::ViewSimulation;
pub use watch::Share;
