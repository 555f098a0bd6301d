//! A pyramid of ever smaller copies of a picture.
//!
//! A level of scale `s` relates to the picture by `c_level = (c + 0.5) s - 0.5` (DESIGN section 2),
//! with one exact factor per axis because sizes are whole pixels.

use image::GrayImage;

use super::shrink::{ColumnTaps, shrink};
use crate::simd::multiversion;

/// One level: the picture at this size, and the smoothed copy that descriptors read.
#[derive(Debug, Clone, Default)]
pub struct Level {
    /// Grey levels.
    pub image: GrayImage,
    /// `image` after a 5x5 binomial filter.
    pub smooth: GrayImage,
    /// Level pixels per picture pixel, along x and y.
    pub scale: [f64; 2],
    /// Whether `image` is up to date: the largest level is copied only on demand.
    is_filled: bool,
    /// Whether `smooth` is up to date.
    is_smooth: bool,
    /// Column weights for reducing the previous level.
    columns: ColumnTaps,
}

impl Level {
    /// Converts a position on this level to the full picture.
    pub fn in_picture(&self, x: f64, y: f64) -> [f64; 2] {
        [(x + 0.5) / self.scale[0] - 0.5, (y + 0.5) / self.scale[1] - 0.5]
    }
}

/// The levels, largest first; buffers are reused between pictures.
#[derive(Debug, Clone, Default)]
pub struct Pyramid {
    levels: Vec<Level>,
    row: Vec<u16>,
}

impl Pyramid {
    /// Returns the levels built last.
    pub fn levels(&self) -> &[Level] {
        &self.levels
    }

    /// Builds at most `count` levels, each `factor` (> 1) smaller than the previous one, none with
    /// a side below `least` pixels.
    pub fn build(&mut self, picture: &GrayImage, factor: f64, count: usize, least: u32) -> &[Level] {
        self.shrink(picture, factor, count, least);
        self.smooth_from(0, picture)
    }

    /// Like [`build`](Self::build), without the smoothed copies and without a copy of the picture
    /// itself.
    pub(super) fn shrink(&mut self, picture: &GrayImage, factor: f64, count: usize, least: u32) {
        let (w, h) = picture.dimensions();
        let mut made = 0;
        while made < count {
            let s = factor.powi(-(made as i32));
            let size = ((f64::from(w) * s).round() as u32, (f64::from(h) * s).round() as u32);
            if made > 0 && (size.0 < least || size.1 < least) {
                break;
            }
            if self.levels.len() == made {
                self.levels.push(Level::default());
            }
            let (before, rest) = self.levels.split_at_mut(made);
            let level = &mut rest[0];
            resize_buffer(&mut level.image, size.0, size.1);
            match before {
                [] => {}
                [_] => shrink(picture, &mut level.image, &mut level.columns),
                [.., previous] => shrink(&previous.image, &mut level.image, &mut level.columns),
            }
            (level.is_filled, level.is_smooth) = (made > 0, false);
            level.scale = [f64::from(size.0) / f64::from(w), f64::from(size.1) / f64::from(h)];
            made += 1;
        }
        self.levels.truncate(made);
    }

    /// Computes the missing smoothed copies of the levels from `finest` on, and returns all levels.
    /// `picture`: the one that was shrunk.
    pub(super) fn smooth_from(&mut self, finest: usize, picture: &GrayImage) -> &[Level] {
        for level in self.levels.iter_mut().skip(finest).filter(|level| !level.is_smooth) {
            if !level.is_filled {
                level.image.copy_from_slice(picture);
                level.is_filled = true;
            }
            resize_buffer(&mut level.smooth, level.image.width(), level.image.height());
            smooth_into(&level.image, &mut level.smooth, &mut self.row);
            level.is_smooth = true;
        }
        &self.levels
    }
}

/// Resizes a buffer, reusing its memory if it suffices.
pub(crate) fn resize_buffer(image: &mut GrayImage, width: u32, height: u32) {
    if image.dimensions() != (width, height) {
        let mut raw = std::mem::take(image).into_raw();
        raw.resize(width as usize * height as usize, 0);
        // The buffer was just made exactly this long.
        *image = GrayImage::from_raw(width, height, raw).unwrap_or_default();
    }
}

multiversion! {
    /// Applies the 5x5 binomial filter (1 4 6 4 1)/16 along both axes; the border pixels repeat.
    pub fn smooth_into(from: &GrayImage, to: &mut GrayImage, row: &mut Vec<u16>); ["avx2"] => smooth_lanes, else smooth_lanes
}

#[inline(always)]
fn smooth_lanes(from: &GrayImage, to: &mut GrayImage, row: &mut Vec<u16>) {
    smooth_with(from, to, row, |sum| ((sum + 128) >> 8) as u8);
}

