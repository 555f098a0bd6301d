//! A lens without calibration: from its field of view, or from the film-equivalent focal length
//! that phones state.
//!
//! Good enough for a first try only: its uncertainty enters every covariance.

use super::doubt::{IntrinsicsUncertainty, LensDoubt};
use super::model::{CameraError, CameraModel};

/// What is known of a lens instead of a calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum LensGuess {
    /// The horizontal field of view, degrees.
    FieldOfView(f64),
    /// The 35 mm film equivalent focal length, millimetres: the same angle across the diagonal of
    /// 36 x 24 mm film.
    FilmFocalLength(f64),
}

/// One sigma of a focal length derived from a field of view, as a fraction: makers round it, and
/// some mean the diagonal or another format. Chosen, not measured. Raised, covariances of a guessed
/// lens grow; lowered, they are overconfident.
const FIELD_OF_VIEW_SHARE: f64 = 0.03;
/// The same for a phone's film equivalent; larger, because video is cropped from its pictures, and
/// stabilised video once more.
const FILM_SHARE: f64 = 0.05;
/// One sigma of the principal point, as a fraction of the picture's width: typical of webcams and
/// phones. Raised, covariances of a guessed lens grow.
const CENTRE_SHARE: f64 = 0.02;
/// One sigma of k1, k2, p1 and p2: typical values of webcams, since nothing is known of this one. A
/// parameter left out would count as known to be 0, and the pose would be overconfident. Raised,
/// covariances of a guessed lens grow.
const DISTORTION: [f64; 4] = [0.1, 0.1, 0.003, 0.003];
/// Half the diagonal of 36 x 24 mm film, millimetres: sqrt(18² + 12²).
const FILM_HALF_DIAGONAL_MM: f64 = 21.633_307_652_783_937;

impl LensGuess {
    /// Returns the focal length in pixels for a picture size.
    pub fn focal_px(self, width: u32, height: u32) -> f64 {
        let (width, height) = (f64::from(width), f64::from(height));
        match self {
            Self::FieldOfView(degrees) => 0.5 * width / (0.5 * degrees.to_radians()).tan(),
            Self::FilmFocalLength(mm) => mm * 0.5 * width.hypot(height) / FILM_HALF_DIAGONAL_MM,
        }
    }

    /// Returns one sigma of the focal length, as a fraction of it. All distances are uncertain by
    /// the same fraction.
    pub fn focal_share(self) -> f64 {
        match self {
            Self::FieldOfView(_) => FIELD_OF_VIEW_SHARE,
            Self::FilmFocalLength(_) => FILM_SHARE,
        }
    }

    /// Builds the camera for a picture size: square pixels, centred principal point, no distortion,
    /// and the matching doubt.
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
        Ok(CameraModel::pinhole(width, height, focal, focal, cx, cy)?.with_doubt(Some(LensDoubt { uncertainty, has_square_pixels: true })))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Pixel;

    #[test]
    fn the_field_of_view_spans_the_pictures_outer_edges() {
        let camera = LensGuess::FieldOfView(60.0).camera(1280, 720).unwrap();
        let ray = |u: f64| camera.unproject(Pixel([u, 359.5].into())).unwrap().0.x.atan().to_degrees();
        assert!((ray(1279.5) - 30.0).abs() < 1e-12 && (ray(-0.5) + 30.0).abs() < 1e-12);
        let i = camera.intrinsics();
        assert_eq!((i.fx, i.cx, i.cy), (i.fy, 639.5, 359.5));
    }

    #[test]
    fn a_phones_26_mm_is_what_its_pictures_show() {
        // 79.5 degrees across the diagonal, as makers state it.
        let camera = LensGuess::FilmFocalLength(26.0).camera(4032, 3024).unwrap();
        let f = camera.intrinsics().fx;
        let diagonal = 2.0 * (0.5 * f64::from(4032).hypot(3024.0) / f).atan().to_degrees();
        assert!((diagonal - 79.5).abs() < 0.1, "{diagonal}");
    }
}
