//! A surface's picture as alignment reads it: its light, as square roots (see
//! [`square_root`](crate::light::square_root)).
//!
//! There are several levels: a copy at twice the size, the picture itself, and a chain of halved
//! copies. All are stored in tiles that each fill a cache line. For each level from the picture
//! itself on, the steepest texels are listed block by block: `pixels::selection` chooses from these
//! candidates.
//!
//! The enlarged copy makes linear interpolation accurate enough. Interpolating between the texels
//! of the picture itself would lose detail that the camera sees, and this loss, which varies from
//! place to place, would bias the pose.

use crate::track::align::tuning::TUNING;
use image::GrayImage;

use super::enlarge::Enlarged;
use crate::light::square_root::halved;
use crate::simd::multiversion;
use crate::track::align::lanes::{LANES, TILE_COLUMNS, TILE_ROWS, Tile};

/// Columns and rows from one tile to the next; neighbours share one column or one row.
pub const TILE_STEP: [usize; 2] = [TILE_COLUMNS - 1, TILE_ROWS - 1];
/// Side of a block of candidates, texels. Raised, the chosen pixels are spread less evenly;
/// lowered, more blocks are projected per frame.
pub const BLOCK: usize = 16;
/// Minimum gradient of a candidate, square roots per texel. Raised, soft pictures have too few
/// pixels; lowered, lists hold texels that are never taken.
const MIN_GRADIENT: f32 = 1.5;

/// All levels of a picture.
#[derive(Debug, Clone)]
pub struct Texture {
    /// Square root of the light of all levels, row of tiles by row of tiles. A tile starts
    /// [`TILE_STEP`] texels after its neighbour.
    pub tiles: Vec<Tile>,
    /// Byte address of each level's first texel; unused entries repeat the last level.
    pub base: [i32; LANES],
    /// Bytes per row of tiles of each level, minus the bytes of `TILE_STEP[1]` rows of a tile: an
    /// address also counts `TILE_COLUMNS` bytes for each row of the level above the texel's.
    pub stride: [i32; LANES],
    /// Texels of each level per pixel of the picture.
    pub scale: [f32; LANES],
    /// Largest column from which interpolation may start, per level.
    pub last_column: [f32; LANES],
    /// Largest row from which interpolation may start, per level.
    pub last_row: [f32; LANES],
    /// Number of levels in use.
    pub levels: usize,
    /// Candidates of each level; none for the enlarged copy.
    pub candidates: Vec<Candidates>,
}

/// The steepest texels of a level, block by block.
#[derive(Debug, Clone)]
pub struct Candidates {
    /// Blocks across.
    pub columns: usize,
    /// Blocks down.
    pub rows: usize,
    /// Where the candidates of block k start; one more entry than blocks.
    starts: Vec<u32>,
    /// Offsets (column, row) inside the block, steepest first.
    offsets: Vec<[u8; 2]>,
}

impl Candidates {
    fn none() -> Self {
        Self { columns: 0, rows: 0, starts: vec![0], offsets: Vec::new() }
    }

    /// Returns the offsets of the candidates inside block (column, row), steepest first.
    pub fn of_block(&self, column: usize, row: usize) -> &[[u8; 2]] {
        let k = row * self.columns + column;
        &self.offsets[self.starts[k] as usize..self.starts[k + 1] as usize]
    }
}

impl Texture {
    /// Prepares a picture of at least 16 x 16 pixels: square roots of its light.
    pub fn new(picture: &GrayImage) -> Self {
        let mut texture = Self {
            tiles: Vec::new(),
            base: [0; LANES],
            stride: [0; LANES],
            scale: [0.0; LANES],
            last_column: [0.0; LANES],
            last_row: [0.0; LANES],
            levels: 0,
            candidates: Vec::new(),
        };
        let own = [picture.width() as usize, picture.height() as usize];
        let is_enlarged = picture.width() * picture.height() <= TUNING.max_enlarged_px;
        let sizes = is_enlarged.then_some(own.map(|n| 2 * n)).into_iter().chain(halved_sizes(own)).take(LANES);
        texture.tiles.reserve_exact(sizes.map(|size| tiles_of(size).iter().product::<usize>()).sum());
        if is_enlarged {
            let mut enlarged = Enlarged::new(picture);
            // The enlarged copy has no candidates: pixels are chosen by texels of the picture
            // itself.
            texture.push(enlarged.size(), |j, row| enlarged.write_row(j, row), 2.0, Candidates::none());
        }
        let halves = std::iter::successors(Some(picture.clone()), |level| Some(halved(level)));
        let scales = std::iter::successors(Some(1.0), |scale| Some(0.5 * scale));
        for (([w, h], level), scale) in halved_sizes(own).zip(halves).zip(scales).take(LANES - texture.levels) {
            let raw = level.as_raw();
            texture.push([w, h], |j, row| row.copy_from_slice(&raw[j * w..][..w]), scale, candidates(raw, w, h));
        }
        for l in texture.levels..LANES {
            texture.base[l] = texture.base[l - 1];
            texture.stride[l] = texture.stride[l - 1];
            texture.scale[l] = texture.scale[l - 1];
            texture.last_column[l] = texture.last_column[l - 1];
            texture.last_row[l] = texture.last_row[l - 1];
        }
        texture
    }