/// Like [`smooth_into`], with a conversion of the filter's sums, which are 256 times a grey level.
#[inline(always)]
pub(super) fn smooth_with(from: &GrayImage, to: &mut GrayImage, row: &mut Vec<u16>, grey: impl Fn(u16) -> u8) {
    let (w, h) = (from.width() as usize, from.height() as usize);
    if w == 0 || h == 0 {
        return;
    }
    let source = from.as_raw();
    row.clear();
    row.resize(w + 4, 0);
    for (y, out) in to.as_mut().chunks_exact_mut(w).enumerate() {
        let line = |d: isize| {
            let y = (y as isize + d).clamp(0, h as isize - 1) as usize;
            &source[y * w..][..w]
        };
        let (a, b, c, d, e) = (line(-2), line(-1), line(0), line(1), line(2));
        let middle = &mut row[2..w + 2];
        for x in 0..w {
            let wide = |v: u8| u16::from(v);
            middle[x] = wide(a[x]) + wide(e[x]) + 4 * (wide(b[x]) + wide(d[x])) + 6 * wide(c[x]);
        }
        let (first, last) = (row[2], row[w + 1]);
        (row[0], row[1], row[w + 2], row[w + 3]) = (first, first, last, last);
        // At most 256 * 255 + 128, which fits 16 bits.
        let [a, b, c, d, e] = [0, 1, 2, 3, 4].map(|k| &row[k..k + w]);
        for (x, out) in out.iter_mut().enumerate() {
            *out = grey(a[x] + e[x] + 4 * (b[x] + d[x]) + 6 * c[x]);
        }
    }
}

/// Returns means of 2x2 pixels; an odd last row or column is dropped, so that positions stay exact.
pub fn halved(image: &GrayImage) -> GrayImage {
    halved_by(image, |top, bottom, out| {
        for ((out, t), b) in out.iter_mut().zip(top.chunks_exact(2)).zip(bottom.chunks_exact(2)) {
            *out = ((u16::from(t[0]) + u16::from(t[1]) + u16::from(b[0]) + u16::from(b[1]) + 2) >> 2) as u8;
        }
    })
}

/// Halves a picture likewise; `average` computes a row of it from two rows of the picture.
pub fn halved_by(image: &GrayImage, average: impl Fn(&[u8], &[u8], &mut [u8])) -> GrayImage {
    let mut half = GrayImage::new(image.width() / 2, image.height() / 2);
    let (w, stride) = (half.width() as usize, image.width() as usize);
    for (out, rows) in half.chunks_exact_mut(w.max(1)).zip(image.as_raw().chunks_exact(2 * stride.max(1))) {
        let (top, bottom) = rows.split_at(stride);
        average(top, bottom, out);
    }
    half
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(w: u32, h: u32) -> GrayImage {
        GrayImage::from_fn(w, h, |x, y| image::Luma([(0.15 * f64::from(x) + 0.1 * f64::from(y) + 10.0) as u8]))
    }

    #[test]
    fn levels_shrink_and_positions_map_back() {
        let mut pyramid = Pyramid::default();
        let picture = ramp(640, 360);
        let levels = pyramid.build(&picture, 1.2, 8, 40);
        assert_eq!(levels.len(), 8);
        for level in levels {
            let [x, y] = level.in_picture(f64::from(level.image.width()) / 2.0 - 0.5, f64::from(level.image.height()) / 2.0 - 0.5);
            assert!((x - 319.5).abs() < 1e-9 && (y - 179.5).abs() < 1e-9);
            // A linear ramp stays in place under a correct reduction.
            let (px, py) = (level.image.width() / 2, level.image.height() / 2);
            let [u, v] = level.in_picture(f64::from(px), f64::from(py));
            let expected = 0.15 * u + 0.1 * v + 10.0;
            assert!((f64::from(level.image.get_pixel(px, py)[0]) - expected).abs() <= 3.0);
        }
    }

    #[test]
    fn smoothing_keeps_flat_and_sums_to_one() {
        let flat = GrayImage::from_pixel(30, 20, image::Luma([137]));
        let mut out = GrayImage::new(30, 20);
        smooth_into(&flat, &mut out, &mut Vec::new());
        assert!(out.iter().all(|v| *v == 137));
        let mut point = GrayImage::new(31, 31);
        point.put_pixel(15, 15, image::Luma([255]));
        let mut out = GrayImage::new(31, 31);
        smooth_into(&point, &mut out, &mut Vec::new());
        let sum: u32 = out.iter().map(|v| u32::from(*v)).sum();
        assert!((250..=260).contains(&sum), "{sum}");
    }

    #[test]
    fn tiny_pictures_make_one_level() {
        let mut pyramid = Pyramid::default();
        assert_eq!(pyramid.build(&ramp(1, 1), 1.2, 8, 40).len(), 1);
    }
}
