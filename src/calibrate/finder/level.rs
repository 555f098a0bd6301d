//! A picture as floating-point grey levels, and its reductions by half, on which the finder works.
//!
//! Halving averages 2 x 2 pixels, so a position c becomes (c + 0.5) / 2 - 0.5; a side of odd length
//! loses its last line.

use image::GrayImage;
use nalgebra::Vector2;

/// One level of the pyramid.
#[derive(Debug, Clone)]
pub(crate) struct Level {
    pub width: usize,
    pub height: usize,
    /// Grey levels, row-major.
    pub grey: Vec<f32>,
}

impl Level {
    pub fn of_picture(picture: &GrayImage) -> Self {
        let grey = picture.as_raw().iter().map(|&v| f32::from(v)).collect();
        Self { width: picture.width() as usize, height: picture.height() as usize, grey }
    }

    /// Returns the level at half the size.
    pub fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut grey = Vec::with_capacity(width * height);
        for y in 0..height {
            let (top, bottom) = self.grey[2 * y * self.width..].split_at(self.width);
            let pairs = top.chunks_exact(2).zip(bottom.chunks_exact(2)).take(width);
            grey.extend(pairs.map(|(a, b)| 0.25 * (a[0] + a[1] + b[0] + b[1])));
        }
        Self { width, height, grey }
    }

    /// Smooths by the binomial filter (1 4 6 4 1)/16 along both axes: a Gaussian of sigma 1. Border
    /// pixels are repeated.
    pub fn smoothed(&self) -> Self {
        let (w, h) = (self.width, self.height);
        let mut grey = vec![0.0_f32; w * h];
        let mut row = vec![0.0_f32; w + 4];
        for (y, out) in grey.chunks_exact_mut(w.max(1)).enumerate() {
            let line = |d: isize| &self.grey[(y as isize + d).clamp(0, h as isize - 1) as usize * w..][..w];
            let (a, b, c, d, e) = (line(-2), line(-1), line(0), line(1), line(2));
            for (x, middle) in row[2..w + 2].iter_mut().enumerate() {
                *middle = a[x] + e[x] + 4.0 * (b[x] + d[x]) + 6.0 * c[x];
            }
            (row[0], row[1], row[w + 2], row[w + 3]) = (row[2], row[2], row[w + 1], row[w + 1]);
            for (out, r) in out.iter_mut().zip(row.windows(5)) {
                *out = (r[0] + r[4] + 4.0 * (r[1] + r[3]) + 6.0 * r[2]) * (1.0 / 256.0);
            }
        }
        Self { width: w, height: h, grey }
    }

    /// Whether a position lies at least `margin` pixels inside the outermost pixel centres.
    pub fn has(&self, p: Vector2<f64>, margin: f64) -> bool {
        let inside = |c: f64, size: usize| c >= margin && c + margin <= size as f64 - 1.0;
        inside(p.x, self.width) && inside(p.y, self.height)
    }

    /// Returns eight grey levels from `index` on; 0 beyond the last.
    #[inline(always)]
    pub fn eight_from(&self, index: usize) -> [f32; 8] {
        let mut eight = [0.0; 8];
        match self.grey.get(index..index + 8) {
            Some(grey) => eight.copy_from_slice(grey),
            None => eight.iter_mut().zip(self.grey.iter().skip(index)).for_each(|(to, grey)| *to = *grey),
        }
        eight
    }

    /// Returns the bilinearly interpolated grey level; positions outside are clamped to the rim.
    pub fn sample(&self, p: Vector2<f64>) -> f32 {
        let inside = |c: f64, size: usize| {
            let last = f64::from(size as u32) - 1.001;
            (if c > last { last } else { c }).max(0.0) as f32
        };
        let (x, y) = (inside(p.x, self.width), inside(p.y, self.height));
        // Via i32: the processor converts to it in one instruction.
        let (i, j) = (x as i32, y as i32);
        let (a, b) = (x - i as f32, y - j as f32);
        let first = j as usize * self.width + i as usize;
        let (top, bottom) = (&self.grey[first..][..2], &self.grey[first + self.width..][..2]);
        (top[0] * (1.0 - a) + top[1] * a) * (1.0 - b) + (bottom[0] * (1.0 - a) + bottom[1] * a) * b
    }
}

/// Returns the picture at full size, half, quarter … while both sides have at least `least` pixels.
pub(crate) fn pyramid(picture: &GrayImage, least: usize) -> Vec<Level> {
    let mut levels = vec![Level::of_picture(picture)];
    while let Some(last) = levels.last().filter(|l| l.width.min(l.height) >= 2 * least) {
        levels.push(last.halved());
    }
    levels
}

/// Converts a position to the level `steps` levels coarser (half the size each), or finer if
/// negative.
pub(crate) fn rescaled(p: Vector2<f64>, steps: i32) -> Vector2<f64> {
    let s = 0.5_f64.powi(steps);
    p.map(|c| (c + 0.5) * s - 0.5)
}
