//! Local features of a grey picture: where they are, and descriptors of their surroundings.
//!
//! The tracker's own features come from [`FeatureExtractor`], which reuses its buffers from frame
//! to frame. It builds a scale pyramid (`pyramid`), finds corners on each level (`corners`), and
//! gives each a binary descriptor that is rotated with the corner (`descriptor`). The published
//! methods are in `detectors` and `descriptors`; `choice` selects them by name, and
//! `view_simulation` runs them on simulated oblique views.
//!
//! Hot loops are in `kernels` and the files that need them, each with a plain twin that tests
//! compare it with. Uses `geometry`, `simd` and `compute_clock`.

mod choice;
mod contrast;
mod corners;
mod descriptor;
pub mod descriptors;
pub mod detectors;
#[cfg(test)]
mod extraction_twin;
mod extractor;
mod float_image;
mod integral_image;
mod kernels;
mod keypoint;
mod open_pixels;
mod pattern;
mod pyramid;
pub mod repeatability;
mod scale_space;
mod second_moments;
mod shrink;
#[cfg(test)]
mod test_pictures;
mod tilted_view;
mod view_simulation;
mod watch;
mod workers;

pub use choice::{DescriptorKind, DetectorKind, FeatureSettings, detect, extract, extract_watched};
pub use contrast::ContrastStretch;
pub use corners::{CornerBuffers, CornerOptions, Polarity, detect_corners};
pub use descriptor::{Descriptor, describe, orientation};
pub use extractor::{ExtractorOptions, Feature, FeatureExtractor};
pub use float_image::FloatImage;
pub use keypoint::{Descriptors, Features, Keypoint, PictureForms};
pub(crate) use pyramid::resize_buffer;
pub use pyramid::{Pyramid, halved, smooth_into};
pub use tilted_view::{TiltedViews, append_tilted_features};
pub use view_simulation::ViewSimulation;
pub use watch::Share;
pub use workers::Workers;
