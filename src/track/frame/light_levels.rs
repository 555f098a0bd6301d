//! The light that a frame shows, at a half to a sixteenth of its size.
//!
//! Light is averaged, not grey: a pixel that covers black and white receives half the light of
//! white, and no camera encodes that as the mean of the two greys. It is computed only where it is
//! read: the larger the pixels of a level, the fewer of them are compared.

use nalgebra::Vector2;

use super::level_numbers::FINEST;
use crate::light::CameraCurve;
use crate::track::frame::tuning::TUNING;

/// The light of a frame at one level.
#[derive(Debug, Clone, Copy)]
pub struct LightLevel<'a> {
    /// The frame's grey levels, and its width and height.
    grey: &'a [u8],
    frame: [usize; 2],
    level: usize,
    /// Light of each grey level.
    light: &'a [f32; 256],
}

/// The light of a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Mean light, 0 to 255.
    pub light: f32,
    /// Whether it is neither saturated nor clipped to black.
    pub is_in_range: bool,
}

impl<'a> LightLevel<'a> {
    /// Creates level `level`, from 1, of a frame of `frame` pixels.
    pub fn new(level: usize, grey: &'a [u8], frame: [usize; 2], curve: &'a CameraCurve) -> Self {
        Self { grey, frame, level, light: curve.light() }
    }

    /// Returns where a pixel inside the level is read: its first pixel in the frame.
    #[inline(always)]
    pub fn place(&self, [u, v]: [usize; 2]) -> u32 {
        ((v << self.level) * self.frame[0] + (u << self.level)) as u32
    }

    /// Reads the light at each of these places.
    pub fn read(&self, places: &[u32], take: impl FnMut(usize, Seen)) {
        match self.level {
            0 | 1 => self.read_blocks::<2>(places, take),
            2 => self.read_blocks::<4>(places, take),
            3 => self.read_blocks::<8>(places, take),
            _ => self.read_blocks::<16>(places, take),
        }
    }

    #[inline(always)]
    fn read_blocks<const N: usize>(&self, places: &[u32], mut take: impl FnMut(usize, Seen)) {
        places.iter().enumerate().for_each(|(k, place)| take(k, self.block::<N>(*place as usize)));
    }

    /// Averages the light of N x N pixels of the frame; those beyond it are black.
    #[inline(always)]
    fn block<const N: usize>(&self, place: usize) -> Seen {
        let (mut light, mut sum) = (0.0, 0);
        for row in 0..N {
            let row = self.grey.get(place + row * self.frame[0]..).and_then(<[u8]>::first_chunk::<N>).unwrap_or(&[0; N]);
            for grey in row {
                light += self.light[usize::from(*grey)];
                sum += u32::from(*grey);
            }
        }
        let of_four = sum / (N * N / 4) as u32;
        let is_in_range = (TUNING.min_grey_sum..TUNING.saturated_grey_sum).contains(&of_four);
        Seen { light: light * (1.0 / (N * N) as f32), is_in_range }
    }

    /// Returns the gradient at a pixel of the finest level, across and down, by central
    /// differences, light per pixel; `None` on the border and beyond, and at other levels.
    #[inline]
    pub fn gradient(&self, [u, v]: [usize; 2]) -> Option<Vector2<f64>> {
        let [width, height] = self.frame.map(|n| n >> FINEST);
        let is_inside = u > 0 && u + 1 < width && v > 0 && v + 1 < height;
        let light = |u: usize, v: usize| f64::from(self.block::<{ 1 << FINEST }>(self.place([u, v]) as usize).light);
        (self.level == FINEST && is_inside)
            .then(|| Vector2::new(light(u + 1, v) - light(u - 1, v), light(u, v + 1) - light(u, v - 1)) * 0.5)
    }
}

#[cfg(test)]
mod tests {
    use image::GrayImage;

    use super::super::frame_levels::FrameLevels;
    use super::super::level_numbers::LEVELS;
    use super::*;
    use crate::light::Transfer;
    use crate::light::transfer::FULL;

    fn levels(curve: Transfer, image: &GrayImage) -> FrameLevels {
        let mut levels = FrameLevels::default();
        levels.set_curve(&CameraCurve::new(curve));
        levels.update(image);
        levels
    }

    fn at(level: &LightLevel, pixel: [usize; 2]) -> Seen {
        let mut found = None;
        level.read(&[level.place(pixel)], |_, seen| found = Some(seen));
        found.expect("one place")
    }

    #[test]
    fn every_level_averages_light() {
        let image = GrayImage::from_fn(37, 21, |x, y| image::Luma([(x * 7 + y * 13) as u8]));
        for curve in [Transfer::Srgb, Transfer::Linear] {
            let levels = levels(curve, &image);
            for l in 1..LEVELS {
                let (level, n) = (levels.light(l), 1u32 << l);
                for (v, u) in (0..21 / n).flat_map(|v| (0..37 / n).map(move |u| (v, u))) {
                    let light = |k: u32| FULL * curve.decoded(f32::from(image.get_pixel(u * n + k % n, v * n + k / n)[0]) / FULL);
                    let mean = (0..n * n).map(light).sum::<f32>() / (n * n) as f32;
                    assert!((at(&level, [u as usize, v as usize]).light - mean).abs() < 0.01, "{curve:?} {l}: {u} {v}");
                }
            }
        }
    }

    #[test]
    fn clipped_pixels_are_out_of_range_at_every_level() {
        let in_range = |grey: u8, l: usize| {
            let image = GrayImage::from_pixel(64, 64, image::Luma([grey]));
            at(&levels(Transfer::Srgb, &image).light(l), [1, 1]).is_in_range
        };
        for l in 1..LEVELS {
            assert_eq!([0, 1, 128, 251, 253, 255].map(|grey| in_range(grey, l)), [false, true, true, true, false, false], "{l}");
        }
    }

    #[test]
    fn gradients_are_central_differences_and_end_at_the_border() {
        let image = GrayImage::from_fn(20, 12, |x, y| image::Luma([(x * 4 + y * 6) as u8]));
        let levels = levels(Transfer::Linear, &image);
        let level = levels.light(FINEST);
        // A pixel of the level is two of the frame.
        for place in [[1, 1], [8, 1], [1, 3], [8, 4]] {
            let gradient = level.gradient(place).expect("inside");
            assert!((gradient - Vector2::new(8.0, 12.0)).norm() < 1e-3, "{place:?}");
        }
        for place in [[0, 0], [5, 0], [9, 0], [0, 1], [9, 1], [0, 5], [9, 5], [3, 6], [10, 2], [0, 100]] {
            assert_eq!(level.gradient(place), None, "{place:?}");
        }
    }
}
