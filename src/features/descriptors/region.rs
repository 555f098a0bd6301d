//! The pixels around a keypoint, smoothed to its scale: of a round region a copy of the scale space itself, of an ellipse a patch of the picture
//! in which the ellipse is a circle (Mikolajczyk & Schmid, Scale & Affine Invariant Interest Point Detectors, IJCV 2004, section 4.1).

use nalgebra::{Matrix2, Vector2};

use crate::features::FloatImage;
use crate::features::keypoint::{Keypoint, PictureForms};
use crate::features::scale_space::SmoothedCopy;

/// A region as a descriptor reads it.
#[derive(Debug, Clone, Copy)]
pub struct Region<'a> {
    /// Smoothed by about `sigma`.
    pub image: &'a FloatImage,
    /// Where the keypoint lies in it.
    pub middle: Vector2<f64>,
    /// Sigma of the region in it, pixels.
    pub sigma: f64,
}

/// Sigma of an elliptic region in its patch, pixels. Raised, patches are finer and take longer; below 1.5 they lose detail.
const PATCH_SIGMA: f64 = 2.0;
/// Half the side of a patch in sigmas: what SIFT reads, five bins of three sigmas turned by 45 degrees and a pixel for the gradient.
const PATCH_REACH: f64 = 11.5;
/// Pixels at most between the picture and a patch. Only a region far larger than its picture, or a needle, needs more.
const MOST_PIXELS: f64 = 1e6;

/// Buffers for elliptic regions.
#[derive(Debug, Default)]
pub struct Patch {
    along: FloatImage,
    smoothed: FloatImage,
    row: Vec<f32>,
    patch: FloatImage,
}

impl Patch {
    /// The region of a keypoint with the keypoint in that region's frame: round ones lose the direction that they had. None of what has no
    /// pixels: regions outside of the picture, not finite or far too large, and pictures too small to be smoothed.
    pub fn region<'a>(&'a mut self, picture: &'a PictureForms, keypoint: &Keypoint) -> Option<(Region<'a>, Keypoint)> {
        let [width, height] = [picture.grey.width(), picture.grey.height()].map(f64::from);
        let [x, y] = [keypoint.position.x, keypoint.position.y];
        let inside = (0.0..=width - 1.0).contains(&x) && (0.0..=height - 1.0).contains(&y);
        if !inside || !keypoint.shape.iter().all(|v| v.is_finite()) || keypoint.shape.determinant() <= 0.0 {
            return None;
        }
        if keypoint.is_round() {
            let copy = picture.scale_space().nearest(keypoint.scale())?;
            let (middle, sigma) = (copy.octave.in_octave(keypoint.position), keypoint.scale() / copy.octave.step);
            let keypoint = Keypoint::round(keypoint.position, keypoint.scale(), keypoint.response);
            return Some((Region { image: copy.image, middle, sigma }, keypoint));
        }
        self.warp(picture, keypoint)?;
        let middle = Vector2::from_element((self.patch.width / 2) as f64);
        Some((Region { image: &self.patch, middle, sigma: PATCH_SIGMA }, *keypoint))
    }

    /// Fills the patch.
    fn warp(&mut self, picture: &PictureForms, keypoint: &Keypoint) -> Option<()> {
        let parts = keypoint.shape.svd(true, true);
        let (axes, turn) = (parts.u?, parts.v_t?);
        let sigmas = parts.singular_values;
        let copy = picture.scale_space().at_most(sigmas.min())?;
        self.cut(&copy, keypoint.position, axes, sigmas)?;
        // What the copy's own smoothing lacks along either axis.
        let missing = |k: usize| (sigmas[k].powi(2) - copy.sigma.powi(2)).max(0.0).sqrt() / copy.octave.step;
        self.along.blur_axes_into([missing(0), missing(1)], &mut self.smoothed, &mut self.row);

        let half = (PATCH_REACH * PATCH_SIGMA) as usize;
        let side = 2 * half + 1;
        self.patch = FloatImage { width: side, height: side, values: std::mem::take(&mut self.patch.values) };
        self.patch.values.clear();
        let middle = Vector2::new((self.along.width / 2) as f64, (self.along.height / 2) as f64);
        let matrix = Matrix2::from_diagonal(&(sigmas / copy.octave.step)) * turn / PATCH_SIGMA;
        for k in 0..side * side {
            let offset = Vector2::new((k % side) as f64 - half as f64, (k / side) as f64 - half as f64);
            let at = middle + matrix * offset;
            self.patch.values.push(self.smoothed.bilinear(at.x as f32, at.y as f32));
        }
        Some(())
    }

    /// The part of a copy that holds the ellipse, turned so that its axes lie along rows and columns, pixel for pixel.
    fn cut(&mut self, copy: &SmoothedCopy, position: Vector2<f64>, axes: Matrix2<f64>, sigmas: Vector2<f64>) -> Option<()> {
        let [across, down] = [0, 1].map(|k| (PATCH_REACH * sigmas[k] / copy.octave.step).ceil() + 1.0);
        if 4.0 * across * down > MOST_PIXELS {
            return None;
        }
        let (width, height) = (2 * across as usize + 1, 2 * down as usize + 1);
        let middle = copy.octave.in_octave(position);
        self.along = FloatImage { width, height, values: std::mem::take(&mut self.along.values) };
        self.along.values.clear();
        for k in 0..width * height {
            let at = middle + axes * Vector2::new((k % width) as f64 - across, (k / width) as f64 - down);
            self.along.values.push(copy.image.bilinear(at.x as f32, at.y as f32));
        }
        Some(())
    }
}
