//! Raises the contrast of pictures that have little: haze, dim light, a washed-out projection.
//!
//! Such a picture uses only a few of the 256 grey levels, and its corners barely exceed the noise.
//! Smoothed with fractional grey levels, and then stretched over the full range, it has corners
//! again. Binary descriptors compare pixels, so stretching changes nothing else in them.

use image::GrayImage;

use super::pyramid::{resize_buffer, smooth_with};
use crate::simd::multiversion;

/// Range of grey levels, from the darkest to the brightest hundredth of a picture, that is enough
/// contrast. Corners are searched with a contrast of 40, 20 and 6 levels; below a quarter of the
/// range only the last finds any, and that finds noise too. Raised, ordinary pictures are smoothed
/// and lose fine corners; lowered, hazy ones are not found.
const ENOUGH: u8 = 64;
/// Minimum range of grey levels; a picture with less shows nothing: means of four pixels of a black
/// frame, noise of 2 levels, are within 5. Raised, dense haze is given up; lowered, black frames
/// are searched for corners of noise.
const LEAST: u8 = 8;
/// Spacing of the sampled 2 x 2 pixel blocks, pixels. Chosen: 3,600 blocks in a 1280 x 720 frame,
/// of which 36 are a hundredth. Raised, sampling costs less and misses thin detail.
const STRIDE: usize = 16;

/// Stretches the contrast of pictures; reuses its buffers.
#[derive(Debug, Clone, Default)]
pub struct ContrastStretch {
    picture: GrayImage,
    row: Vec<u16>,
    is_stretched: bool,
}

impl ContrastStretch {
    /// Returns the picture smoothed by the 5x5 binomial filter, with its darkest hundredth black
    /// and its brightest white; `None` if its contrast is sufficient already, or absent.
    pub fn stretched(&mut self, picture: &GrayImage) -> Option<&GrayImage> {
        self.is_stretched = false;
        let [dark, bright] = range(picture)?;
        if !(LEAST..ENOUGH).contains(&(bright - dark)) {
            return None;
        }
        resize_buffer(&mut self.picture, picture.width(), picture.height());
        stretch(picture, &mut self.picture, &mut self.row, [dark, bright]);
        self.is_stretched = true;
        self.last()
    }

    /// Returns the last result of [`stretched`](Self::stretched).
    pub fn last(&self) -> Option<&GrayImage> {
        self.is_stretched.then_some(&self.picture)
    }
}

/// Returns the grey levels below and above which a hundredth of the blocks lie.
fn range(picture: &GrayImage) -> Option<[u8; 2]> {
    let width = picture.width() as usize;
    let mut levels = [0_u32; 256];
    // The middle of each square of the stride, so that no border counts more.
    const MIDDLE: usize = STRIDE / 2;
    for rows in picture.as_raw().chunks_exact(2 * width.max(1)).skip(MIDDLE / 2).step_by(STRIDE / 2) {
        let (top, bottom) = rows.split_at(width);
        for (t, b) in top.chunks(STRIDE).zip(bottom.chunks(STRIDE)) {
            if let (Some([t, t_right]), Some([b, b_right])) = (t.get(MIDDLE..MIDDLE + 2), b.get(MIDDLE..MIDDLE + 2)) {
                let sum = u16::from(*t) + u16::from(*t_right) + u16::from(*b) + u16::from(*b_right);
                levels[usize::from(sum / 4)] += 1;
            }
        }
    }
    let hundredth = levels.iter().sum::<u32>() / 100;
    let mut below = 0;
    let mut reaches = |n: &u32| {
        below += n;
        below > hundredth
    };
    let dark = levels.iter().position(&mut reaches)?;
    below = 0;
    let bright = levels.iter().rposition(|n| {
        below += n;
        below > hundredth
    })?;
    // Indices of a table of 256.
    Some([dark as u8, bright as u8])
}

multiversion! {
    fn stretch(from: &GrayImage, to: &mut GrayImage, row: &mut Vec<u16>, range: [u8; 2]); ["avx2"] => stretch_lanes, else stretch_lanes
}

