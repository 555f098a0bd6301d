//! Bilinear reduction of a picture: a plain function, and its AVX2 twin.
//!
//! A pixel of the smaller picture is a weighted mean of four of the larger one, with weights in
//! 128ths along each axis. All sums are exact, so both twins give the same bytes.

use image::GrayImage;

use crate::simd::multiversion;

/// Sum of the weights of two neighbours. Raised, a sum of two weighted pixels would not fit 16
/// bits.
const WHOLE: u16 = 128;
/// Weighted sums are 2^14 times a grey level, 128 along each axis. Half of that is added before the
/// division, for rounding.
const BITS: i32 = 14;
const HALF: i32 = 1 << (BITS - 1);

/// Weights of the larger picture's columns for each column of the smaller one.
#[derive(Debug, Clone, Default)]
pub struct ColumnTaps {
    /// Widths of the larger and the smaller picture.
    widths: [usize; 2],
    /// The left of two neighbours, and the weight of the right one.
    taps: Vec<(u32, u16)>,
    /// The same in blocks of columns; empty if there are fewer columns, or they are too far apart.
    #[cfg(target_arch = "x86_64")]
    blocks: Vec<avx2::TapBlock>,
}

/// Returns the left neighbour of position `k`, and the weight of the right one; pixel areas are
/// aligned.
fn tap(k: usize, from: usize, to: usize) -> (u32, u16) {
    let c = ((k as f64 + 0.5) * from as f64 / to as f64 - 0.5).clamp(0.0, (from - 1) as f64);
    let i = (c as usize).min(from.saturating_sub(2));
    (i as u32, ((c - i as f64) * f64::from(WHOLE)).round() as u16)
}

impl ColumnTaps {
    fn update(&mut self, from: usize, to: usize) {
        if self.widths == [from, to] {
            return;
        }
        self.widths = [from, to];
        self.taps.clear();
        self.taps.extend((0..to).map(|x| tap(x, from, to)));
        #[cfg(target_arch = "x86_64")]
        avx2::fill_blocks(&self.taps, from, &mut self.blocks);
    }
}

multiversion! {
    /// Fills a smaller picture, reduced by a factor between 1 and 2 on both axes; pixel areas are
    /// aligned. `columns` is reused for pictures of the same widths.
    pub fn shrink(from: &GrayImage, to: &mut GrayImage, columns: &mut ColumnTaps);
    ["avx2"] => avx2::shrink, else shrink_plain
}

/// Returns the two rows of the larger picture around a row of the smaller one, and the weight of
/// the lower one.
#[inline(always)]
fn rows(from: &GrayImage, y: usize, height: usize) -> (&[u8], &[u8], u16) {
    let (w, h) = (from.width() as usize, from.height() as usize);
    let (j, share) = tap(y, h, height);
    let row = |j: usize| &from.as_raw()[j * w..][..w];
    (row(j as usize), row(j as usize + usize::from(h > 1)), share)
}

/// The plain twin of [`shrink`].
#[inline(always)]
fn shrink_plain(from: &GrayImage, to: &mut GrayImage, columns: &mut ColumnTaps) {
    let (width, height) = (to.width() as usize, to.height() as usize);
    columns.update(from.width() as usize, width);
    for (y, out) in to.as_mut().chunks_exact_mut(width.max(1)).enumerate() {
        let (top, bottom, share) = rows(from, y, height);
        shrink_row(top, bottom, share, &columns.taps, out);
    }
}

/// Computes a row, column by column.
#[inline(always)]
fn shrink_row(top: &[u8], bottom: &[u8], share: u16, taps: &[(u32, u16)], out: &mut [u8]) {
    let blended = |x: usize| i32::from(u16::from(top[x]) * (WHOLE - share) + u16::from(bottom[x]) * share);
    for (out, &(left, beside)) in out.iter_mut().zip(taps) {
        let left = left as usize;
        let right = (left + 1).min(top.len() - 1);
        *out = ((blended(left) * i32::from(WHOLE - beside) + blended(right) * i32::from(beside) + HALF) >> BITS) as u8;
    }
}

