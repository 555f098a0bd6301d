//! A pyramid of ever smaller copies of a picture.
//!
//! A level of scale `s` relates to the picture by `c_level = (c + 0.5) s - 0.5` (DESIGN section 2), with
//! one exact factor per axis because sizes are whole pixels.

use image::GrayImage;

use crate::simd::multiversion;

/// One level: the picture at this size, and its smoothed copy that descriptors read.
#[derive(Debug, Clone, Default)]
pub struct Level {
    /// Grey levels.
    pub image: GrayImage,
    /// `image` after a 5x5 binomial filter.
    pub smooth: GrayImage,
    /// Level pixels per picture pixel, along x and y.
    pub scale: [f64; 2],
    /// Whether `smooth` is this picture's.
    is_smooth: bool,
}

impl Level {
    /// A position on this level as a position in the full picture.
    pub fn in_picture(&self, x: f64, y: f64) -> [f64; 2] {
        [(x + 0.5) / self.scale[0] - 0.5, (y + 0.5) / self.scale[1] - 0.5]
    }
}

/// The levels, largest first; buffers are kept between pictures.
#[derive(Debug, Clone, Default)]
pub struct Pyramid {
    levels: Vec<Level>,
    row: Vec<u16>,
    columns: ColumnTaps,
}

impl Pyramid {
    /// The levels that were built last.
    pub fn levels(&self) -> &[Level] {
        &self.levels
    }

    /// Builds at most `count` levels, each `factor` (> 1) smaller than the one before, none with a side below `least` pixels.
    pub fn build(&mut self, picture: &GrayImage, factor: f64, count: usize, least: u32) -> &[Level] {
        self.shrink(picture, factor, count, least);
        self.smooth_from(0)
    }

    /// The same without the smoothed copies.
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
            match before.last() {
                None => level.image.copy_from_slice(picture),
                Some(previous) => shrink(&previous.image, &mut level.image, &mut self.columns, &mut self.row),
            }
            level.is_smooth = false;
            level.scale = [f64::from(size.0) / f64::from(w), f64::from(size.1) / f64::from(h)];
            made += 1;
        }
        self.levels.truncate(made);
    }

    /// Makes the smoothed copies of the levels from `finest` on that have none yet, and returns all levels.
    pub(super) fn smooth_from(&mut self, finest: usize) -> &[Level] {
        for level in self.levels.iter_mut().skip(finest).filter(|level| !level.is_smooth) {
            resize_buffer(&mut level.smooth, level.image.width(), level.image.height());
            smooth_into(&level.image, &mut level.smooth, &mut self.row);
            level.is_smooth = true;
        }
        &self.levels
    }
}

/// Gives a buffer another size, keeping its memory where it suffices.
pub(crate) fn resize_buffer(image: &mut GrayImage, width: u32, height: u32) {
    if image.dimensions() != (width, height) {
        let mut raw = std::mem::take(image).into_raw();
        raw.resize(width as usize * height as usize, 0);
        // The buffer was just made exactly this long.
        *image = GrayImage::from_raw(width, height, raw).unwrap_or_default();
    }
}

/// Columns of a smaller picture that are made side by side.
const LANES: usize = 16;
/// How much further than its neighbours the last of [`LANES`] columns may reach into the larger picture, at most: all that factors up to 1.25 need. Raised, more factors are
/// fast, and each costs more.
const MOST_SKIPS: usize = 4;

/// What each column of a smaller picture takes of the larger one's columns.
#[derive(Debug, Clone, Default)]
struct ColumnTaps {
    /// The left one of two neighbours, and what the right one counts, of 128.
    taps: Vec<(u32, u16)>,
    /// The same for columns side by side; none where there are fewer, or where they lie further apart.
    blocks: Vec<TapBlock>,
}

