//! What is wrong with the pictures of a walk that yields no map: too dark, or smeared by motion.
//!
//! Asked only when a mapping fails, so that dark or soft walks that do map are not refused.

use image::GrayImage;

use super::super::progress::SurveyError;
use super::error::MapError;
use crate::geometry::robust_kernel::median;

/// Number of pictures that are looked at, evenly over the walk.
const PICTURES: usize = 16;
/// Share of a picture's pixels that are darker than its level.
const LEVEL_SHARE: f64 = 0.95;
/// Maximum level of a dark picture: noise and the steps of grey are a tenth of its detail. A set in
/// a fiftieth of its light has 30, in half of it 130.
const DARK_LEVEL: f64 = 40.0;
/// Distances of the differences that are compared, pixels: detail, and what it is detail of.
const NEAR_PX: usize = 1;
const FAR_PX: usize = 8;
/// Maximum ratio of near to far differences, along the axis with less, of a smeared picture. Sharp
/// ones have 0.25 to 0.4, those smeared by four pixels 0.1.
const SMEARED: f64 = 0.14;
/// Mean size of a second difference of unit noise, and the median of a diagonal difference.
const OF_NOISE: f64 = 1.954;
const MEDIAN_OF_NOISE: f64 = 0.6745;

/// What is wrong with pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PictureFault {
    /// Nineteen of twenty pixels are darker than this level.
    Dark(f64),
    /// Motion or focus smears the detail.
    Smeared,
}

/// Returns what is wrong with most of the pictures.
pub fn picture_fault<'a>(pictures: impl Iterator<Item = &'a GrayImage>) -> Option<PictureFault> {
    let all: Vec<&GrayImage> = pictures.filter(|picture| picture.width().min(picture.height()) > 4 * FAR_PX as u32).collect();
    let some = || all.iter().step_by(all.len().div_ceil(PICTURES).max(1));
    let level = median(&mut some().map(|picture| level(picture)).collect::<Vec<_>>())?;
    if level < DARK_LEVEL {
        return Some(PictureFault::Dark(level));
    }
    let sharpness = median(&mut some().map(|picture| sharpness(picture)).collect::<Vec<_>>())?;
    (sharpness < SMEARED).then_some(PictureFault::Smeared)
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
        Some(PictureFault::Dark(level)) => MapError::TooDark { level, error: Box::new(error) },
        Some(PictureFault::Smeared) => MapError::Smeared(Box::new(error)),
        None => error,
    }
}

/// Returns the grey level that nearly all pixels are below.
fn level(picture: &GrayImage) -> f64 {
    let mut counts = [0_usize; 256];
    picture.iter().for_each(|grey| counts[usize::from(*grey)] += 1);
    let most = (LEVEL_SHARE * picture.len() as f64) as usize;
    let mut below = 0;
    let level = counts.iter().position(|count| {
        below += count;
        below > most
    });
    level.unwrap_or(255) as f64
}

/// Returns the ratio of near to far differences along the axis with less, without noise.
fn sharpness(picture: &GrayImage) -> f64 {
    let noise = noise(picture);
    let along = |step: [usize; 2]| {
        let differences = |px: usize| {
            let mean = mean_second_difference(picture, step.map(|s| s * px));
            (mean * mean - (OF_NOISE * noise).powi(2)).max(0.0).sqrt()
        };
        differences(NEAR_PX) / differences(FAR_PX).max(f64::EPSILON)
    };
    along([1, 0]).min(along([0, 1]))
}

/// Returns the mean size of second differences at this step across and down.
fn mean_second_difference(picture: &GrayImage, [dx, dy]: [usize; 2]) -> f64 {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let raw = picture.as_raw();
    let (offset, mut sum, mut count) = (dy * width + dx, 0_u64, 0_u64);
    for y in (dy..height - dy).step_by(2) {
        for at in (y * width + dx..(y + 1) * width - dx).step_by(2) {
            let [before, own, after] = [raw[at - offset], raw[at], raw[at + offset]].map(i32::from);
            sum += u64::from((2 * own - before - after).unsigned_abs());
            count += 1;
        }
    }
    sum as f64 / count.max(1) as f64
}

/// Returns one sigma of the pixels' noise: what neighbours in two directions do not share.
fn noise(picture: &GrayImage) -> f64 {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let raw = picture.as_raw();
    let corners = (0..height - 1).step_by(2).flat_map(|y| (0..width - 1).step_by(2).map(move |x| y * width + x));
    let mut sizes: Vec<f64> = corners
        .map(|at| {
            let [a, b, c, d] = [at, at + 1, at + width, at + width + 1].map(|n| i32::from(raw[n]));
            0.5 * f64::from((a - b - c + d).abs())
        })
        .collect();
    median(&mut sizes).unwrap_or(0.0) / MEDIAN_OF_NOISE
}

#[cfg(test)]
mod tests {
    use image::Luma;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// A picture of bricks of random light, smeared across by some pixels, in a share of its light.
    fn picture(smear: u32, light: f64) -> GrayImage {
        let mut random = Pcg64Mcg::seed_from_u64(4);
        let brick = |x: u32, y: u32| f64::from(((x / 5) * 7919 + (y / 4) * 104_729).wrapping_mul(2_654_435_761) >> 24);
        GrayImage::from_fn(320, 240, |x, y| {
            let mean = (0..smear).map(|k| brick(x + k, y)).sum::<f64>() / f64::from(smear);
            Luma([(light * mean + random.random_range(-1.5..1.5)).clamp(0.0, 255.0).round() as u8])
        })
    }

    #[test]
    fn dark_and_smeared_walks_are_told_and_sharp_ones_pass() {
        let fault = |smear, light| picture_fault([picture(smear, light)].iter());
        assert_eq!(fault(1, 1.0), None);
        assert_eq!(fault(1, 0.4), None);
        assert!(matches!(fault(1, 0.08), Some(PictureFault::Dark(level)) if level < 30.0));
        assert_eq!(fault(24, 1.0), Some(PictureFault::Smeared));
        assert_eq!(picture_fault(std::iter::empty()), None);
    }

    #[test]
    fn only_what_a_picture_can_cause_is_explained_by_it() {
        let fault = Some(PictureFault::Smeared);
        assert!(matches!(explained(MapError::NoStart, fault), MapError::Smeared(_)));
        assert_eq!(explained(MapError::NoStart, None), MapError::NoStart);
        let narrow = MapError::TooLittleParallax { extent_m: 0.1, distance_m: 3.0 };
        assert_eq!(explained(narrow.clone(), fault), narrow);
    }
}