/// Smooths a picture and stretches the grey levels of `range` (dark, bright) to the full range.
#[inline(always)]
fn stretch_lanes(from: &GrayImage, to: &mut GrayImage, row: &mut Vec<u16>, [dark, bright]: [u8; 2]) {
    // Filter sums are 256 times a grey level.
    let first = u16::from(dark) << 8;
    let gain = 255 * 256 / u32::from(bright.saturating_sub(dark)).max(1);
    smooth_with(from, to, row, |sum| ((u32::from(sum.saturating_sub(first)) * gain) >> 16).min(255) as u8);
}

#[cfg(test)]
mod tests {
    use super::super::test_pictures::{Painting, view};
    use super::super::{ExtractorOptions, Feature, FeatureExtractor, Workers};
    use super::*;

    /// Deterministic noise of two grey levels.
    fn noise(x: u32, y: u32) -> f64 {
        let mut h = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77);
        let mut uniform = || {
            h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
            h ^= h >> 16;
            f64::from(h) / f64::from(u32::MAX) - 0.5
        };
        // Three uniform numbers: a variance of a quarter.
        4.0 * (uniform() + uniform() + uniform())
    }

    /// The picture with this fraction of its contrast, on a veil, with noise.
    fn hazy(picture: &GrayImage, contrast: f64) -> GrayImage {
        GrayImage::from_fn(picture.width(), picture.height(), |x, y| {
            let grey = 90.0 + contrast * f64::from(picture.get_pixel(x, y)[0]) + noise(x, y);
            image::Luma([grey.round().clamp(0.0, 255.0) as u8])
        })
    }

    /// Number of features of a picture that are near similar features of the clear one.
    fn recognised(clear: &[Feature], picture: &GrayImage) -> usize {
        let mut found = Vec::new();
        FeatureExtractor::default().extract(picture, None, &ExtractorOptions::default(), &Workers::new(1), &mut found);
        let is_known =
            |f: &&Feature| clear.iter().any(|c| (c.position - f.position).norm() < 2.0 && c.descriptor.distance(&f.descriptor) < 50);
        found.iter().filter(is_known).count()
    }

    #[test]
    fn a_hazy_picture_is_recognised() {
        let picture = Painting::new().seen(&view(0.0, 0.0, 1.0));
        let mut clear = Vec::new();
        FeatureExtractor::default().extract(&picture, None, &ExtractorOptions::default(), &Workers::new(1), &mut clear);
        let hazy = hazy(&picture, 0.08);
        let mut stretch = ContrastStretch::default();
        let (plain, stretched) = (recognised(&clear, &hazy), recognised(&clear, stretch.stretched(&hazy).expect("little contrast")));
        assert!(stretched >= 30 && stretched > 3 * plain, "{stretched}, and {plain} as it is");
    }

    #[test]
    fn pictures_of_full_or_no_contrast_are_unchanged() {
        let picture = Painting::new().seen(&view(0.0, 0.0, 1.0));
        let mut stretch = ContrastStretch::default();
        assert!(stretch.stretched(&picture).is_none());
        assert!(stretch.stretched(&hazy(&picture, 0.0)).is_none());
        for size in 0..4 {
            assert!(stretch.stretched(&GrayImage::from_pixel(size, size, image::Luma([90]))).is_none());
        }
    }

    #[test]
    fn stretching_keeps_positions_and_fills_the_range() {
        let ramp = GrayImage::from_fn(320, 200, |x, _| image::Luma([(100 + x / 10) as u8]));
        let mut stretch = ContrastStretch::default();
        let stretched = stretch.stretched(&ramp).expect("32 levels");
        assert!(stretched.get_pixel(2, 100)[0] < 10 && stretched.get_pixel(317, 100)[0] > 245);
        // Halfway up the ramp it is half as bright as white.
        assert!(stretched.get_pixel(160, 100)[0].abs_diff(128) < 5, "{}", stretched.get_pixel(160, 100)[0]);
    }
}