/// Of [`LANES`] columns side by side.
#[derive(Debug, Clone, Copy, Default)]
struct TapBlock {
    /// The first of these columns, and the left neighbour of its place.
    first: usize,
    from: usize,
    /// How much further each has its left neighbour than if all places were one apart.
    skips: [u16; LANES],
    /// What the right neighbours count, of 128.
    shares: [u16; LANES],
}

/// The left neighbour of place `k`, and what the right one counts, of 128; pixel areas are aligned.
fn tap(k: usize, from: usize, to: usize) -> (u32, u16) {
    let c = ((k as f64 + 0.5) * from as f64 / to as f64 - 0.5).clamp(0.0, (from - 1) as f64);
    let i = (c as usize).min(from.saturating_sub(2));
    (i as u32, ((c - i as f64) * 128.0).round() as u16)
}

impl ColumnTaps {
    fn update(&mut self, from: usize, to: usize) {
        let Self { taps, blocks } = self;
        taps.clear();
        taps.extend((0..to).map(|x| tap(x, from, to)));
        blocks.clear();
        if to < LANES {
            return;
        }
        // The last block overlaps the one before it, so that no column is left over.
        let of_block = |first: usize| {
            let own = &taps[first..][..LANES];
            let from = own[0].0 as usize;
            let skips = std::array::from_fn(|k| (own[k].0 as usize).wrapping_sub(from + k) as u16);
            TapBlock { first, from, skips, shares: std::array::from_fn(|k| own[k].1) }
        };
        blocks.extend((0..to - LANES).step_by(LANES).chain([to - LANES]).map(of_block));
        if blocks.iter().any(|block| block.skips.iter().any(|skip| usize::from(*skip) > MOST_SKIPS)) {
            blocks.clear();
        }
    }
}

multiversion! {
    /// See [`shrink_lanes`].
    fn shrink(from: &GrayImage, to: &mut GrayImage, columns: &mut ColumnTaps, blended: &mut Vec<u16>);
    ["avx2"] => shrink_lanes, else shrink_lanes
}

/// Bilinear reduction by a factor between 1 and 2 (both axes), pixel areas aligned: rows are blended first, side by side, then
/// columns are picked from the blended row.
#[inline(always)]
fn shrink_lanes(from: &GrayImage, to: &mut GrayImage, columns: &mut ColumnTaps, blended: &mut Vec<u16>) {
    let (fw, fh) = (from.width() as usize, from.height() as usize);
    let (tw, th) = (to.width() as usize, to.height() as usize);
    columns.update(fw, tw);
    blended.clear();
    // As many more than the row as a block may read, so that right neighbours exist.
    blended.resize(fw + LANES + MOST_SKIPS + 1, 0);
    let source = from.as_raw();
    for (y, row) in to.as_mut().chunks_exact_mut(tw).enumerate() {
        let (j, b) = tap(y, fh, th);
        let top = &source[j as usize * fw..][..fw];
        let bottom = &source[(j as usize + usize::from(fh > 1)) * fw..][..fw];
        for ((out, t), l) in blended.iter_mut().zip(top).zip(bottom) {
            *out = u16::from(*t) * (128 - b) + u16::from(*l) * b;
        }
        blended[fw] = blended[fw - 1];
        if columns.blocks.is_empty() {
            pick_columns(blended, &columns.taps, row);
        }
        // A loop and no closure, which would not be compiled for the wide registers.
        for block in &columns.blocks {
            pick_block(blended, block, row);
        }
    }
}

/// Columns of a blended row, one by one.
#[inline(always)]
fn pick_columns(blended: &[u16], taps: &[(u32, u16)], row: &mut [u8]) {
    for (out, &(i, a)) in row.iter_mut().zip(taps) {
        *out = blend(blended[i as usize], blended[i as usize + 1], a);
    }
}