    /// Returns the level that is the picture itself.
    pub fn own_level(&self) -> usize {
        usize::from(self.scale[0] > 1.0)
    }

    fn push(&mut self, [w, h]: [usize; 2], write_row: impl FnMut(usize, &mut [u8]), scale: f32, candidates: Candidates) {
        let l = self.levels;
        self.base[l] = size_of_val(&self.tiles[..]) as i32;
        self.stride[l] = push_tiles([w, h], write_row, &mut self.tiles);
        self.scale[l] = scale;
        (self.last_column[l], self.last_row[l]) = (w as f32 - 1.001, h as f32 - 1.001);
        self.candidates.push(candidates);
        self.levels += 1;
    }
}

/// Returns the sizes of a picture and its halved copies, down to `min_copy_side_texels`.
fn halved_sizes(own: [usize; 2]) -> impl Iterator<Item = [usize; 2]> {
    std::iter::successors(Some(own), |size| {
        let half = size.map(|n| n / 2);
        half.iter().all(|n| *n >= TUNING.min_copy_side_texels).then_some(half)
    })
}

/// Returns the number of tiles across and down that a picture is cut into.
fn tiles_of([w, h]: [usize; 2]) -> [usize; 2] {
    [(w - 1).div_ceil(TILE_STEP[0]), (h - 1).div_ceil(TILE_STEP[1])]
}

/// Cuts a picture, which is written row by row, into tiles. Returns [`Texture::stride`].
fn push_tiles([w, h]: [usize; 2], mut write_row: impl FnMut(usize, &mut [u8]), tiles: &mut Vec<Tile>) -> i32 {
    let [across, down] = tiles_of([w, h]);
    // Buffer for the rows of one row of tiles.
    let mut raw = vec![0; TILE_ROWS * w];
    for row in 0..down {
        let j = row * TILE_STEP[1];
        if row > 0 {
            raw.copy_within(TILE_STEP[1] * w.., 0);
        }
        for (k, out) in raw.chunks_exact_mut(w).enumerate().take(h - j).skip(usize::from(row > 0)) {
            write_row(j + k, out);
        }
        for column in 0..across {
            let mut tile = Tile([0; TILE_COLUMNS * TILE_ROWS]);
            let i = column * TILE_STEP[0];
            let n = TILE_COLUMNS.min(w - i);
            for (k, texels) in tile.0.chunks_exact_mut(TILE_COLUMNS).enumerate().take(h - j) {
                let source = &raw[k * w + i..][..n];
                // The compiler copies a chunk of constant size as one register.
                match source.first_chunk::<TILE_COLUMNS>() {
                    Some(full) => texels.copy_from_slice(full),
                    None => texels[..n].copy_from_slice(source),
                }
            }
            tiles.push(tile);
        }
    }
    (across * size_of::<Tile>()) as i32 - (TILE_STEP[1] * TILE_COLUMNS) as i32
}

