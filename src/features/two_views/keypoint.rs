//! The interface between detectors and descriptors: keypoints of a picture, and the derived forms
//! of the picture they need.

use std::cell::OnceCell;

use image::GrayImage;
use nalgebra::{Matrix2, Vector2};

use super::integral_image::IntegralImage;
use super::scale_space::ScaleSpace;
use super::watch::Watch;
use crate::features::Descriptor;
use crate::features::extractor::BORDER;
use crate::features::extractor::ExtractorOptions;
use crate::features::float_image::FloatImage;
use crate::features::pyramid::{Level, Pyramid};

/// A distinctive place of a picture with its region.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Position, picture pixels.
    pub position: Vector2<f64>,
    /// Maps the unit circle to the region's one-sigma ellipse, picture pixels: for a blob, the best
    /// responding Gaussian; for a corner, the window of its gradients. Its first column is the
    /// region's orientation, once assigned. Its determinant is positive.
    pub shape: Matrix2<f64>,
    /// Strength, in the detector's own unit; larger is better.
    pub response: f32,
}

impl Keypoint {
    /// Creates a round region of `scale` pixels (sigma) without orientation.
    pub fn round(position: Vector2<f64>, scale: f64, response: f32) -> Self {
        Self { position, shape: Matrix2::identity() * scale, response }
    }

    /// Returns the sigma of a circle of the region's area, picture pixels.
    pub fn scale(&self) -> f64 {
        self.shape.determinant().abs().sqrt()
    }

    /// Returns the orientation of the region, radians from x to y (clockwise in the picture).
    pub fn angle(&self) -> f64 {
        self.shape[(1, 0)].atan2(self.shape[(0, 0)])
    }

    /// Whether the region is a circle, up to rounding.
    pub fn is_round(&self) -> bool {
        let scale = self.scale();
        (self.shape.transpose() * self.shape - Matrix2::identity() * scale * scale).amax() < 1e-6 * scale * scale
    }

    /// Returns the region with its orientation set to `angle` in its own normalised frame, radians.
    pub fn rotated(&self, angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self { shape: self.shape * Matrix2::new(cos, -sin, sin, cos), ..*self }
    }
}

/// Returns the symmetric square root of a positive definite matrix (by Cayley-Hamilton): for a
/// region's covariance, its shape without orientation.
pub fn square_root(m: &Matrix2<f64>) -> Matrix2<f64> {
    let root = m.determinant().max(0.0).sqrt();
    (m + Matrix2::identity() * root) / (m.trace() + 2.0 * root).sqrt()
}

/// Descriptors of keypoints, one per keypoint.
#[derive(Debug, Clone, PartialEq)]
pub enum Descriptors {
    /// Vectors for Euclidean distance, concatenated.
    Vectors {
        /// Length of each.
        length: usize,
        /// All values.
        values: Vec<f32>,
    },
    /// Bits for Hamming distance.
    Bits(Vec<Descriptor>),
}

impl Descriptors {
    /// Returns the number of descriptors.
    pub fn len(&self) -> usize {
        match self {
            Self::Vectors { length, values } => values.len() / (*length).max(1),
            Self::Bits(bits) => bits.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Keypoints of one picture with their descriptors.
#[derive(Debug, Clone, PartialEq)]
pub struct Features {
    /// The keypoints.
    pub keypoints: Vec<Keypoint>,
    /// The descriptor of each.
    pub descriptors: Descriptors,
}

/// A picture with the derived forms that detectors and descriptors need, each computed on first
/// use, so that a detector and a descriptor of one family share them.
#[derive(Debug)]
pub struct PictureForms<'a> {
    /// The picture itself.
    pub grey: &'a GrayImage,
    /// Progress callback of the work.
    pub(super) watch: Watch<'a>,
    float: OnceCell<FloatImage>,
    scale_space: OnceCell<ScaleSpace>,
    integral: OnceCell<IntegralImage>,
    pyramid: OnceCell<Pyramid>,
}

impl<'a> PictureForms<'a> {
    /// Wraps a picture without computing anything.
    pub fn new(grey: &'a GrayImage) -> Self {
        Self::watched(grey, Watch::NONE)
    }

    /// Like [`new`](Self::new), with a callback that may stop the work.
    pub(super) fn watched(grey: &'a GrayImage, watch: Watch<'a>) -> Self {
        let (float, scale_space, integral, pyramid) = (OnceCell::new(), OnceCell::new(), OnceCell::new(), OnceCell::new());
        Self { grey, watch, float, scale_space, integral, pyramid }
    }

    /// Returns its grey levels as floats.
    pub fn float(&self) -> &FloatImage {
        self.float.get_or_init(|| FloatImage::from_grey(self.grey))
    }

    /// Returns its Gaussian scale space.
    pub fn scale_space(&self) -> &ScaleSpace {
        self.scale_space.get_or_init(|| ScaleSpace::watched(self.float(), &self.watch))
    }

    /// Returns its integral image.
    pub fn integral(&self) -> &IntegralImage {
        self.integral.get_or_init(|| IntegralImage::of(self.grey))
    }

    /// Returns the pyramid of the tracker's own corners and descriptors, largest level first.
    pub fn pyramid(&self) -> &[Level] {
        let ExtractorOptions { factor, levels, .. } = ExtractorOptions::default();
        let build = || {
            let mut pyramid = Pyramid::default();
            pyramid.build(self.grey, factor, levels, 2 * BORDER + 8);
            pyramid
        };
        self.pyramid.get_or_init(build).levels()
    }
}
