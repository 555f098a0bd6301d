//! Affine shape adaptation: finds the ellipse around a place in whose frame the picture's gradients
//! are equally strong in all directions (Lindeberg & Gårding, Shape-Adapted Smoothing in Estimation
//! of 3-D Shape Cues from Affine Deformations of Local 2-D Brightness Structure, 1997; Baumberg,
//! Reliable Feature Matching across Widely Separated Views, CVPR 2000). Position and scale are
//! re-estimated in that frame at every step (Mikolajczyk & Schmid, Scale & Affine Invariant
//! Interest Point Detectors, IJCV 2004, section 4.2). The fixed point is covariant under any affine
//! map of the picture.

use nalgebra::{Matrix2, Vector2};

use super::affine_measure::{AffineMeasure, DERIVATIVE_SHARE};
use crate::features::float_image::FloatImage;
use crate::features::two_views::keypoint::{Keypoint, square_root};
use crate::features::two_views::scale_space::{SCALES, ScaleSpace};
use crate::features::two_views::second_moments::gradients;

/// Limits of the iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Maximum number of steps.
    pub steps: usize,
    /// Minimum ratio of the second-moment matrix' eigenvalues that counts as isotropic.
    pub isotropy: f64,
    /// Maximum ratio of the axes.
    pub elongation: f64,
}

/// Side of a patch, pixels: a sigma of 4 reaches 3.9 sigmas to either side. The place is at its
/// centre, between four pixels. A whole number of registers wide. Raised, each step takes longer.
const SIDE: usize = 32;
/// Sigma of the ellipse in its patch, pixels. Raised, the patch would have to be larger; below 3
/// its derivatives lose accuracy.
const SIGMA: f64 = 4.0;
/// Position of the place in the patch, both coordinates.
const MIDDLE: f64 = 0.5 * (SIDE - 1) as f64;
/// Maximum sample spacing in a patch, in sigmas of the sampled copy. Raised, details between
/// samples are missed.
const WIDEST_STEP: f64 = 1.0;
/// Variance added by bilinear interpolation, squared pixels of the interpolated copy: the mean of a
/// (1 - a).
const INTERPOLATION: f64 = 1.0 / 6.0;
/// Maximum distance that a place may move in a step, patch pixels; a maximum farther away belongs
/// to another structure (section 4.2 takes the nearest maximum). Raised, more places jump to other
/// structures.
const FARTHEST: f64 = 2.0 * SIGMA;
/// Movement below which the position has converged, patch pixels: a fortieth of its sigma. Lowered,
/// more steps are taken.
const STILL: f64 = 0.1;
/// Change below which the scale has converged, octaves. Lowered, more steps are taken.
const STEADY: f64 = 0.03;
/// Octaves between the scales at which a patch is examined.
const OCTAVES: f64 = 1.0 / SCALES as f64;
/// Extent of the ellipse that must be inside the picture, sigmas; a fortieth of the window's weight
/// is beyond it. Raised, more keypoints near the border are lost; lowered, their shapes are
/// distorted by the repeated border.
const INSIDE: f64 = 2.0;

/// Adapts shapes; reuses its buffers.
#[derive(Debug)]
pub struct ShapeAdaptation<'a> {
    space: &'a ScaleSpace,
    /// Width and height of the picture, pixels.
    size: [f64; 2],
    measure: AffineMeasure,
    limits: Limits,
    sampled: FloatImage,
    fine: FloatImage,
    smooth: FloatImage,
    row: Vec<f32>,
    /// Variance of the smoothing of `fine` along rows and columns, squared pixels.
    variances: [f64; 2],
}

/// Result for one patch.
struct Found {
    /// Offset from the centre, pixels.
    offset: Vector2<f64>,
    strength: f64,
    /// Octaves from the patch's scale to that of the structure.
    octaves: f64,
    /// Second-moment matrix of its gradients.
    moments: Matrix2<f64>,
}

impl<'a> ShapeAdaptation<'a> {
    /// Prepares the adaptation in the scale space of a picture of this width and height.
    pub fn new(space: &'a ScaleSpace, size: (usize, usize), measure: AffineMeasure, limits: Limits) -> Self {
        let size = [size.0 as f64, size.1 as f64];
        let empty = FloatImage::default;
        let (sampled, fine, smooth, row) = (empty(), empty(), empty(), Vec::new());
        Self { space, size, measure, limits, sampled, fine, smooth, row, variances: [0.0; 2] }
    }