/// Lists the steepest texels of a picture of `w` x `h`, block by block.
fn candidates(raw: &[u8], w: usize, h: usize) -> Candidates {
    let (columns, rows) = (w.div_ceil(BLOCK), h.div_ceil(BLOCK));
    let mut out = Candidates { columns, rows, starts: vec![0], offsets: Vec::new() };
    // One row of blocks, padded where the picture ends inside a block.
    let stride = columns * BLOCK;
    let mut steepness = vec![0u32; stride * BLOCK];
    let mut ranking = Ranking::new();
    for row in 0..rows {
        for (own, j) in steepness.chunks_exact_mut(stride).zip(row * BLOCK..) {
            let line = |j: usize| &raw[j * w..][..w];
            // The outermost rows and columns have no central differences.
            if j == 0 || j + 1 >= h || w < 3 {
                own.fill(0);
            } else {
                steepness_of([line(j - 1), line(j), line(j + 1)], &mut own[1..w - 1]);
            }
        }
        for column in 0..columns {
            let block = std::array::from_fn(|dy| &steepness[dy * stride + column * BLOCK..][..BLOCK]);
            ranking.append_steepest(block, &mut out.offsets);
            out.starts.push(out.offsets.len() as u32);
        }
    }
    out
}

multiversion! {
    /// Computes four times the squared gradient for the middle one of three rows, without its ends.
    fn steepness_of(rows: [&[u8]; 3], out: &mut [u32]); ["avx2"] => steepness_of_plain, else steepness_of_plain
}

#[inline(always)]
fn steepness_of_plain([above, here, below]: [&[u8]; 3], out: &mut [u32]) {
    let n = out.len();
    let [left, right, above, below] = [&here[..n], &here[2..][..n], &above[1..][..n], &below[1..][..n]];
    for (k, out) in out.iter_mut().enumerate() {
        let x = i32::from(right[k]) - i32::from(left[k]);
        let y = i32::from(below[k]) - i32::from(above[k]);
        *out = (x * x + y * y) as u32;
    }
}

/// Bits of a sort key that hold the texel; they number all texels of a block.
const TEXEL_BITS: u32 = 8;
const TEXELS: usize = 1 << TEXEL_BITS;
const _: () = assert!(BLOCK * BLOCK == TEXELS);

/// Ranks the texels of a block; reuses its buffers.
#[derive(Debug, Clone)]
struct Ranking {
    /// Sort keys: four times the squared gradient, above a texel number that puts ties in column
    /// order.
    keys: [u32; TEXELS],
    sorted: [u32; TEXELS],
    /// Start of each bucket among the sorted keys; its end, once all keys are placed.
    ends: [u32; BUCKETS],
}

impl Ranking {
    fn new() -> Self {
        Self { keys: [0; TEXELS], sorted: [0; TEXELS], ends: [0; BUCKETS] }
    }

    /// Appends the texels that are steep enough, steepest first. A bucket sort by rough steepness
    /// comes first, and only buckets whose texels are kept are sorted.
    fn append_steepest(&mut self, block: [&[u32]; BLOCK], offsets: &mut Vec<[u8; 2]>) {
        // [`MIN_GRADIENT`] in the unit of the keys.
        const LEAST: u32 = (4.0 * MIN_GRADIENT * MIN_GRADIENT) as u32;
        let Self { keys, sorted, ends } = self;
        let mut count = 0;
        ends.fill(0);
        for (dy, row) in block.into_iter().enumerate() {
            for (dx, n) in row.iter().enumerate().take(BLOCK) {
                // The next key overwrites one that is not steep.
                keys[count] = (n << TEXEL_BITS) | (TEXELS - 1 - (dx * BLOCK + dy)) as u32;
                let is_steep = *n >= LEAST;
                ends[bucket(*n)] += u32::from(is_steep);
                count += usize::from(is_steep);
            }
        }
        let keys = &keys[..count];
        let mut sum = 0;
        for end in ends.iter_mut().rev() {
            sum += std::mem::replace(end, sum);
        }
        for key in keys {
            let place = &mut ends[bucket(key >> TEXEL_BITS)];
            sorted[*place as usize] = *key;
            *place += 1;
        }
        let mut first = 0;
        for end in ends.iter().rev().map(|end| *end as usize) {
            if first >= TUNING.candidates_per_block {
                break;
            }
            if end > first + 1 {
                sorted[first..end].sort_unstable_by(|a, b| b.cmp(a));
            }
            first = end;
        }
        for key in &sorted[..count.min(TUNING.candidates_per_block)] {
            let k = TEXELS - 1 - (*key as usize & (TEXELS - 1));
            offsets.push([(k / BLOCK) as u8, (k % BLOCK) as u8]);
        }
    }
}

