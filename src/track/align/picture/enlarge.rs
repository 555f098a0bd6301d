//! A picture at twice its size, by Lanczos' windowed sinc of three lobes: exactly two phases of six weights, mirror images of
//! each other, one direction after the other. It is made row by row: whoever cuts it up need not hold all of it.

use std::f32::consts::PI;

use image::GrayImage;

use crate::simd::multiversion;

/// Lobes of the kernel on each side, and the pixels that it weighs along a row. Three are the usual choice (Lanczos3). Raised, edges ring
/// further, and the start takes longer.
const LOBES: usize = 3;
const TAPS: usize = 2 * LOBES;
/// Old pixels whose new ones are made at once: what stays in the nearest cache.
const BLOCK: usize = 64;

/// A picture of at least one pixel, twice as wide and high. The new pixels of a pair lie a quarter of a pixel to either side of the old one.
pub struct Enlarged<'a> {
    picture: &'a GrayImage,
    /// For the earlier of two new pixels, and for the later.
    weights: [[f32; TAPS]; 2],
    /// A blended row with room for the taps at both ends, and for a block that begins at any of its pixels.
    blended: Vec<f32>,
}

impl<'a> Enlarged<'a> {
    pub fn new(picture: &'a GrayImage) -> Self {
        let earlier = weights();
        let mut later = earlier;
        later.reverse();
        Self { picture, weights: [earlier, later], blended: vec![0.0; picture.width() as usize + 2 * LOBES + BLOCK] }
    }

    /// Columns and rows.
    pub fn size(&self) -> [usize; 2] {
        [2 * self.picture.width() as usize, 2 * self.picture.height() as usize]
    }

    /// Writes its row `v`.
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
    /// The weighted sum of rows.
    fn blend(rows: [&[u8]; TAPS], weights: &[f32; TAPS], out: &mut [f32]); ["avx2"] => blend_plain, else blend_plain
}

#[inline(always)]
fn blend_plain(rows: [&[u8]; TAPS], weights: &[f32; TAPS], out: &mut [f32]) {
    out.fill(0.0);
    for (row, weight) in rows.iter().zip(weights) {
        out.iter_mut().zip(*row).for_each(|(sum, grey)| *sum += weight * f32::from(*grey));
    }
}

multiversion! {
    /// Two new pixels of each old one, from a row that is longer by [`LOBES`] pixels before it and a block more behind it.
    fn interleave(row: &[f32], earlier: &[f32; TAPS], later: &[f32; TAPS], out: &mut [u8]);
    ["avx2"] => interleave_plain, else interleave_plain
}

#[inline(always)]
fn interleave_plain(row: &[f32], earlier: &[f32; TAPS], later: &[f32; TAPS], out: &mut [u8]) {
    // Behind 2^23 a float's last bits count by one: a conversion of eight at once, where `as` checks one after the other.
    let grey = |sum: f32| ((sum + 0.5).clamp(0.0, 255.0).floor() + 8_388_608.0).to_bits() as u8;
    for (k, out) in out.chunks_mut(2 * BLOCK).enumerate() {
        // What is computed beyond the row's end is not taken.
        let Some(row) = row[k * BLOCK..].first_chunk::<{ BLOCK + TAPS }>() else { return };
        let mut greys = [[0u8; BLOCK]; 2];
        for u in 0..BLOCK {
            let mut sums = [0.0f32; 2];
            for t in 0..TAPS {
                sums[0] += earlier[t] * row[u + t];
                sums[1] += later[t] * row[u + t + 1];
            }
            (greys[0][u], greys[1][u]) = (grey(sums[0]), grey(sums[1]));
        }
        let [earlier, later] = &greys;
        for ((pair, a), b) in out.as_chunks_mut::<2>().0.iter_mut().zip(earlier).zip(later) {
            *pair = [*a, *b];
        }
    }
}

/// Weights of the pixels three before to two behind, for a place a quarter of a pixel before one; their sum is 1.
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
    fn it_is_what_a_general_lanczos_resize_gives() {
        let picture = GrayImage::from_fn(41, 37, |x, y| image::Luma([(x * x * 3 + y * 11 + x * y) as u8]));
        let (own, general) = (enlarged_twice(&picture), resize(&picture, 82, 74, FilterType::Lanczos3));
        assert_eq!(own.dimensions(), (82, 74));
        for (x, y, intensity) in own.enumerate_pixels() {
            // The border is continued here, and left out there.
            let is_inside = (6..76).contains(&x) && (6..68).contains(&y);
            assert!(!is_inside || intensity[0].abs_diff(general.get_pixel(x, y)[0]) <= 1, "{x} {y}");
        }
    }

    #[test]
    fn a_single_pixel_is_repeated() {
        assert!(enlarged_twice(&GrayImage::from_pixel(1, 1, image::Luma([77]))).pixels().all(|p| p[0] == 77));
    }
}
