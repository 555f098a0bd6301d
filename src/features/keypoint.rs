//! What every detector gives and every descriptor takes: keypoints of a picture, and the picture in the forms that they ask for.

use std::cell::OnceCell;

use image::GrayImage;
use nalgebra::{Matrix2, Vector2};

use super::extractor::ExtractorOptions;
use super::float_image::FloatImage;
use super::pyramid::{Level, Pyramid};
use super::watch::Watch;
use super::{Descriptor, extractor::BORDER, integral_image::IntegralImage, scale_space::ScaleSpace};

/// A distinctive place of a picture with the region that belongs to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Picture pixels.
    pub position: Vector2<f64>,
    /// Maps the unit circle to the region's ellipse of one sigma, picture pixels: of a blob, the Gaussian that answers to it best; of a corner,
    /// the window that its gradients are gathered in. Its first column is the region's direction, once one was assigned. Its determinant is
    /// positive.
    pub shape: Matrix2<f64>,
    /// How distinctive it is, in the detector's own unit; larger is better.
    pub response: f32,
}

impl Keypoint {
    /// A round region of `scale` pixels (sigma) that has no direction yet.
    pub fn round(position: Vector2<f64>, scale: f64, response: f32) -> Self {
        Self { position, shape: Matrix2::identity() * scale, response }
    }

    /// Radius of the circle of the region's area, sigma, picture pixels.
    pub fn scale(&self) -> f64 {
        self.shape.determinant().abs().sqrt()
    }

    /// Direction of the region, radians from x to y (clockwise in the picture).
    pub fn angle(&self) -> f64 {
        self.shape[(1, 0)].atan2(self.shape[(0, 0)])
    }

    /// Whether the region is a circle, up to rounding.
    pub fn is_round(&self) -> bool {
        let scale = self.scale();
        (self.shape.transpose() * self.shape - Matrix2::identity() * scale * scale).amax() < 1e-6 * scale * scale
    }

    /// The same region with its direction turned to `angle` of its own normalised frame, radians.
    pub fn turned(&self, angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self { shape: self.shape * Matrix2::new(cos, -sin, sin, cos), ..*self }
    }
}

/// The symmetric square root of a positive definite matrix (by Cayley & Hamilton): of a region's covariance, its shape without a direction.
pub fn square_root(m: &Matrix2<f64>) -> Matrix2<f64> {
    let root = m.determinant().max(0.0).sqrt();
    (m + Matrix2::identity() * root) / (m.trace() + 2.0 * root).sqrt()
}

/// Descriptions of keypoints, one a keypoint.
#[derive(Debug, Clone, PartialEq)]
pub enum Descriptors {
    /// Vectors to be compared by their Euclidean distance, one after the other.
    Vectors {
        /// Numbers of each.
        length: usize,
        /// All of them.
        values: Vec<f32>,
    },
    /// Bits to be compared by their Hamming distance.
    Bits(Vec<Descriptor>),
}

impl Descriptors {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Self::Vectors { length, values } => values.len() / (*length).max(1),
            Self::Bits(bits) => bits.len(),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Keypoints with their descriptions, of one picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Features {
    /// Where.
    pub keypoints: Vec<Keypoint>,
    /// What surrounds each.
    pub descriptors: Descriptors,
}

/// A picture in the forms that detectors and descriptors ask for, each made when it is first asked for: a detector and a descriptor of one family
/// share theirs.
#[derive(Debug)]
pub struct PictureForms<'a> {
    /// The picture itself.
    pub grey: &'a GrayImage,
    /// Who hears of the work with it.
    pub(super) watch: Watch<'a>,
    float: OnceCell<FloatImage>,
    scale_space: OnceCell<ScaleSpace>,
    integral: OnceCell<IntegralImage>,
    pyramid: OnceCell<Pyramid>,
}

impl<'a> PictureForms<'a> {
    /// Nothing is made yet.
    pub fn new(grey: &'a GrayImage) -> Self {
        Self::watched(grey, Watch::NONE)
    }

    /// The same; whoever works with it asks whether to go on.
    pub(super) fn watched(grey: &'a GrayImage, watch: Watch<'a>) -> Self {
        let (float, scale_space, integral, pyramid) = (OnceCell::new(), OnceCell::new(), OnceCell::new(), OnceCell::new());
        Self { grey, watch, float, scale_space, integral, pyramid }
    }

    /// Its grey levels as numbers.
    pub fn float(&self) -> &FloatImage {
        self.float.get_or_init(|| FloatImage::from_grey(self.grey))
    }

    /// Its Gaussian scale space.
    pub fn scale_space(&self) -> &ScaleSpace {
        self.scale_space.get_or_init(|| ScaleSpace::watched(self.float(), &self.watch))
    }

    /// Its integral image.
    pub fn integral(&self) -> &IntegralImage {
        self.integral.get_or_init(|| IntegralImage::of(self.grey))
    }

    /// The pyramid of the tracker's own corners and descriptors, largest level first.
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
