//! What is wrong with the pictures of a walk that yields no map: too dark, or blurred.
//!
//! It explains a failure and never causes one, so dark or soft walks that do map are not refused.

use image::GrayImage;

use super::super::progress::SurveyError;
use super::error::MapError;
use crate::track::{FrameLook, PictureFault};

/// Number of pictures that are judged, evenly over the walk. Raised, reading a walk takes longer.
const MAX_PICTURES: usize = 16;

/// Returns what is wrong with more than half of the pictures.
pub fn picture_fault<'a>(pictures: impl Iterator<Item = &'a GrayImage>) -> Option<PictureFault> {
    let all: Vec<&GrayImage> = pictures.collect();
    let some = all.iter().step_by(all.len().div_ceil(MAX_PICTURES).max(1));
    let faults: Vec<Option<PictureFault>> = some.map(|picture| FrameLook::at(&half(picture)).fault()).collect();
    let is_common = |fault: &PictureFault| 2 * faults.iter().filter(|own| **own == Some(*fault)).count() > faults.len();
    [PictureFault::TooDark, PictureFault::TooBlurred].into_iter().find(is_common)
}

/// Returns the picture at half size, at which frames are judged.
fn half(picture: &GrayImage) -> GrayImage {
    let [width, height] = [picture.width(), picture.height()].map(|side| (side / 2).max(1));
    image::imageops::thumbnail(picture, width, height)
}

/// Returns an error with the fault of the pictures that caused it, if it may have.
pub fn explained(error: MapError, fault: Option<PictureFault>) -> MapError {
    let may_be_caused = matches!(
        error,
        MapError::Survey(SurveyError::NotFound { .. } | SurveyError::TooFewPlaces { .. } | SurveyError::Undetermined)
            | MapError::TooFewPoints { .. }
            | MapError::NoStart
            | MapError::NoFacets { .. }
    );
    match fault.filter(|_| may_be_caused) {
        Some(PictureFault::TooDark) => MapError::TooDark(Box::new(error)),
        Some(PictureFault::TooBlurred) => MapError::TooBlurred(Box::new(error)),
        _ => error,
    }
}

#[cfg(test)]
mod tests {
    use image::Luma;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// A picture of bricks of random light with noise, averaged over some pixels across, in a share
    /// of its light.
    fn picture(blur_px: u32, light: f64) -> GrayImage {
        let mut random = Pcg64Mcg::seed_from_u64(4);
        let brick = |x: u32, y: u32| f64::from(((x / 9) * 7919 + (y / 6) * 104_729).wrapping_mul(2_654_435_761) >> 24);
        GrayImage::from_fn(640, 480, |x, y| {
            let mean = (0..blur_px).map(|k| brick(x + k, y)).sum::<f64>() / f64::from(blur_px);
            Luma([(light * mean + random.random_range(-1.5..1.5)).clamp(0.0, 255.0).round() as u8])
        })
    }

    #[test]
    fn dark_and_blurred_walks_are_recognised_and_sharp_ones_pass() {
        let fault = |blur_px, light| picture_fault([picture(blur_px, light)].iter());
        assert_eq!([fault(1, 1.0), fault(1, 0.4), fault(3, 1.0)], [None; 3]);
        assert_eq!(fault(1, 0.08), Some(PictureFault::TooDark));
        assert_eq!(fault(60, 1.0), Some(PictureFault::TooBlurred));
        assert_eq!(picture_fault(std::iter::empty()), None);
    }

    #[test]
    fn a_minority_of_bad_pictures_is_no_fault_of_the_walk() {
        let (sharp, dark) = (picture(1, 1.0), picture(1, 0.08));
        assert_eq!(picture_fault([&sharp, &dark, &sharp].into_iter()), None);
        assert_eq!(picture_fault([&dark, &dark, &sharp].into_iter()), Some(PictureFault::TooDark));
    }

    #[test]
    fn only_what_a_picture_can_cause_is_explained_by_it() {
        let fault = Some(PictureFault::TooBlurred);
        assert!(matches!(explained(MapError::NoStart, fault), MapError::TooBlurred(_)));
        assert_eq!(explained(MapError::NoStart, None), MapError::NoStart);
        let narrow = MapError::TooLittleParallax { extent_m: 0.1, distance_m: 3.0 };
        assert_eq!(explained(narrow.clone(), fault), narrow);
    }
}
