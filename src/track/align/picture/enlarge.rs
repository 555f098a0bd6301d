//! Enlarges a picture, whose pixels are square roots of light, to twice its size with Lanczos'
//! windowed sinc of three lobes.
//!
//! Roots are blended, not light: printers, projectors and displays enlarge encoded pictures, and
//! the ringing beside a highlight stays small in the dark.
//!
//! At a factor of two the kernel has exactly two phases of six weights, which mirror each other.
//! Rows are blended first, then pixels within a row. The enlarged picture is produced row by row,
//! so that `texture`, which cuts it into tiles, never holds all of it.

use std::f32::consts::PI;

use image::GrayImage;

use crate::light::square_root::byte;
use crate::simd::multiversion;

/// Lobes of the kernel on each side, and weights along one axis. Raised, edges ring further and
/// loading takes longer; lowered, detail is lost.
const LOBES: usize = 3;
const TAPS: usize = 2 * LOBES;
/// Old pixels processed at once, so that they stay in the first-level cache.
const TEXELS_AT_A_TIME: usize = 64;

/// A picture of at least one pixel, enlarged to twice its width and height. The two new pixels of
/// an old one lie a quarter of an old pixel to either side of it.
pub struct Enlarged<'a> {
    picture: &'a GrayImage,
    /// Weights of the earlier and of the later of two new pixels.
    weights: [[f32; TAPS]; 2],
    /// A blended row, padded by the taps at both ends and by one block beyond, so that a block may
    /// start at any of its pixels.
    blended: Vec<f32>,
}

impl<'a> Enlarged<'a> {
    /// Prepares to enlarge a picture; no pixel is computed yet.
    pub fn new(picture: &'a GrayImage) -> Self {
        let earlier = weights();
        let mut later = earlier;
        later.reverse();
        Self { picture, weights: [earlier, later], blended: vec![0.0; picture.width() as usize + 2 * LOBES + TEXELS_AT_A_TIME] }
    }

    /// Returns the columns and rows of the enlarged picture.
    pub fn size(&self) -> [usize; 2] {
        [2 * self.picture.width() as usize, 2 * self.picture.height() as usize]
    }

    /// Writes row `v` of the enlarged picture to `out`, which has one element per column.
    pub fn write_row(&mut self, v: usize, out: &mut [u8]) {
        let Self { picture, weights, blended } = self;
        let (w, h) = (picture.width() as usize, picture.height() as usize);
        let first = v.div_ceil(2);
        let rows = std::array::from_fn::<_, TAPS, _>(|t| &picture.as_raw()[(first + t).saturating_sub(LOBES).min(h - 1) * w..][..w]);
        blend(rows, &weights[v % 2], &mut blended[LOBES..LOBES + w]);
        let (left, right) = (blended[LOBES], blended[LOBES + w - 1]);
        blended[..LOBES].fill(left);
        blended[LOBES + w..][..LOBES].fill(right);
        interleave(blended, &weights[0], &weights[1], out);
    }
}

multiversion! {
    /// Computes the weighted sum of rows.
    fn blend(rows: [&[u8]; TAPS], weights: &[f32; TAPS], out: &mut [f32]); ["avx2"] => blend_plain, else blend_plain
}

#[inline(always)]
fn blend_plain(rows: [&[u8]; TAPS], weights: &[f32; TAPS], out: &mut [f32]) {
    out.fill(0.0);
    for (row, weight) in rows.iter().zip(weights) {
        out.iter_mut().zip(*row).for_each(|(sum, root)| *sum += weight * f32::from(*root));
    }
}

multiversion! {
    /// Computes two new pixels for each old one. `row` has [`LOBES`] more pixels before its start
    /// and at least a block more beyond its end.
    fn interleave(row: &[f32], earlier: &[f32; TAPS], later: &[f32; TAPS], out: &mut [u8]);
    ["avx2"] => interleave_plain, else interleave_plain
}

#[inline(always)]
fn interleave_plain(row: &[f32], earlier: &[f32; TAPS], later: &[f32; TAPS], out: &mut [u8]) {
    for (k, out) in out.chunks_mut(2 * TEXELS_AT_A_TIME).enumerate() {
        // Values computed beyond the end of the row are not written.
        let Some(row) = row[k * TEXELS_AT_A_TIME..].first_chunk::<{ TEXELS_AT_A_TIME + TAPS }>() else { return };
        let mut roots = [[0u8; TEXELS_AT_A_TIME]; 2];
        for u in 0..TEXELS_AT_A_TIME {
            let mut sums = [0.0f32; 2];
            for t in 0..TAPS {
                sums[0] += earlier[t] * row[u + t];
                sums[1] += later[t] * row[u + t + 1];
            }
            (roots[0][u], roots[1][u]) = (byte(sums[0]), byte(sums[1]));
        }
        let [earlier, later] = &roots;
        for ((pair, a), b) in out.as_chunks_mut::<2>().0.iter_mut().zip(earlier).zip(later) {
            *pair = [*a, *b];
        }
    }
}

/// Returns the weights of the pixels from three before to two after a pixel, for a place a quarter
/// of a pixel before it. Their sum is 1.
fn weights() -> [f32; TAPS] {
    let lanczos = |x: f32| {
        let (a, b) = (PI * x, PI * x / LOBES as f32);
        (a.sin() / a) * (b.sin() / b)
    };
    let weights: [f32; TAPS] = std::array::from_fn(|t| lanczos(t as f32 - LOBES as f32 + 0.25));
    let sum: f32 = weights.iter().sum();
    weights.map(|w| w / sum)
}

#[cfg(test)]
mod tests {
    use image::imageops::{FilterType, resize};

    use super::*;

    fn enlarged_twice(picture: &GrayImage) -> GrayImage {
        let mut enlarged = Enlarged::new(picture);
        let [width, height] = enlarged.size();
        let mut out = vec![0; width * height];
        out.chunks_exact_mut(width).enumerate().for_each(|(v, row)| enlarged.write_row(v, row));
        GrayImage::from_raw(width as u32, height as u32, out).expect("as many greys as pixels")
    }

    #[test]
    fn enlarging_twice_matches_a_general_lanczos_resize() {
        let picture = GrayImage::from_fn(41, 37, |x, y| image::Luma([(x * x * 3 + y * 11 + x * y) as u8]));
        let (own, general) = (enlarged_twice(&picture), resize(&picture, 82, 74, FilterType::Lanczos3));
        assert_eq!(own.dimensions(), (82, 74));
        for (x, y, intensity) in own.enumerate_pixels() {
            // This code extends the border; `resize` leaves it out.
            let is_inside = (6..76).contains(&x) && (6..68).contains(&y);
            assert!(!is_inside || intensity[0].abs_diff(general.get_pixel(x, y)[0]) <= 1, "{x} {y}");
        }
    }

    #[test]
    fn enlarging_a_single_pixel_repeats_it() {
        assert!(enlarged_twice(&GrayImage::from_pixel(1, 1, image::Luma([77]))).pixels().all(|p| p[0] == 77));
    }
}