    /// Adapts a round keypoint; the result's response is the strength in its ellipse's frame.
    /// `None` if the iteration does not converge, or leads to a needle or out of the picture.
    pub fn adapted(&mut self, start: Vector2<f64>, sigma: f64) -> Option<Keypoint> {
        let (mut place, mut shape) = (start, Matrix2::identity() * sigma);
        for _ in 0..self.limits.steps {
            let parts = shape.svd(true, false);
            let (axes, sigmas) = (parts.u?, parts.singular_values);
            let bounded = sigmas.max() <= self.limits.elongation * sigmas.min();
            if !bounded || !self.is_inside(place, &shape) {
                return None;
            }
            let frame = axes * Matrix2::from_diagonal(&sigmas);
            self.fill(place, axes, sigmas)?;
            let found = self.find()?;
            let eigen = found.moments.symmetric_eigenvalues();
            let isotropic = eigen.min() >= self.limits.isotropy * eigen.max() && eigen.min() > 0.0;
            place += frame * found.offset / SIGMA;
            if isotropic && found.offset.norm() <= STILL && found.octaves.abs() <= STEADY {
                let response = self.measure.contrast(found.strength);
                return Some(Keypoint { position: place, shape: square_root(&(shape * shape.transpose())), response: response as f32 });
            }
            shape = frame * isotropic_map(&found.moments)? * found.octaves.exp2();
        }
        None
    }

    /// Whether enough of the ellipse is inside the picture.
    fn is_inside(&self, place: Vector2<f64>, shape: &Matrix2<f64>) -> bool {
        (0..2).all(|k| {
            let reach = INSIDE * shape.row(k).norm();
            place[k] - reach >= 0.0 && place[k] + reach <= self.size[k] - 1.0
        })
    }

    /// Fills the patch: the picture around a place with the ellipse's axes along rows and columns
    /// and scaled to equal length, smoothed equally along both, at [`DERIVATIVE_SHARE`] of the
    /// sigma and at the sigma.
    fn fill(&mut self, place: Vector2<f64>, axes: Matrix2<f64>, sigmas: Vector2<f64>) -> Option<()> {
        let copy = self.space.at_most(DERIVATIVE_SHARE * sigmas.min())?;
        let step = copy.octave.step;
        // Samples per patch pixel along each axis.
        let dense = sigmas.map(|s| (s / SIGMA / (WIDEST_STEP * copy.sigma)).ceil().max(1.0));
        let every = [dense.x as usize, dense.y as usize];
        let [width, height] = every.map(|n| (SIDE - 1) * n + 1);
        (self.sampled.width, self.sampled.height) = (width, height);
        self.sampled.values.resize(width * height, 0.0);
        let strides = sigmas.component_div(&dense) / (SIGMA * step);
        let (across, down) = (axes.column(0) * strides.x, axes.column(1) * strides.y);
        let corner = copy.octave.in_octave(place) - (across * dense.x + down * dense.y) * MIDDLE;
        for (y, row) in self.sampled.values.chunks_exact_mut(width).enumerate() {
            let start = corner + down * y as f64;
            copy.image.sample_line([start.x, start.y].map(|v| v as f32), [across.x, across.y].map(|v| v as f32), row);
        }
        // Variance of the samples along either axis, squared patch pixels.
        let scale = sigmas.map(|s| SIGMA / s);
        let has = scale.map(|s| (copy.sigma.powi(2) + INTERPOLATION * step * step) * s * s);
        let missing = |wanted: f64, k: usize| (wanted * wanted - has[k]).max(0.0).sqrt();
        let blurs = [0, 1].map(|k| missing(DERIVATIVE_SHARE * SIGMA, k) * dense[k]);
        self.sampled.blur_and_thin_into(blurs, every, &mut self.fine, &mut self.row);
        self.variances = [0, 1].map(|k| has[k].max((DERIVATIVE_SHARE * SIGMA).powi(2)));
        self.fine.blur_and_thin_into(self.lacking(SIGMA), [1, 1], &mut self.smooth, &mut self.row);
        Some(())
    }

    /// Returns the sigmas along rows and columns that smooth `fine` to `sigma` pixels.
    fn lacking(&self, sigma: f64) -> [f64; 2] {
        self.variances.map(|v| (sigma * sigma - v).max(0.0).sqrt())
    }

    /// Finds the maximum of the measure nearest to the patch's centre, and the scale there.
    fn find(&self) -> Option<Found> {
        let map = self.measure.strength(&self.smooth, &self.fine, SIGMA);
        let (x, y) = nearest_maximum(&map)?;
        let (fit, strength) = peak(&map, x, y);
        let offset = Vector2::new(x as f64 - MIDDLE, y as f64 - MIDDLE) + fit;
        let scales = [0, 1, 2].map(|k| {
            let sigma = SIGMA * ((k as f64 - 1.0) * OCTAVES).exp2();
            self.measure.at_scale(&smoothed_about(&self.fine, x, y, self.lacking(sigma)), sigma, 1, 1)
        });
        let [before, here, after] = scales;
        let octaves = if before > here || after > here {
            if before > after { -OCTAVES } else { OCTAVES }
        } else {
            let curve = before + after - 2.0 * here;
            if curve < 0.0 { 0.5 * OCTAVES * (before - after) / curve } else { 0.0 }
        };
        let moments = self.moments(Vector2::new(x as f64, y as f64) + fit);
        Some(Found { offset, strength, octaves, moments })
    }

