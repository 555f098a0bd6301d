//! Local features of a grey picture: where they are, and descriptors of their surroundings.
//!
//! The tracker's own features come from [`FeatureExtractor`], which reuses its buffers from frame
//! to frame. It builds a scale pyramid (`pyramid`), finds corners on each level (`corners`), and
//! gives each a binary descriptor that is rotated with the corner (`descriptor`). The published
//! methods are in `two_views`, which only the feature `two-views` compiles.
//!
//! Hot loops are in `kernels` and the files that need them, each with a plain twin that tests
//! compare it with. Uses `geometry`, `simd` and `compute_clock`.

mod contrast;
mod corners;
mod descriptor;
#[cfg(test)]
mod extraction_twin;
mod extractor;
mod float_image;
mod kernels;
mod open_pixels;
mod pattern;
mod pyramid;
mod shrink;
mod simulated_view;
#[cfg(test)]
mod test_pictures;
mod tilted_view;
#[cfg(feature = "two-views")]
pub mod two_views;
mod workers;

pub use contrast::ContrastStretch;
pub use corners::{CornerBuffers, CornerOptions, Polarity, detect_corners};
pub use descriptor::{Descriptor, describe, orientation};
pub use extractor::{ExtractorOptions, Feature, FeatureExtractor};
pub(crate) use pyramid::resize_buffer;
pub use pyramid::{Pyramid, halved, halved_by, smooth_into};
pub use tilted_view::{TiltedViews, append_tilted_features};
pub use workers::Workers;
