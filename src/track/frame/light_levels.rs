//! The light that a frame shows, at a half to a sixteenth of its size.
//!
//! Light is averaged, not grey: a pixel that covers black and white receives half the light of
//! white, and no camera encodes that as the mean of the two greys. At the two finest levels, light
//! is computed only where it is read, which is at a few thousand pixels. Coarser levels are needed
//! rarely, and are then computed whole.

use nalgebra::Vector2;

use super::level_numbers::LEVELS;
use crate::light::CameraCurve;
use crate::track::frame::tuning::TUNING;

/// Light in the unit of the means: they fill 16 bits.
const MEANS_PER_LIGHT: f32 = 257.0;
/// Coarsest level whose light is computed where it is read. Raised, each pixel of the next level
/// costs four times as many reads; lowered, more frames are converted whole.
const COARSEST_READ: usize = 2;

/// The light of one frame.
#[derive(Debug, Default)]
pub struct LightLevels {
    curve: CameraCurve,
    /// Levels 1 and up.
    means: [Means; LEVELS - 1],
    /// Number of these that are computed.
    filled: usize,
}

/// Mean light over 2^l x 2^l pixels.
#[derive(Debug, Default)]
struct Means {
    size: [usize; 2],
    light: Vec<u16>,
}

/// The light at one level.
#[derive(Debug, Clone, Copy)]
pub struct LightLevel<'a> {
    size: [usize; 2],
    source: Source<'a>,
    /// Light of each grey level.
    light: &'a [f32; 256],
}

#[derive(Debug, Clone, Copy)]
enum Source<'a> {
    /// The frame itself, its width, and the level.
    Grey(&'a [u8], usize, usize),
    /// Means of the level.
    Means(&'a [u16]),
}

/// The light of a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Mean light, 0 to 255.
    pub light: f32,
    /// Whether it is neither saturated nor clipped to black.
    pub is_in_range: bool,
}

impl LightLevels {
    /// Makes room for the levels that are computed whole, of frames of `size` pixels.
    pub fn make_room(&mut self, size: [usize; 2]) {
        for (means, l) in self.means.iter_mut().zip(1..) {
            means.light.clear();
            means.light.reserve((size[0] >> l) * (size[1] >> l));
        }
    }

    /// Begins a new frame; buffers are kept.
    pub fn clear(&mut self) {
        self.filled = 0;
    }

    /// Replaces the camera's curve.
    pub fn set_curve(&mut self, curve: &CameraCurve) {
        self.curve.clone_from(curve);
        self.filled = 0;
    }

    /// Returns the camera's curve.
    pub fn curve(&self) -> &CameraCurve {
        &self.curve
    }

    /// Returns level `l`, from 1, of a frame of `size` pixels.
    pub fn level<'a>(&'a mut self, l: usize, grey: &'a [u8], size: [usize; 2]) -> LightLevel<'a> {
        let source = if l <= COARSEST_READ {
            Source::Grey(grey, size[0], l)
        } else {
            self.fill(l, grey, size);
            Source::Means(&self.means[l - 1].light)
        };
        LightLevel { size: size.map(|n| n >> l), source, light: self.curve.light() }
    }

    fn fill(&mut self, l: usize, grey: &[u8], size: [usize; 2]) {
        let Self { curve, means, filled } = self;
        if *filled == 0 {
            let unit: [u16; 256] = curve.light().map(|light| (light * MEANS_PER_LIGHT + 0.5) as u16);
            let half = &mut means[0];
            half.resize(size.map(|n| n / 2));
            half.average(grey, size[0], |grey| u32::from(unit[usize::from(*grey)]));
            *filled = 1;
        }
        while *filled < l {
            let (before, after) = means.split_at_mut(*filled);
            let (fine, coarse) = (&before[*filled - 1], &mut after[0]);
            coarse.resize(fine.size.map(|n| n / 2));
            coarse.average(&fine.light, fine.size[0], |light| u32::from(*light));
            *filled += 1;
        }
    }
}

impl Means {
    fn resize(&mut self, size: [usize; 2]) {
        self.size = size;
        self.light.resize(size[0] * size[1], 0);
    }

