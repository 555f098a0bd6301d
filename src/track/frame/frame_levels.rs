//! A frame at a half to a sixteenth of its size, computed where it is asked for: its light, which
//! alignment compares, and exact sums of its grey levels (rounding would add noise to what
//! averaging gains).

use image::GrayImage;

pub use super::level_numbers::{FINEST, LEVELS};
use super::light_levels::LightLevel;
use crate::light::CameraCurve;
use crate::simd::multiversion;

/// The frame at levels 1 and up.
#[derive(Debug, Default)]
pub struct FrameLevels {
    /// The frame itself.
    grey: Vec<u8>,
    size: [usize; 2],
    /// The camera's curve, by which it is decoded.
    curve: CameraCurve,
    levels: [Level; LEVELS - 1],
    /// Number of levels of grey filled so far.
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
}

impl FrameLevels {
    /// Takes a new frame; buffers are kept.
    pub fn update(&mut self, image: &GrayImage) {
        self.grey.clear();
        self.grey.extend_from_slice(image.as_raw());
        self.size = [image.width() as usize, image.height() as usize];
        self.filled = 0;
    }

    /// Replaces the camera's curve between light and grey.
    pub fn set_curve(&mut self, curve: &CameraCurve) {
        self.curve.clone_from(curve);
    }

    /// Returns the camera's curve.
    pub fn curve(&self) -> &CameraCurve {
        &self.curve
    }

    /// Returns the light at level `l`, from 1.
    pub fn light(&self, l: usize) -> LightLevel<'_> {
        LightLevel::new(l, &self.grey, self.size, &self.curve)
    }

    /// Writes the frame at half its size, rounded to whole grey levels.
    pub fn half_into(&mut self, out: &mut GrayImage) {
        let half = self.level(1);
        let mut raw = std::mem::take(out).into_raw();
        raw.clear();
        raw.extend(half.sums.iter().map(|sum| ((sum + 2) >> 2) as u8));
        // There is one sum for each pixel.
        *out = GrayImage::from_raw(half.width as u32, half.height as u32, raw).unwrap_or_default();
    }

    /// Returns the sums of grey at level `l`, from 1.
    pub fn level(&mut self, l: usize) -> &Level {
        if self.filled == 0 {
            let half = &mut self.levels[0];
            resize(half, self.size[0] / 2, self.size[1] / 2);
            halve_bytes(&self.grey, self.size[0], half);
            self.filled = 1;
        }
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
    fn the_half_size_is_the_mean_of_four() {
        let image = GrayImage::from_fn(37, 21, |x, y| image::Luma([(x * 7 + y * 13) as u8]));
        let mut levels = FrameLevels::default();
        levels.update(&image);
        let mut half = GrayImage::default();
        levels.half_into(&mut half);
        assert_eq!(half, crate::features::halved(&image));
    }
}