/// Returns the bucket of a steepness: sixteen per doubling, the steepest last. Most hold one or two
/// texels of a block.
fn bucket(steepness: u32) -> usize {
    (((steepness as f32).to_bits() >> BUCKET_SHIFT) as usize).saturating_sub(BUCKETS_BELOW)
}

/// Low bits of a float that do not select its bucket.
const BUCKET_SHIFT: u32 = 19;
/// Number of the bucket of a steepness of 1 before the shift to 0, and the number of buckets for
/// all differences of 8 bits in two directions.
const BUCKETS_BELOW: usize = (1.0f32.to_bits() >> BUCKET_SHIFT) as usize;
const BUCKETS: usize = ((2.0 * 255.0 * 255.0f32).to_bits() >> BUCKET_SHIFT) as usize - BUCKETS_BELOW + 1;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_hold_their_steepest_texels() {
        let picture = GrayImage::from_fn(50, 40, |x, y| image::Luma([if x < 21 { 10 } else { 200 } + (y % 2) as u8]));
        let t = Texture::new(&picture);
        assert_eq!((t.scale[0], t.scale[1], t.scale[2]), (2.0, 1.0, 0.5));
        // The edge between columns 20 and 21 lies in the second column of blocks.
        let steepest = t.candidates[1].of_block(1, 1);
        assert!(steepest[..8].iter().all(|o| o[0] == 4 || o[0] == 5), "{steepest:?}");
        assert!(t.candidates[1].of_block(0, 1).is_empty());
    }

    #[test]
    fn a_texel_and_its_neighbours_are_stored_at_its_address() {
        let picture = GrayImage::from_fn(50, 40, |x, y| image::Luma([(x * 5 + y * 3 + x * y % 7) as u8]));
        let t = Texture::new(&picture);
        let bytes: Vec<u8> = t.tiles.iter().flat_map(|tile| tile.0).collect();
        for (i, j) in (0..49).flat_map(|i| (0..39).map(move |j| (i, j))) {
            let (column, row) = (i / TILE_STEP[0], j / TILE_STEP[1]);
            let in_row = column * (size_of::<Tile>() - TILE_STEP[0]) + TILE_COLUMNS * j + i;
            let at = t.base[1] as usize + row * t.stride[1] as usize + in_row;
            let expected = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(a, b)| picture.get_pixel(i as u32 + a, j as u32 + b)[0]);
            assert_eq!([bytes[at], bytes[at + 1], bytes[at + TILE_COLUMNS], bytes[at + TILE_COLUMNS + 1]], expected, "{i} {j}");
        }
    }

    #[test]
    fn the_steepest_texels_of_a_block_match_a_sort() {
        for seed in [3u32, 8, 21] {
            // Small ranges of grey too, so that many texels are equally steep.
            let grey = |x: u32, y: u32| (x.wrapping_mul(2_654_435_761) ^ y.wrapping_mul(40_503).wrapping_mul(seed) ^ (x * y)) >> 7;
            let picture = GrayImage::from_fn(53, 41, |x, y| image::Luma([(grey(x, y) % (5 + 12 * seed)) as u8]));
            let found = candidates(picture.as_raw(), 53, 41);
            for (k, (column, row)) in (0..found.rows).flat_map(|row| (0..found.columns).map(move |column| (column, row))).enumerate() {
                let mut expected = Vec::new();
                for (dx, dy) in (0..BLOCK).flat_map(|dx| (0..BLOCK).map(move |dy| (dx, dy))) {
                    let [x, y] = [column * BLOCK + dx, row * BLOCK + dy].map(|v| v as u32);
                    if x == 0 || y == 0 || x + 1 >= 53 || y + 1 >= 41 {
                        continue;
                    }
                    let at = |x: u32, y: u32| i32::from(picture.get_pixel(x, y)[0]);
                    let squared = (at(x + 1, y) - at(x - 1, y)).pow(2) + (at(x, y + 1) - at(x, y - 1)).pow(2);
                    if squared as f32 >= 4.0 * MIN_GRADIENT.powi(2) {
                        expected.push((squared, [dx as u8, dy as u8]));
                    }
                }
                expected.sort_by_key(|(squared, offset)| (-squared, *offset));
                let expected: Vec<[u8; 2]> = expected.iter().take(TUNING.candidates_per_block).map(|e| e.1).collect();
                assert_eq!(found.of_block(column, row), expected, "block {k}");
            }
        }
    }
}
