//! A picture as a tilted camera would see it: compressed along one direction, smoothed before that.
//! The simulated views of ASIFT (Yu & Morel, ASIFT: An Algorithm for Fully Affine Invariant
//! Comparison, IPOL 2011).

use image::GrayImage;
use nalgebra::{Matrix2, Vector2};

use super::float_image::FloatImage;
use crate::simd::multiversion;

/// Anti-aliasing blur along the compressed direction, pixels per pixel lost (IPOL 2011, section
/// 2.2). Raised, detail is lost.
const ANTI_ALIASING: f64 = 0.8;
/// Radius of that blur, sigmas; 3e-4 of it is left there. Raised, it takes longer.
const BLUR_REACH: f64 = 3.6;
/// A simulated camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Compression along one direction.
    pub tilt: f64,
    /// Angle of that direction, radians from x to y.
    pub longitude: f64,
}

/// The picture as a view sees it.
pub struct SimulatedPicture {
    /// The simulated pixels.
    pub pixels: GrayImage,
    /// Maps the view's pixels to the picture's.
    pub inverse: Matrix2<f64>,
    /// Picture pixel at the view's pixel 0.
    origin: Vector2<f64>,
    /// Width and height of the picture.
    size: Vector2<f64>,
}

impl SimulatedPicture {
    /// Simulates a view; `None` if it would have no pixels.
    pub fn of(picture: &FloatImage, view: View) -> Option<Self> {
        let size = Vector2::new(picture.width as f64, picture.height as f64);
        let (sin, cos) = view.longitude.sin_cos();
        // The rotated picture's box: x along the compressed direction.
        let extent = Vector2::new(size.x * cos.abs() + size.y * sin.abs(), size.x * sin.abs() + size.y * cos.abs());
        let (width, height) = ((extent.x / view.tilt).floor() as u32, extent.y.floor() as u32);
        if size.min() < 1.0 || width == 0 || height == 0 {
            return None;
        }
        let inverse = Matrix2::new(view.tilt * cos, -sin, view.tilt * sin, cos);
        let middle = Vector2::new(f64::from(width - 1), f64::from(height - 1)) / 2.0;
        let origin = (size - Vector2::repeat(1.0)) / 2.0 - inverse * middle;
        let taps = Taps::of(view.tilt, width as usize);
        let mut row = vec![0.0; taps.length];
        let mut pixels = GrayImage::new(width, height);
        for (y, compressed) in pixels.chunks_exact_mut(width as usize).enumerate() {
            // Along a row of the rotated picture, whose rows run along the compressed direction.
            let start = origin + Vector2::new(-sin, cos) * y as f64 - Vector2::new(cos, sin) * taps.margin as f64;
            picture.sample_line([start.x as f32, start.y as f32], [cos as f32, sin as f32], &mut row);
            compress(&row, &taps, compressed);
        }
        Some(Self { pixels, inverse, origin, size })
    }

    /// Converts a position in the view to the picture.
    pub fn place_in_picture(&self, place: Vector2<f64>) -> Vector2<f64> {
        self.origin + self.inverse * place
    }

    /// Whether a disc of the view is inside the picture.
    pub fn holds_disc(&self, middle: Vector2<f64>, radius: f64) -> bool {
        self.holds_ellipse(middle, &(Matrix2::identity() * radius))
    }

    /// Whether an ellipse of the view, the unit circle mapped by `shape`, is inside the picture.
    pub fn holds_ellipse(&self, middle: Vector2<f64>, shape: &Matrix2<f64>) -> bool {
        let place = self.place_in_picture(middle);
        let shape = self.inverse * shape;
        // Half the bounding box of an ellipse: the lengths of its matrix' rows.
        (0..2).all(|k| {
            let reach = shape.row(k).norm();
            place[k] >= reach && place[k] <= self.size[k] - 1.0 - reach
        })
    }
}

/// Kernels that smooth and compress a row at once: the Gaussian is centred on each new pixel's
/// exact position, so nothing is interpolated.
struct Taps {
    /// Pixels of a row before the position of the first new pixel.
    margin: usize,
    /// Number of pixels of a row that are read.
    length: usize,
    /// First input pixel of each new one.
    first: Vec<usize>,
    /// Weights of the input pixels of each, concatenated.
    weights: Vec<f32>,
    /// Number of weights of each.
    count: usize,
}

impl Taps {
    fn of(tilt: f64, width: usize) -> Self {
        let sigma = ANTI_ALIASING * (tilt * tilt - 1.0).sqrt();
        // Taps beyond the reach add next to nothing, but fill the lanes.
        let margin = ((BLUR_REACH * sigma).ceil() as usize + 1).next_multiple_of(LANES / 2);
        let count = 2 * margin;
        let (mut first, mut weights) = (Vec::with_capacity(width), Vec::with_capacity(width * count));
        for x in 0..width {
            let place = x as f64 * tilt + margin as f64;
            let start = place as usize + 1 - margin;
            let weight = |k: usize| (-0.5 * (((start + k) as f64 - place) / sigma).powi(2)).exp();
            let sum: f64 = (0..count).map(weight).sum();
            weights.extend((0..count).map(|k| (weight(k) / sum) as f32));
            first.push(start);
        }
        let length = first.last().map_or(0, |last| last + count);
        Self { margin, length, first, weights, count }
    }
}

multiversion! {
    fn compress(row: &[f32], taps: &Taps, out: &mut [u8]); ["avx2"] => compress_plain, else compress_plain
}

/// Number of taps added side by side. Each lane has its own sum, so wide and narrow registers give
/// the same result.
const LANES: usize = 8;

#[inline(always)]
fn compress_plain(row: &[f32], taps: &Taps, out: &mut [u8]) {
    for ((out, first), weights) in out.iter_mut().zip(&taps.first).zip(taps.weights.chunks_exact(taps.count)) {
        let mut sums = [0.0f32; LANES];
        for (values, weights) in row[*first..][..taps.count].chunks_exact(LANES).zip(weights.chunks_exact(LANES)) {
            for (sum, (value, weight)) in sums.iter_mut().zip(values.iter().zip(weights)) {
                *sum += value * weight;
            }
        }
        // Weights that add up to 1 keep values between 0 and 255.
        *out = (sums.iter().sum::<f32>() + 0.5) as u8;
    }
}
