//! A frame at a half to a sixteenth of its size, as exact sums of its grey levels: rounding would
//! add noise to what averaging gains.

use image::GrayImage;
use nalgebra::Vector2;

use crate::simd::multiversion;

/// Number of sizes from full to a sixteenth; level 0 is the frame itself and is not stored. Raised,
/// the sums no longer fit 16 bits; lowered, fast motion is lost.
pub const LEVELS: usize = 5;
/// The level at which alignment ends: four pixels of the frame make one, with half the noise.
/// Raised, detail is lost.
pub const FINEST: usize = 1;

/// The frame at levels 1 and up.
#[derive(Debug, Default)]
pub struct FrameLevels {
    levels: [Level; LEVELS - 1],
    /// Number of levels filled so far: coarse ones are computed on demand.
    filled: usize,
}

/// Sums of 2^l x 2^l grey levels; pixel (u, v) covers the frame's pixels 2^l u … 2^l u + 2^l - 1.
#[derive(Debug, Default)]
pub struct Level {
    width: usize,
    height: usize,
    sums: Vec<u16>,
}

impl Level {
    /// Returns the sums, row by row.
    pub fn sums(&self) -> &[u16] {
        &self.sums
    }

    /// Returns the gradient at the pixel in this column and row, across and down, by central
    /// differences, in sums per pixel; `None` on the border and beyond.
    #[inline]
    pub fn gradient(&self, [u, v]: [usize; 2]) -> Option<Vector2<f64>> {
        let is_inside = u > 0 && u + 1 < self.width && v > 0 && v + 1 < self.height;
        let index = v * self.width + u;
        let sum = |index: usize| f64::from(self.sums[index]);
        is_inside.then(|| Vector2::new(sum(index + 1) - sum(index - 1), sum(index + self.width) - sum(index - self.width)) * 0.5)
    }
}

impl FrameLevels {
    /// Takes a new frame; buffers are kept.
    pub fn update(&mut self, image: &GrayImage) {
        let (w, h) = (image.width() as usize, image.height() as usize);
        let half = &mut self.levels[0];
        resize(half, w / 2, h / 2);
        halve_bytes(image.as_raw(), w, half);
        self.filled = 1;
    }

    /// Writes the frame at half its size, rounded to whole grey levels.
    pub fn half_into(&self, out: &mut GrayImage) {
        let half = &self.levels[0];
        let mut raw = std::mem::take(out).into_raw();
        raw.clear();
        raw.extend(half.sums.iter().map(|sum| ((sum + 2) >> 2) as u8));
        // There is one sum for each pixel.
        *out = GrayImage::from_raw(half.width as u32, half.height as u32, raw).unwrap_or_default();
    }

    /// Returns level `l`, from 1.
    pub fn level(&mut self, l: usize) -> &Level {
        while self.filled < l {
            let (before, after) = self.levels.split_at_mut(self.filled);
            let (fine, coarse) = (&before[self.filled - 1], &mut after[0]);
            resize(coarse, fine.width / 2, fine.height / 2);
            halve_sums(fine, coarse);
            self.filled += 1;
        }
        &self.levels[l - 1]
    }
}

fn resize(level: &mut Level, width: usize, height: usize) {
    (level.width, level.height) = (width, height);
    level.sums.resize(width * height, 0);
}

/// Sums two by two bytes. `stride`: bytes per row.
fn halve_bytes(raw: &[u8], stride: usize, out: &mut Level) {
    let w = out.width;
    for (v, row) in out.sums.chunks_exact_mut(w.max(1)).enumerate() {
        let (top, bottom) = (&raw[2 * v * stride..][..2 * w], &raw[(2 * v + 1) * stride..][..2 * w]);
        halve_rows(top, bottom, row);
    }
}

multiversion! {
    fn halve_rows(top: &[u8], bottom: &[u8], out: &mut [u16]);
    ["avx2"] => halve_rows_plain, else halve_rows_plain
}

#[inline(always)]
fn halve_rows_plain(top: &[u8], bottom: &[u8], out: &mut [u16]) {
    for ((o, t), b) in out.iter_mut().zip(top.chunks_exact(2)).zip(bottom.chunks_exact(2)) {
        // Two bytes read as one number: the compiler vectorises this.
        let (t, b) = (u16::from_le_bytes([t[0], t[1]]), u16::from_le_bytes([b[0], b[1]]));
        *o = (t & 255) + (t >> 8) + (b & 255) + (b >> 8);
    }
}

fn halve_sums(fine: &Level, out: &mut Level) {
    let w = out.width;
    for (v, row) in out.sums.chunks_exact_mut(w.max(1)).enumerate() {
        let top = &fine.sums[2 * v * fine.width..][..2 * w];
        let bottom = &fine.sums[(2 * v + 1) * fine.width..][..2 * w];
        for ((o, t), b) in row.iter_mut().zip(top.chunks_exact(2)).zip(bottom.chunks_exact(2)) {
            // 256 times the brightest grey still fits.
            *o = t[0] + t[1] + b[0] + b[1];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_exact_sums() {
        let image = GrayImage::from_fn(37, 21, |x, y| image::Luma([(x * 7 + y * 13) as u8]));
        let mut levels = FrameLevels::default();
        levels.update(&image);
        for l in 1..LEVELS {
            let level = levels.level(l);
            let n = 1u32 << l;
            assert_eq!((level.width, level.height), (37 >> l, 21 >> l));
            for v in 0..level.height as u32 {
                for u in 0..level.width as u32 {
                    let sum: u32 = (0..n * n).map(|k| u32::from(image.get_pixel(u * n + k % n, v * n + k / n)[0])).sum();
                    assert_eq!(u32::from(level.sums()[v as usize * level.width + u as usize]), sum);
                }
            }
        }
    }

    #[test]
    fn gradients_are_central_differences_and_end_at_the_border() {
        let image = GrayImage::from_fn(20, 12, |x, y| image::Luma([(x * 4 + y * 6) as u8]));
        let mut levels = FrameLevels::default();
        levels.update(&image);
        let level = levels.level(FINEST);
        // A pixel of the level is two of the frame, and sums four.
        for place in [[1, 1], [8, 1], [1, 3], [8, 4]] {
            assert_eq!(level.gradient(place), Some(Vector2::new(32.0, 48.0)), "{place:?}");
        }
        for place in [[0, 0], [5, 0], [9, 0], [0, 1], [9, 1], [0, 5], [9, 5], [3, 6], [10, 2], [0, 100]] {
            assert_eq!(level.gradient(place), None, "{place:?}");
        }
    }

    #[test]
    fn the_half_size_is_the_mean_of_four() {
        let image = GrayImage::from_fn(37, 21, |x, y| image::Luma([(x * 7 + y * 13) as u8]));
        let mut levels = FrameLevels::default();
        levels.update(&image);
        let mut half = GrayImage::default();
        levels.half_into(&mut half);
        assert_eq!(half, crate::features::halved(&image));
    }
}
