//! A picture of grey levels as `f32`, and its values between pixels.

use image::GrayImage;

use crate::simd::multiversion;

/// Grey levels, row-major; pixel centres at integers. The border values repeat outside.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FloatImage {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width` x `height` values.
    pub values: Vec<f32>,
}

impl FloatImage {
    /// Converts the grey levels 0 to 255 of a picture.
    pub fn from_grey(picture: &GrayImage) -> Self {
        let values = picture.as_raw().iter().map(|v| f32::from(*v)).collect();
        Self { width: picture.width() as usize, height: picture.height() as usize, values }
    }

    /// Returns the value of a pixel; outside, that of the nearest border pixel.
    pub fn at(&self, x: isize, y: isize) -> f32 {
        let clamp = |v: isize, n: usize| v.clamp(0, n as isize - 1) as usize;
        self.values[clamp(y, self.height) * self.width + clamp(x, self.width)]
    }

    /// Returns the bilinearly interpolated value between pixels.
    pub fn bilinear(&self, x: f32, y: f32) -> f32 {
        let (left, top) = (x.floor(), y.floor());
        let (a, b) = (x - left, y - top);
        let (i, k) = (left as isize, top as isize);
        let [p, q, r, s] = if i >= 0 && k >= 0 && i + 1 < self.width as isize && k + 1 < self.height as isize {
            let at = k as usize * self.width + i as usize;
            [self.values[at], self.values[at + 1], self.values[at + self.width], self.values[at + self.width + 1]]
        } else {
            [self.at(i, k), self.at(i + 1, k), self.at(i, k + 1), self.at(i + 1, k + 1)]
        };
        let (upper, lower) = (p + a * (q - p), r + a * (s - r));
        upper + b * (lower - upper)
    }

    /// Samples a straight line bilinearly, from `start` in steps of `step` (column and row,
    /// pixels).
    pub fn sample_line(&self, start: [f32; 2], step: [f32; 2], out: &mut [f32]) {
        if self.width > 1 && self.height > 1 {
            sample_wide(self, start, step, out);
        } else {
            let at = |i: usize, k: usize| start[k] + i as f32 * step[k];
            out.iter_mut().enumerate().for_each(|(i, value)| *value = self.bilinear(at(i, 0), at(i, 1)));
        }
    }
}

/// Number of pixels computed in registers at once: four AVX2 registers. Raised, they no longer fit
/// beside the operands.
pub(super) const BLOCK: usize = 32;

multiversion! {
    /// Like [`FloatImage::sample_line`], for a picture of at least two columns and rows.
    fn sample_wide(image: &FloatImage, start: [f32; 2], step: [f32; 2], out: &mut [f32]);
    ["avx2"] => sample_wide_plain, else sample_wide_plain
}

#[inline(always)]
fn sample_wide_plain(image: &FloatImage, start: [f32; 2], step: [f32; 2], out: &mut [f32]) {
    let width = image.width;
    // Outside, the border values repeat: clamp to the nearest place inside.
    let ends = [width, image.height].map(|side| side as f32 - 1.0);
    let lasts = [width, image.height].map(|side| side as i32 - 2);
    for (k, out) in out.chunks_mut(BLOCK).enumerate() {
        // In three loops, of which only the middle one, which reads the pixels, is not vectorised.
        let (mut places, mut shares, mut pixels) = ([0u32; BLOCK], [[0.0f32; BLOCK]; 2], [[0.0f32; BLOCK]; 4]);
        for i in 0..BLOCK {
            let along = (k * BLOCK + i) as f32;
            let (x, y) = (start[0] + along * step[0], start[1] + along * step[1]);
            let (x, y) = (x.max(0.0).min(ends[0]), y.max(0.0).min(ends[1]));
            // For non-negative numbers truncation is the floor. Signed integers convert in one
            // instruction.
            let (column, row) = ((x as i32).min(lasts[0]), (y as i32).min(lasts[1]));
            (shares[0][i], shares[1][i]) = (x - column as f32, y - row as f32);
            places[i] = row as u32 * width as u32 + column as u32;
        }
        for (i, place) in places.iter().enumerate().take(out.len()) {
            let Some(rows) = image.values.get(*place as usize..).and_then(|v| v.get(..width + 2)) else { continue };
            (pixels[0][i], pixels[1][i]) = (rows[0], rows[1]);
            (pixels[2][i], pixels[3][i]) = (rows[width], rows[width + 1]);
        }
        for (i, value) in out.iter_mut().enumerate() {
            let [a, b] = [shares[0][i], shares[1][i]];
            let [p, q, r, s] = [pixels[0][i], pixels[1][i], pixels[2][i], pixels[3][i]];
            let (upper, lower) = (p + a * (q - p), r + a * (s - r));
            *value = upper + b * (lower - upper);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interpolation_is_exact_on_a_ramp() {
        let ramp = FloatImage { width: 8, height: 6, values: (0..48).map(|k| (k % 8) as f32 + 10.0 * (k / 8) as f32).collect() };
        assert!((ramp.bilinear(2.25, 3.5) - 37.25).abs() < 1e-5);
        assert_eq!(ramp.bilinear(-5.0, 100.0), 50.0);
        // Lines inside, along the border, and outside.
        for (start, step) in [([1.2, 1.1], [0.7, 0.3]), ([6.9, 4.8], [-0.7, -0.4]), ([0.0, 0.0], [1.0, 0.7]), ([-3.0, 9.0], [2.1, -1.9])] {
            let mut line = [0.0; 8];
            ramp.sample_line(start, step, &mut line);
            for (i, value) in line.iter().enumerate() {
                assert!((value - ramp.bilinear(start[0] + i as f32 * step[0], start[1] + i as f32 * step[1])).abs() < 1e-4);
            }
        }
    }
}