    /// Takes the means of 2 by 2 pixels. `stride`: pixels per row.
    fn average<T>(&mut self, fine: &[T], stride: usize, light: impl Fn(&T) -> u32) {
        let w = self.size[0];
        for (v, row) in self.light.chunks_exact_mut(w.max(1)).enumerate() {
            let (top, bottom) = (&fine[2 * v * stride..][..2 * w], &fine[(2 * v + 1) * stride..][..2 * w]);
            for ((o, t), b) in row.iter_mut().zip(top.as_chunks::<2>().0).zip(bottom.as_chunks::<2>().0) {
                *o = ((light(&t[0]) + light(&t[1]) + light(&b[0]) + light(&b[1]) + 2) >> 2) as u16;
            }
        }
    }
}

impl LightLevel<'_> {
    /// Returns where a pixel inside the level is read.
    #[inline(always)]
    pub fn place(&self, [u, v]: [usize; 2]) -> u32 {
        let place = match self.source {
            Source::Grey(_, stride, l) => (v << l) * stride + (u << l),
            Source::Means(_) => v * self.size[0] + u,
        };
        place as u32
    }

    /// Reads the light at each of these places.
    pub fn read(&self, places: &[u32], mut take: impl FnMut(usize, Seen)) {
        // One loop for each source, so that its kind is not asked at each pixel.
        match self.source {
            Source::Grey(grey, stride, 1) => {
                places.iter().enumerate().for_each(|(k, place)| take(k, self.block::<2>(grey, stride, *place as usize)));
            }
            Source::Grey(grey, stride, _) => {
                places.iter().enumerate().for_each(|(k, place)| take(k, self.block::<4>(grey, stride, *place as usize)));
            }
            Source::Means(means) => places.iter().enumerate().for_each(|(k, place)| take(k, self.mean(means[*place as usize]))),
        }
    }

    /// Averages the light of N x N pixels of the frame; those beyond it are black.
    #[inline(always)]
    fn block<const N: usize>(&self, grey: &[u8], stride: usize, place: usize) -> Seen {
        let (mut light, mut sum) = (0.0, 0);
        for row in 0..N {
            let row = grey.get(place + row * stride..).and_then(<[u8]>::first_chunk::<N>).unwrap_or(&[0; N]);
            for grey in row {
                light += self.light[usize::from(*grey)];
                sum += u32::from(*grey);
            }
        }
        let of_four = sum / (N * N / 4) as u32;
        let is_in_range = (TUNING.min_grey_sum..TUNING.saturated_grey_sum).contains(&of_four);
        Seen { light: light * (1.0 / (N * N) as f32), is_in_range }
    }

    fn mean(&self, mean: u16) -> Seen {
        let light = f32::from(mean) * (1.0 / MEANS_PER_LIGHT);
        let [black, saturated] = [TUNING.min_grey_sum, TUNING.saturated_grey_sum].map(|sum| self.light_of_mean(0.25 * sum as f32));
        Seen { light, is_in_range: (black..saturated).contains(&light) }
    }

    /// Returns the light of a mean grey.
    fn light_of_mean(&self, grey: f32) -> f32 {
        let below = grey as usize;
        let [low, high] = [below, (below + 1).min(255)].map(|grey| self.light[grey]);
        low + (high - low) * grey.fract()
    }

    /// Returns the gradient at a pixel of the finest level, across and down, by central
    /// differences, light per pixel; `None` on the border and beyond, and at other levels.
    #[inline]
    pub fn gradient(&self, [u, v]: [usize; 2]) -> Option<Vector2<f64>> {
        let Source::Grey(grey, stride, 1) = self.source else { return None };
        let is_inside = u > 0 && u + 1 < self.size[0] && v > 0 && v + 1 < self.size[1];
        let light = |u: usize, v: usize| f64::from(self.block::<2>(grey, stride, 2 * v * stride + 2 * u).light);
        is_inside.then(|| Vector2::new(light(u + 1, v) - light(u - 1, v), light(u, v + 1) - light(u, v - 1)) * 0.5)
    }
}

#[cfg(test)]
mod tests {
    use image::GrayImage;

    use super::super::frame_levels::{FINEST, FrameLevels};
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
            let mut levels = levels(curve, &image);
            // Coarse levels first: one level must not depend on which others were asked for.
            for l in (1..LEVELS).rev() {
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
        let mut levels = levels(Transfer::Linear, &image);
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