    /// Returns the second-moment matrix at a place of the patch.
    fn moments(&self, place: Vector2<f64>) -> Matrix2<f64> {
        let (across, down) = gradients(&self.fine);
        let weights = [place.x, place.y].map(|c| {
            let weight = |k: usize| (-0.5 * ((k as f64 - c) / SIGMA).powi(2)).exp() as f32;
            std::array::from_fn::<f32, SIDE, _>(weight)
        });
        let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
        for (y, (a, b)) in across.values.chunks_exact(SIDE).zip(down.values.chunks_exact(SIDE)).enumerate() {
            let mut sums = [0.0f32; 3];
            for ((a, b), weight) in a.iter().zip(b).zip(&weights[0]) {
                sums = [sums[0] + weight * a * a, sums[1] + weight * b * b, sums[2] + weight * a * b];
            }
            let [a, b, c] = sums.map(|s| f64::from(s * weights[1][y]));
            (xx, yy, xy) = (xx + a, yy + b, xy + c);
        }
        Matrix2::new(xx, xy, xy, yy)
    }
}

/// Returns a patch pixel and its neighbours, smoothed by these sigmas along rows and columns;
/// pixels beyond the border do not count.
fn smoothed_about(patch: &FloatImage, x: usize, y: usize, sigmas: [f64; 2]) -> FloatImage {
    let weights = |middle: usize, sigma: f64| {
        // A zero sigma leaves the pixels unchanged.
        let exponent = -0.5 / (sigma * sigma).max(1e-6);
        [0, 1, 2].map(|k| {
            let offset = |i: usize| (i + 1) as f64 - (middle + k) as f64;
            let values: [f32; SIDE] = std::array::from_fn(|i| (exponent * offset(i).powi(2)).exp() as f32);
            let sum: f32 = values.iter().sum();
            values.map(|v| v / sum)
        })
    };
    let (columns, rows) = (weights(x, sigmas[0]), weights(y, sigmas[1]));
    let mut out = FloatImage::new(3, 3);
    for (out, weights) in out.values.chunks_exact_mut(3).zip(&rows) {
        let mut sums = [0.0f32; SIDE];
        for (row, weight) in patch.values.chunks_exact(SIDE).zip(weights) {
            sums.iter_mut().zip(row).for_each(|(sum, v)| *sum += weight * v);
        }
        for (out, weights) in out.iter_mut().zip(&columns) {
            *out = sums.iter().zip(weights).map(|(a, b)| a * b).sum();
        }
    }
    out
}

/// Returns the inverse square root of a second-moment matrix, normalised to unit determinant: the
/// map from the frame in which it is a circle.
fn isotropic_map(moments: &Matrix2<f64>) -> Option<Matrix2<f64>> {
    let determinant = moments.determinant();
    // A straight edge is undetermined.
    if determinant.is_nan() || determinant <= 1e-8 * moments.trace().powi(2) {
        return None;
    }
    let m = moments / determinant.sqrt();
    Some(square_root(&Matrix2::new(m.m22, -m.m12, -m.m21, m.m11)))
}

/// Finds the maximum by steepest ascent from the centre.
fn nearest_maximum(map: &FloatImage) -> Option<(usize, usize)> {
    let value = |(x, y): (usize, usize)| map.values[y * SIDE + x];
    let better = |a: (usize, usize), b: (usize, usize)| if value(b) > value(a) { b } else { a };
    let half = SIDE / 2;
    let mut at = [(half, half - 1), (half - 1, half), (half, half)].into_iter().fold((half - 1, half - 1), better);
    loop {
        let (x, y) = at;
        let far = Vector2::new(x as f64 - MIDDLE, y as f64 - MIDDLE).norm();
        if far.is_nan() || far > FARTHEST {
            return None;
        }
        let next = (y - 1..=y + 1).flat_map(|k| (x - 1..=x + 1).map(move |i| (i, k))).fold(at, better);
        if next == at {
            return (value(at) > 0.0).then_some(at);
        }
        at = next;
    }
}

/// Returns the vertex of the quadratic through a maximum and its neighbours, relative to its pixel,
/// and the value there.
fn peak(map: &FloatImage, x: usize, y: usize) -> (Vector2<f64>, f64) {
    let at = |i: isize, k: isize| f64::from(map.values[y.wrapping_add_signed(k) * map.width + x.wrapping_add_signed(i)]);
    let here = at(0, 0);
    let slope = 0.5 * Vector2::new(at(1, 0) - at(-1, 0), at(0, 1) - at(0, -1));
    let mixed = 0.25 * (at(1, 1) + at(-1, -1) - at(1, -1) - at(-1, 1));
    let curvature = Matrix2::new(at(1, 0) + at(-1, 0) - 2.0 * here, mixed, mixed, at(0, 1) + at(0, -1) - 2.0 * here);
    // Beyond the neighbours the fit is meaningless; use the pixel itself.
    let vertex = curvature.try_inverse().map(|inverse| -(inverse * slope)).filter(|v| v.amax() <= 1.0).unwrap_or_default();
    (vertex, here + 0.5 * slope.dot(&vertex))
}