/// Columns of a blended row side by side: whichever of the shifted copies of the row holds a column's neighbours.
#[inline(always)]
fn pick_block(blended: &[u16], block: &TapBlock, row: &mut [u8]) {
    let near = &blended[block.from..][..LANES + MOST_SKIPS + 1];
    let (mut left, mut right) = ([0_u16; LANES], [0_u16; LANES]);
    for skip in 0..=MOST_SKIPS {
        let [at, beside] = [skip, skip + 1].map(|k| &near[k..][..LANES]);
        for k in 0..LANES {
            // All bits where it is this copy, none elsewhere: a choice between values would become a branch.
            let is_it = u16::from(block.skips[k] == skip as u16).wrapping_neg();
            left[k] |= at[k] & is_it;
            right[k] |= beside[k] & is_it;
        }
    }
    for (k, out) in row[block.first..][..LANES].iter_mut().enumerate() {
        *out = blend(left[k], right[k], block.shares[k]);
    }
}

/// A grey level of two neighbours in a blended row, 128 times as high; `share`: what the right one counts, of 128.
#[inline(always)]
fn blend(left: u16, right: u16, share: u16) -> u8 {
    let (left, right, share) = (u32::from(left), u32::from(right), u32::from(share));
    ((left * (128 - share) + right * share + 8192) >> 14) as u8
}

multiversion! {
    /// The 5x5 binomial filter (1 4 6 4 1)/16 along both axes; edges repeat the border pixel.
    pub fn smooth_into(from: &GrayImage, to: &mut GrayImage, row: &mut Vec<u16>); ["avx2"] => smooth_lanes, else smooth_lanes
}

#[inline(always)]
fn smooth_lanes(from: &GrayImage, to: &mut GrayImage, row: &mut Vec<u16>) {
    smooth_with(from, to, row, |sum| ((sum + 128) >> 8) as u8);
}

/// The same, with what becomes of the filter's sums: 256 times a grey level.
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
        // At most 256 * 255 + 128: 16 bits hold it.
        let [a, b, c, d, e] = [0, 1, 2, 3, 4].map(|k| &row[k..k + w]);
        for (x, out) in out.iter_mut().enumerate() {
            *out = grey(a[x] + e[x] + 4 * (b[x] + d[x]) + 6 * c[x]);
        }
    }
}

/// Means of 2x2 pixels; an odd last row or column is dropped, so that positions stay exact.
pub fn halved(image: &GrayImage) -> GrayImage {
    let mut half = GrayImage::new(image.width() / 2, image.height() / 2);
    let (w, stride) = (half.width() as usize, image.width() as usize);
    for (out, rows) in half.chunks_exact_mut(w.max(1)).zip(image.as_raw().chunks_exact(2 * stride.max(1))) {
        let (top, bottom) = rows.split_at(stride);
        for ((out, t), b) in out.iter_mut().zip(top.chunks_exact(2)).zip(bottom.chunks_exact(2)) {
            *out = ((u16::from(t[0]) + u16::from(t[1]) + u16::from(b[0]) + u16::from(b[1]) + 2) >> 2) as u8;
        }
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

    /// Widths around whole blocks, and factors on both sides of what blocks can do.
    #[test]
    fn columns_side_by_side_are_those_one_by_one() {
        for from in [17_usize, 33, 64, 97, 128, 321, 1280] {
            let blended: Vec<u16> = (0..from + LANES + MOST_SKIPS + 1).map(|k| (k * 7919 % 32641) as u16).collect();
            for factor in [1.05, 1.1, 1.2, 1.6, 2.0] {
                let to = (from as f64 / factor).round() as usize;
                let mut columns = ColumnTaps::default();
                columns.update(from, to);
                assert_eq!(columns.blocks.is_empty(), to < LANES || factor > 1.3, "{from} {factor}");
                let (mut one_by_one, mut side_by_side) = (vec![0; to], vec![0; to]);
                pick_columns(&blended, &columns.taps, &mut one_by_one);
                columns.blocks.iter().for_each(|block| pick_block(&blended, block, &mut side_by_side));
                assert!(columns.blocks.is_empty() || one_by_one == side_by_side, "{from} {factor}");
            }
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
