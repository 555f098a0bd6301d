//! A lens that nobody has calibrated: from its field of view, or from the focal length that phones tell.
//!
//! Good enough for a first look, and no more: its doubt goes into every covariance.

use super::doubt::{IntrinsicsUncertainty, LensDoubt};
use super::model::{CameraError, CameraModel};

/// What is known of a lens instead of a calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum LensGuess {
    /// The angle across the picture's width, degrees.
    FieldOfView(f64),
    /// The focal length in millimetres that has the same angle across the diagonal of 36 x 24 mm film.
    FilmFocalLength(f64),
}

/// One sigma of a focal length that follows from a field of view: makers round it, and some mean the diagonal of another format.
/// Chosen, not measured. Raised, covariances of a guessed lens grow; lowered, they promise more than is known.
const FIELD_OF_VIEW_SHARE: f64 = 0.03;
/// The same of one that follows from a phone's, and more: films are cropped from its pictures, and steadied ones once more.
const FILM_SHARE: f64 = 0.05;
/// One sigma of the principal point, as a share of the picture's width: what webcams and phones
/// are found off by. Raised, covariances of a guessed lens grow.
const CENTRE_SHARE: f64 = 0.02;
/// One sigma of k1, k2, p1 and p2: what webcams are found to have, as nothing is known of this one. A number that is left out would
/// count as known to be 0, and the pose would seem too sure. Raised, covariances of a guessed lens grow.
const DISTORTION: [f64; 4] = [0.1, 0.1, 0.003, 0.003];
/// Half the diagonal of 36 x 24 mm film, millimetres: sqrt(18² + 12²).
const FILM_HALF_DIAGONAL_MM: f64 = 21.633_307_652_783_937;

impl LensGuess {
    /// The focal length in pixels of pictures of a size.
    pub fn focal_px(self, width: u32, height: u32) -> f64 {
        let (width, height) = (f64::from(width), f64::from(height));
        match self {
            Self::FieldOfView(degrees) => 0.5 * width / (0.5 * degrees.to_radians()).tan(),
            Self::FilmFocalLength(mm) => mm * 0.5 * width.hypot(height) / FILM_HALF_DIAGONAL_MM,
        }
    }

    /// One sigma of the focal length, as a share of it: so uncertain are all distances.
    pub fn focal_share(self) -> f64 {
        match self {
            Self::FieldOfView(_) => FIELD_OF_VIEW_SHARE,
            Self::FilmFocalLength(_) => FILM_SHARE,
        }
    }

    /// The camera of pictures of a size: square pixels, the centre in the middle, no distortion, and the doubt about all that.
    ///
    /// # Errors
    /// As [`CameraModel::new`].
    pub fn camera(self, width: u32, height: u32) -> Result<CameraModel, CameraError> {
        let (focal, centre) = (self.focal_px(width, height), 3.0 * CENTRE_SHARE * f64::from(width));
        let (cx, cy) = ((f64::from(width) - 1.0) / 2.0, (f64::from(height) - 1.0) / 2.0);
        let off = 3.0 * self.focal_share() * focal;
        let [k1, k2, p1, p2] = DISTORTION.map(|sigma| 3.0 * sigma);
        let distortion = [k1, k2, p1, p2, 0.0];
        let uncertainty = IntrinsicsUncertainty { focal_px: [off; 2], centre_px: [centre; 2], skew: 0.0, distortion };
        Ok(CameraModel::pinhole(width, height, focal, focal, cx, cy)?.with_doubt(Some(LensDoubt {
            uncertainty,
            has_square_pixels: true,
            is_assumed: false,
        })))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Pixel;

    #[test]
    fn the_angle_is_that_between_the_pictures_outer_edges() {
        let camera = LensGuess::FieldOfView(60.0).camera(1280, 720).unwrap();
        let ray = |u: f64| camera.unproject(Pixel([u, 359.5].into())).unwrap().0.x.atan().to_degrees();
        assert!((ray(1279.5) - 30.0).abs() < 1e-12 && (ray(-0.5) + 30.0).abs() < 1e-12);
        let i = camera.intrinsics();
        assert_eq!((i.fx, i.cx, i.cy), (i.fy, 639.5, 359.5));
    }

    #[test]
    fn a_phones_26_mm_is_what_its_pictures_show() {
        // 79.5 degrees across the diagonal, as makers tell it.
        let camera = LensGuess::FilmFocalLength(26.0).camera(4032, 3024).unwrap();
        let f = camera.intrinsics().fx;
        let diagonal = 2.0 * (0.5 * f64::from(4032).hypot(3024.0) / f).atan().to_degrees();
        assert!((diagonal - 79.5).abs() < 0.1, "{diagonal}");
    }
}