/// The same, sixteen columns at a time: a byte shuffle gathers the neighbours, which compilers do
/// not generate.
#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::{
        __m128i, __m256i, _mm_loadu_si128, _mm_storeu_si128, _mm256_add_epi32, _mm256_castsi256_si128, _mm256_loadu_si256,
        _mm256_madd_epi16, _mm256_maddubs_epi16, _mm256_packs_epi32, _mm256_packus_epi16, _mm256_permute4x64_epi64, _mm256_set_m128i,
        _mm256_set1_epi8, _mm256_set1_epi32, _mm256_setzero_si256, _mm256_shuffle_epi8, _mm256_srai_epi32, _mm256_unpackhi_epi16,
        _mm256_unpacklo_epi16, _mm256_xor_si256,
    };

    use image::GrayImage;

    use super::{BITS, ColumnTaps, HALF, WHOLE, rows, shrink_row};

    /// Columns of the smaller picture computed side by side, and columns of the larger one from
    /// which each of their two halves is gathered.
    const LANES: usize = 16;
    const PICKED: usize = 16;

    /// Taps of [`LANES`] adjacent columns.
    #[derive(Debug, Clone, Copy, Default)]
    pub struct TapBlock {
        /// The first of these columns.
        first: usize,
        /// The first column of the larger picture that each half gathers from.
        from: [usize; 2],
        /// Positions of each column's neighbours relative to that, alternating left and right, and
        /// their weights.
        places: [u8; 2 * LANES],
        weights: [u8; 2 * LANES],
    }

    /// Builds the blocks for these taps; none if there are too few, or they are too far apart.
    /// `width` is that of the larger picture.
    pub fn fill_blocks(taps: &[(u32, u16)], width: usize, blocks: &mut Vec<TapBlock>) {
        blocks.clear();
        if taps.len() < LANES || width < PICKED {
            return;
        }
        let last = taps.len() - LANES;
        // The last block overlaps the one before, so that no column remains.
        for first in (0..last).step_by(LANES).chain([last]) {
            let Some(block) = block_of(taps, first, width) else {
                blocks.clear();
                return;
            };
            blocks.push(block);
        }
    }

    /// Builds the block of these columns; `None` if they are too far apart. `width` is that of the
    /// larger picture.
    fn block_of(taps: &[(u32, u16)], first: usize, width: usize) -> Option<TapBlock> {
        let mut block = TapBlock { first, ..TapBlock::default() };
        for (half, own) in taps[first..][..LANES].chunks_exact(LANES / 2).enumerate() {
            let from = (own[0].0 as usize).min(width - PICKED);
            block.from[half] = from;
            for (k, &(left, share)) in own.iter().enumerate() {
                let (place, at) = (left as usize - from, LANES * half + 2 * k);
                if place + 1 >= PICKED {
                    return None;
                }
                (block.places[at], block.places[at + 1]) = (place as u8, place as u8 + 1);
                (block.weights[at], block.weights[at + 1]) = ((WHOLE - share) as u8, share as u8);
            }
        }
        Some(block)
    }

    /// See [`super::shrink`].
    #[target_feature(enable = "avx2")]
    #[inline]
    pub fn shrink(from: &GrayImage, to: &mut GrayImage, columns: &mut ColumnTaps) {
        let (width, height) = (to.width() as usize, to.height() as usize);
        columns.update(from.width() as usize, width);
        // Subtract 128 to make grey levels signed, as the products require; four weights add up to
        // 128 times 128.
        let sign = _mm256_set1_epi8(i8::MIN);
        let offset = _mm256_set1_epi32(128 * (i32::from(WHOLE) * i32::from(WHOLE)) + HALF);
        for (y, out) in to.as_mut().chunks_exact_mut(width.max(1)).enumerate() {
            let (top, bottom, share) = rows(from, y, height);
            if columns.blocks.is_empty() {
                shrink_row(top, bottom, share, &columns.taps, out);
            }
            let by_row = _mm256_set1_epi32(i32::from(WHOLE - share) | i32::from(share) << 16);
            // Not using `map`, whose closure would be compiled without these registers.
            for block in &columns.blocks {
                // SAFETY: both arrays have 32 bytes.
                let places = unsafe { _mm256_loadu_si256(block.places.as_ptr().cast::<__m256i>()) };
                // SAFETY: as above.
                let weights = unsafe { _mm256_loadu_si256(block.weights.as_ptr().cast::<__m256i>()) };
                let mut sums = [_mm256_setzero_si256(); 2];
                for (sum, row) in sums.iter_mut().zip([top, bottom]) {
                    let (low, high) = (&row[block.from[0]..][..PICKED], &row[block.from[1]..][..PICKED]);
                    // SAFETY: the slice has the 16 bytes that are read.
                    let low = unsafe { _mm_loadu_si128(low.as_ptr().cast::<__m128i>()) };
                    // SAFETY: as above.
                    let high = unsafe { _mm_loadu_si128(high.as_ptr().cast::<__m128i>()) };
                    let grey = _mm256_xor_si256(_mm256_set_m128i(high, low), sign);
                    *sum = _mm256_maddubs_epi16(weights, _mm256_shuffle_epi8(grey, places));
                }
                let low = _mm256_madd_epi16(_mm256_unpacklo_epi16(sums[0], sums[1]), by_row);
                let high = _mm256_madd_epi16(_mm256_unpackhi_epi16(sums[0], sums[1]), by_row);
                let low = _mm256_srai_epi32::<BITS>(_mm256_add_epi32(low, offset));
                let high = _mm256_srai_epi32::<BITS>(_mm256_add_epi32(high, offset));
                let grey = _mm256_packs_epi32(low, high);
                let grey = _mm256_permute4x64_epi64::<0b1000>(_mm256_packus_epi16(grey, grey));
                let out = &mut out[block.first..][..LANES];
                // SAFETY: the slice has the 16 bytes that are written.
                unsafe { _mm_storeu_si128(out.as_mut_ptr().cast::<__m128i>(), _mm256_castsi256_si128(grey)) };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Widths around whole blocks, and factors within and beyond what blocks can handle.
    #[test]
    fn simd_columns_equal_scalar_columns() {
        let mut random = Pcg64Mcg::seed_from_u64(5);
        for width in [1, 2, 15, 16, 17, 20, 33, 64, 97, 128, 321, 1280] {
            for height in [1, 2, 7] {
                // Including black and white: the largest sums.
                let grey = |random: &mut Pcg64Mcg| [0, 255, random.random()][random.random_range(0..3)];
                let from = GrayImage::from_fn(width, height, |_, _| image::Luma([grey(&mut random)]));
                for factor in [1.0, 1.05, 1.1, 1.2, 1.6, 2.0] {
                    let side = |n: u32| ((f64::from(n) / factor).round() as u32).max(1);
                    let [mut plain, mut wide] = [(); 2].map(|()| GrayImage::new(side(width), side(height)));
                    shrink_plain(&from, &mut plain, &mut ColumnTaps::default());
                    let mut columns = ColumnTaps::default();
                    // Taps of other widths are replaced.
                    columns.update(width as usize, 1);
                    shrink(&from, &mut wide, &mut columns);
                    assert!(plain == wide, "{width} x {height}, {factor}");
                }
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn usual_pyramid_factors_use_the_simd_path() {
        for factor in [1.1, 1.2, 1.5] {
            let mut columns = ColumnTaps::default();
            columns.update(1280, (1280.0 / factor) as usize);
            assert!(!columns.blocks.is_empty(), "{factor}");
        }
    }

    #[test]
    fn a_grey_level_is_the_weighted_mean_of_four_pixels() {
        let from = GrayImage::from_raw(3, 3, vec![10, 250, 30, 90, 0, 77, 255, 3, 128]).expect("nine pixels");
        let mut to = GrayImage::new(2, 2);
        shrink(&from, &mut to, &mut ColumnTaps::default());
        // Positions 0.25 and 1.75 along both axes.
        let mean = |x: [u32; 2], y: [u32; 2], weights: [f64; 2]| {
            let row =
                |y: u32| weights[0] * f64::from(from.get_pixel(x[0], y)[0]) + (1.0 - weights[0]) * f64::from(from.get_pixel(x[1], y)[0]);
            weights[1] * row(y[0]) + (1.0 - weights[1]) * row(y[1])
        };
        let (near, far) = ([0, 1], [1, 2]);
        let expected =
            [mean(near, near, [0.75, 0.75]), mean(far, near, [0.25, 0.75]), mean(near, far, [0.75, 0.25]), mean(far, far, [0.25, 0.25])];
        assert_eq!(to.as_raw(), &expected.map(|grey| (grey + 0.5).floor() as u8));
    }
}
