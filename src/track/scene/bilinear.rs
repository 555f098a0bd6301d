//! Bilinear interpolation of a picture at many places at once. Beyond the border, the border's grey
//! is used.
//!
//! Positions and blends are computed in wide registers; only the texels are loaded one by one.

use crate::simd::multiversion;
use crate::track::scene::tuning::TUNING;

/// Places on a picture for a row of pixels, and the texels there; keeps its buffers.
#[derive(Debug, Default)]
pub struct RowOfTexels {
    /// Per place: the index of the texel above and left of it (row-major), and the place's offset
    /// to the right of that texel and below it.
    first: Vec<u32>,
    right: Vec<f32>,
    below: Vec<f32>,
    /// Per place: the texels above left, above right, below left and below right, one byte each.
    quads: Vec<u32>,
}

impl RowOfTexels {
    /// Makes room for rows of at most this many pixels.
    pub fn make_room(&mut self, pixels: usize) {
        self.first.resize(pixels, 0);
        self.right.resize(pixels, 0.0);
        self.below.resize(pixels, 0.0);
        self.quads.resize(pixels, 0);
    }

    /// Samples a picture of `size` (columns, rows) at the places (`xs`, `ys`), texels, into
    /// `greys`.
    pub fn look(&mut self, picture: &[u8], size: [usize; 2], xs: &[f32], ys: &[f32], greys: &mut [f32]) {
        let n = xs.len();
        find_texels(size, xs, ys, &mut self.first[..n], &mut self.right[..n], &mut self.below[..n]);
        ask_for_lines(picture, size[0], &self.first[..n]);
        look_up(picture, size[0], &self.first[..n], &mut self.quads[..n]);
        blend_texels(&self.quads[..n], &self.right[..n], &self.below[..n], greys);
    }
}

/// Samples a picture at a few places; see [`RowOfTexels::look`]. Returns the greys.
pub fn look_at<const N: usize>(picture: &[u8], size: [usize; 2], xs: &[f32; N], ys: &[f32; N]) -> [f32; N] {
    let (mut first, mut quads, mut right, mut below, mut greys) = ([0; N], [0; N], [0.0; N], [0.0; N], [0.0; N]);
    find_texels(size, xs, ys, &mut first, &mut right, &mut below);
    look_up(picture, size[0], &first, &mut quads);
    blend_texels(&quads, &right, &below, &mut greys);
    greys
}

/// Requests all texels of a row at once. A picture last used a frame ago is no longer cached, and
/// place by place only two or three of its lines would be in flight at a time.
fn ask_for_lines(picture: &[u8], width: usize, first: &[u32]) {
    let texel = |at: usize| picture.get(at).copied().unwrap_or(0);
    let some = first.iter().step_by(TUNING.min_places_per_cache_line).map(|at| texel(*at as usize) | texel(*at as usize + width));
    std::hint::black_box(some.fold(0, |all, texel| all | texel));
}

/// Loads the four texels of each place, one place after another.
fn look_up(picture: &[u8], width: usize, first: &[u32], quads: &mut [u32]) {
    for (quad, at) in quads.iter_mut().zip(first) {
        let near = &picture[*at as usize..];
        // There are two in each row, because no place lies right of the last column.
        let (above, below) = (&near[..2], &near[width..][..2]);
        *quad = u32::from_le_bytes([above[0], above[1], below[0], below[1]]);
    }
}

multiversion! {
    /// Computes the texel and the offsets of each place; see [`RowOfTexels`].
    fn find_texels(size: [usize; 2], xs: &[f32], ys: &[f32], first: &mut [u32], right: &mut [f32], below: &mut [f32]);
    ["avx2"] => find_texels_plain, else find_texels_plain
}

#[inline(always)]
fn find_texels_plain(size: [usize; 2], xs: &[f32], ys: &[f32], first: &mut [u32], right: &mut [f32], below: &mut [f32]) {
    // Slightly less than the last one, which has no neighbour.
    let [last_x, last_y] = size.map(|n| (n - 1) as f32 - 0.001);
    let [last_i, last_j] = size.map(|n| n as i32 - 2);
    for ((((x, y), first), right), below) in xs.iter().zip(ys).zip(first).zip(right).zip(below) {
        // NaN becomes 0.
        let (x, y) = (x.max(0.0).min(last_x), y.max(0.0).min(last_y));
        // In pictures wider than 2^15 texels the subtracted fraction is lost in rounding.
        let (i, j) = (whole_part(x).min(last_i), whole_part(y).min(last_j));
        (*right, *below) = (x - i as f32, y - j as f32);
        *first = (j * size[0] as i32 + i) as u32;
    }
}

