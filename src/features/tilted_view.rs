//! The tracker's own features of a picture as seen by a tilted camera.
//!
//! An oblique view compresses the picture along one direction, by the inverse cosine of the angle
//! between the line of sight and the picture's normal. Descriptors tolerate a compression of two.
//! Beyond that they must be computed from an equally compressed picture: the simulated views of
//! ASIFT (see `simulated_view`), made from the reference alone and in advance.

use image::GrayImage;
use nalgebra::Matrix2;

use super::extractor::{BORDER, ExtractorOptions, Feature, FeatureExtractor};
use super::float_image::FloatImage;
use super::simulated_view::{SimulatedPicture, View};
use super::workers::Workers;

/// Views of one tilt, at evenly spaced longitudes over half a turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TiltedViews {
    /// Compression along one direction, above 1.
    pub tilt: f64,
    /// Number of views.
    pub count: usize,
}

impl TiltedViews {
    /// Maps the shape of a view's feature (scale and angle, see [`Feature::shape`]) to its shape in
    /// the picture. Its scale is measured along the compressed direction, so its size stays along
    /// that and shrinks by the tilt along the other.
    pub fn shape_in_picture(&self, number: usize) -> Matrix2<f64> {
        let (sin, cos) = self.longitude(number).sin_cos();
        Matrix2::new(cos, -sin / self.tilt, sin, cos / self.tilt)
    }

    fn longitude(&self, number: usize) -> f64 {
        std::f64::consts::PI * number as f64 / self.count as f64
    }
}

/// Appends the features of a picture in views of one tilt, one list per view, in the picture's own
/// pixels. `options` apply to each view. A feature's scale is along the compressed direction, where
/// it is largest; its angle is the view's.
pub fn append_tilted_features(
    picture: &GrayImage,
    views: TiltedViews,
    options: &ExtractorOptions,
    extractor: &mut FeatureExtractor,
    workers: &Workers,
    features: &mut Vec<Vec<Feature>>,
) {
    let picture = FloatImage::from_grey(picture);
    let mut of_view = Vec::new();
    for k in 0..views.count {
        let Some(view) = SimulatedPicture::of(&picture, View { tilt: views.tilt, longitude: views.longitude(k) }) else {
            features.push(Vec::new());
            continue;
        };
        extractor.extract(&view.pixels, None, options, workers, &mut of_view);
        let in_picture = of_view.iter().filter(|f| view.holds_disc(f.position, f64::from(BORDER) * f.scale));
        features
            .push(in_picture.map(|f| Feature { position: view.place_in_picture(f.position), scale: f.scale * views.tilt, ..*f }).collect());
    }
}
