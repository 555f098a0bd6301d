//! Local features of a grey picture: a scale pyramid, corners on each level, and a binary
//! descriptor of their surroundings, rotated with the corner.
//!
//! [`FeatureExtractor`] owns the buffers and reuses them from frame to frame. Hot loops are in
//! `kernels`, each with a plain twin that tests compare it with.

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