/// Returns the whole part of a number from 0 to 2^23. A cast returns the same, but its check for
/// NaN and overflow prevents vectorisation.
#[inline(always)]
fn whole_part(v: f32) -> i32 {
    // Spacing of floats is 1 from here on.
    const WHOLE: f32 = (1u32 << 23) as f32;
    (v.trunc() + WHOLE).to_bits().wrapping_sub(WHOLE.to_bits()) as i32
}

multiversion! {
    /// Blends the four texels of each place; see [`RowOfTexels`].
    fn blend_texels(quads: &[u32], right: &[f32], below: &[f32], greys: &mut [f32]); ["avx2"] => blend_texels_plain, else blend_texels_plain
}

#[inline(always)]
fn blend_texels_plain(quads: &[u32], right: &[f32], below: &[f32], greys: &mut [f32]) {
    for (((quad, a), b), grey) in quads.iter().zip(right).zip(below).zip(greys) {
        let texel = |byte: u32| ((quad >> (8 * byte)) & 255) as i32 as f32;
        let upper = texel(0) * (1.0 - a) + texel(1) * a;
        let lower = texel(2) * (1.0 - a) + texel(3) * a;
        *grey = upper * (1.0 - b) + lower * b;
    }
}

/// The scalar version, one place at a time.
#[cfg(test)]
pub fn bilinear(picture: &image::GrayImage, x: f32, y: f32) -> f32 {
    let (image, width, height) = (picture.as_raw(), picture.width() as usize, picture.height() as usize);
    let x = x.clamp(0.0, (width - 1) as f32 - 0.001);
    let y = y.clamp(0.0, (height - 1) as f32 - 0.001);
    let (i, j) = (x as usize, y as usize);
    let (a, b) = (x - i as f32, y - j as f32);
    let near = &image[j * width + i..];
    let upper = f32::from(near[0]) * (1.0 - a) + f32::from(near[1]) * a;
    let lower = f32::from(near[width]) * (1.0 - a) + f32::from(near[width + 1]) * a;
    upper * (1.0 - b) + lower * b
}

#[cfg(test)]
mod tests {
    use image::GrayImage;

    use super::*;

    #[test]
    fn the_whole_part_equals_a_cast() {
        let some = (0..200_000).map(|k| k as f32 * 0.013).chain([0.0, 0.999_999_94, 1.0, 32_767.998, 8_388_607.0]);
        some.for_each(|v| assert_eq!(whole_part(v), v as i32, "{v}"));
    }

    #[test]
    fn a_row_of_texels_equals_single_lookups() {
        let picture = GrayImage::from_fn(53, 41, |x, y| image::Luma([(x * 37 + y * 91 + x * y) as u8]));
        let places: Vec<[f32; 2]> =
            (0..997).map(|k| [-3.0 + 0.0597 * k as f32, 46.0 - 0.0491 * k as f32]).chain([[f32::INFINITY, -1e30]]).collect();
        let [xs, ys] = [0, 1].map(|axis| places.iter().map(|place| place[axis]).collect::<Vec<_>>());
        let mut greys = vec![0.0; places.len()];
        let mut row = RowOfTexels::default();
        row.make_room(places.len());
        row.look(picture.as_raw(), [53, 41], &xs[..20], &ys[..20], &mut greys[..20]);
        row.look(picture.as_raw(), [53, 41], &xs, &ys, &mut greys);
        for ([x, y], grey) in places.iter().zip(&greys) {
            assert_eq!(*grey, bilinear(&picture, *x, *y), "{x} {y}");
        }
        let few: [[f32; 20]; 2] = [&xs, &ys].map(|all| std::array::from_fn(|k| all[40 * k]));
        assert_eq!(look_at(picture.as_raw(), [53, 41], &few[0], &few[1]), std::array::from_fn(|k| greys[40 * k]));
        // Where the lens has no ray.
        row.look(picture.as_raw(), [53, 41], &[f32::NAN], &[f32::NAN], &mut greys[..1]);
        assert_eq!(greys[0], f32::from(picture.get_pixel(0, 0)[0]));
    }
}
