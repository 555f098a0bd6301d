//! Pictures on surfaces, for lookup at any magnification.
//!
//! A far surface shows many picture elements ("texels") in one pixel; sampling just one would make
//! it flicker. A [`Texture`] therefore keeps the picture at successively halved sizes and
//! interpolates between the two that fit (mipmapping). Every size has the mean light of the first,
//! and edges stay in place to a fraction of a texel.

use image::GrayImage;

use super::light::LightModel;

/// One size of the picture.
#[derive(Debug, Clone)]
struct Level {
    width: usize,
    height: usize,
    /// Light, row-major. The last column and the last row are stored twice, so that a lookup at the
    /// edge is no special case.
    light: Vec<f32>,
    /// Texels of this level per texel of the first, across and down.
    scale: [f64; 2],
    /// Index of the last column and row.
    last: [f64; 2],
}

/// A grey picture with its halved copies.
#[derive(Debug, Clone)]
pub(super) struct Texture {
    levels: Vec<Level>,
}

impl Texture {
    /// Halves the picture until its smaller side has one texel. The averages are over the light of
    /// its grey levels.
    pub(super) fn new(picture: &GrayImage, model: LightModel) -> Self {
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        let light: Vec<f32> = picture.as_raw().iter().map(|&g| model.light_of(f32::from(g))).collect();
        let mut levels = vec![Level::new(width, height, &light, [1.0; 2])];
        while let Some(last) = levels.last().filter(|l| l.width.min(l.height) > 1) {
            let next = last.halved(width, height);
            levels.push(next);
        }
        Self { levels }
    }

    /// Returns the light at `(u, v)` in pixels of the full picture (centres at integers), averaged
    /// over about `2^level` of them along each side. Outside the picture its edge values continue.
    #[inline]
    pub(super) fn light(&self, u: f64, v: f64, level: f32) -> f32 {
        // Most pictures are seen from so near that their finest level is enough.
        if level <= 0.0 {
            return self.levels[0].bilinear(u, v);
        }
        let level = level.min((self.levels.len() - 1) as f32);
        let fine = level as usize;
        let blend = level - fine as f32;
        let sharp = self.levels[fine].bilinear(u, v);
        // At the last level one size is enough.
        if blend == 0.0 {
            return sharp;
        }
        sharp + (self.levels[fine + 1].bilinear(u, v) - sharp) * blend
    }
}

impl Level {
    fn new(width: usize, height: usize, light: &[f32], scale: [f64; 2]) -> Self {
        let rows = light.chunks_exact(width).chain(light.chunks_exact(width).last());
        let light = rows.flat_map(|row| row.iter().chain(row.last())).copied().collect();
        Self { width, height, light, scale, last: [(width - 1) as f64, (height - 1) as f64] }
    }

    /// Returns the rows without the repeated texels.
    fn rows(&self) -> impl Iterator<Item = &[f32]> {
        self.light.chunks_exact(self.width + 1).take(self.height).map(|row| &row[..self.width])
    }

    /// Returns the next smaller picture. Every texel of this one has the same total weight, so the
    /// mean is kept.
    fn halved(&self, full_width: usize, full_height: usize) -> Self {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let rows: Vec<f32> = self.rows().flat_map(|row| shrink(row, width)).collect();
        let mut light = vec![0.0; width * height];
        for x in 0..width {
            let column: Vec<f32> = rows.iter().skip(x).step_by(width).copied().collect();
            for (y, value) in shrink(&column, height).into_iter().enumerate() {
                light[y * width + x] = value;
            }
        }
        Self::new(width, height, &light, [width as f64 / full_width as f64, height as f64 / full_height as f64])
    }

    #[inline]
    fn bilinear(&self, u: f64, v: f64) -> f32 {
        // Pixel centres at integers: scaling by s moves a pixel to (c + 0.5) s - 0.5.
        let x = ((u + 0.5) * self.scale[0] - 0.5).clamp(0.0, self.last[0]);
        let y = ((v + 0.5) * self.scale[1] - 0.5).clamp(0.0, self.last[1]);
        let (i, j) = (x as i32, y as i32);
        let (a, b) = ((x - f64::from(i)) as f32, (y - f64::from(j)) as f32);
        let stride = self.width + 1;
        let four = &self.light[j as usize * stride + i as usize..][..stride + 2];
        let (above, below) = ([four[0], four[1]], [four[stride], four[stride + 1]]);
        let top = above[0] + (above[1] - above[0]) * a;
        let bottom = below[0] + (below[1] - below[0]) * a;
        top + (bottom - top) * b
    }
}

/// Averages a line down to `count` equal windows; values that straddle two windows are split
/// between them.
fn shrink(line: &[f32], count: usize) -> Vec<f32> {
    let window = line.len() as f64 / count as f64;
    (0..count)
        .map(|k| {
            let (from, to) = (k as f64 * window, (k + 1) as f64 * window);
            let last = (to.ceil() as usize).min(line.len());
            let share = |i: usize| ((i + 1) as f64).min(to) - (i as f64).max(from);
            let sum: f64 = (from as usize..last).map(|i| f64::from(line[i]) * share(i)).sum();
            (sum / window) as f32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: u32, height: u32) -> GrayImage {
        GrayImage::from_fn(width, height, |x, y| image::Luma([((x * 37 + y * 101 + x * y) % 251) as u8]))
    }

    #[test]
    fn every_level_keeps_the_mean_grey() {
        // Odd sides: windows straddle texels.
        let texture = Texture::new(&picture(231, 117), LightModel::GreyAverages);
        let mean = |l: &Level| l.rows().flatten().map(|&g| f64::from(g)).sum::<f64>() / (l.width * l.height) as f64;
        let first = mean(&texture.levels[0]);
        assert!(texture.levels.len() >= 7);
        for level in &texture.levels {
            assert!((mean(level) - first).abs() < 1e-3, "{} x {}: {} not {first}", level.width, level.height, mean(level));
        }
    }

    #[test]
    fn the_first_level_reads_the_picture_itself() {
        let picture = picture(20, 10);
        let texture = Texture::new(&picture, LightModel::GreyAverages);
        assert_eq!(texture.light(7.0, 3.0, 0.0), f32::from(picture.get_pixel(7, 3)[0]));
        let between = 0.5 * (f32::from(picture.get_pixel(7, 3)[0]) + f32::from(picture.get_pixel(8, 3)[0]));
        assert!((texture.light(7.5, 3.0, 0.0) - between).abs() < 1e-4);
        assert_eq!(texture.light(-5.0, -5.0, 0.0), f32::from(picture.get_pixel(0, 0)[0]));
    }

    #[test]
    fn coarse_levels_do_not_shift_a_ramp() {
        let ramp = GrayImage::from_fn(256, 64, |x, _| image::Luma([x as u8]));
        let texture = Texture::new(&ramp, LightModel::GreyAverages);
        for level in [0.0, 0.5, 1.0, 2.3, 3.0] {
            assert!((texture.light(100.25, 31.0, level) - 100.25).abs() < 1e-3, "level {level}");
        }
    }
    #[test]
    fn linear_light_is_averaged_as_light() {
        let stripes = GrayImage::from_fn(64, 64, |x, _| image::Luma([if x % 2 == 0 { 0 } else { 255 }]));
        let linear = LightModel::Linear(Default::default());
        let mean = Texture::new(&stripes, linear).light(31.5, 31.5, 6.0);
        assert!((mean - 127.5).abs() < 0.01 && linear.grey_of(mean).round() == 188.0, "{mean}");
    }
}
