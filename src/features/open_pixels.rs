//! Where corners are allowed: the mask of a picture, as seen by its pyramid levels.
//!
//! A level searches corners only in the columns of each row that may be open. To make this cheap,
//! the mask is divided into tiles once. A row searches the open tiles it is in, slightly more than
//! what is open; each corner is then checked individually.

use std::ops::Range;

use image::GrayImage;

use super::pyramid::Level;

/// Side of a tile, pixels. Chosen: about a vector register of pixels on the levels that take the
/// most time. Raised, more closed pixels are searched; lowered, rows are searched in more and
/// shorter pieces.
const TILE: usize = 16;
/// Maximum gap between two open parts of a row that is searched along with them, level pixels: the
/// number of pixels tested side by side. Raised, more closed pixels are searched.
const BRIDGED: usize = 32;

/// The mask of a picture in tiles; reuses its buffer.
#[derive(Debug, Clone, Default)]
pub struct OpenTiles {
    across: usize,
    down: usize,
    /// Whether any pixel of a tile is open, in reading order.
    is_open: Vec<bool>,
}

impl OpenTiles {
    /// Updates the tiles from a mask, which is open where it is not 0.
    pub fn update(&mut self, mask: &GrayImage) {
        let width = mask.width().max(1) as usize;
        (self.across, self.down) = (width.div_ceil(TILE), (mask.height() as usize).div_ceil(TILE));
        self.is_open.clear();
        self.is_open.resize(self.across * self.down, false);
        for (line, tiles) in mask.as_raw().chunks_exact(width).enumerate().map(|(y, line)| (line, y / TILE * self.across)) {
            let (whole, rest) = line.as_chunks::<TILE>();
            let tiles = &mut self.is_open[tiles..][..self.across];
            for (tile, pixels) in tiles.iter_mut().zip(whole) {
                *tile |= u128::from_ne_bytes(*pixels) != 0;
            }
            if let Some(last) = tiles.last_mut() {
                *last |= rest.iter().any(|v| *v != 0);
            }
        }
    }
}

/// The mask of a picture as seen by a level.
#[derive(Debug, Clone, Copy)]
pub struct LevelMask<'a> {
    /// Mask of the whole picture.
    pub mask: &'a GrayImage,
    /// Tiles of the mask.
    pub tiles: &'a OpenTiles,
    pub level: &'a Level,
}

/// Returns the picture column or row that contains the centre of a level's column or row.
fn place(at: u32, scale: f64) -> u32 {
    ((f64::from(at) + 0.5) / scale) as u32
}

/// The row of the mask that contains the centre of a level's row.
pub struct OpenRow<'a> {
    pixels: &'a [u8],
    columns: &'a [u32],
}

impl OpenRow<'_> {
    /// Whether a pixel of the row is open.
    pub fn is_open(&self, x: usize) -> bool {
        let column = self.columns.get(x).copied().unwrap_or(u32::MAX);
        self.pixels.get(column as usize).is_some_and(|pixel| *pixel > 0)
    }
}

impl LevelMask<'_> {
    /// Fills `columns` with the mask column that contains the centre of each column of the level.
    pub fn find_columns(&self, columns: &mut Vec<u32>) {
        columns.clear();
        columns.extend((0..self.level.image.width()).map(|x| place(x, self.level.scale[0])));
    }

    /// Returns which pixels of a row of the level are open. `columns`: see
    /// [`find_columns`](Self::find_columns).
    pub fn open_row<'a>(&'a self, y: u32, columns: &'a [u32]) -> OpenRow<'a> {
        let width = self.mask.width() as usize;
        let first = (place(y, self.level.scale[1]) as usize).saturating_mul(width);
        let pixels = self.mask.as_raw().get(first..first.saturating_add(width)).unwrap_or_default();
        OpenRow { pixels, columns }
    }

    /// Returns the tile rows that contain a row of the level and its neighbours above and below.
    pub fn tile_rows(&self, y: usize) -> Range<usize> {
        let row = |y: f64| ((y + 0.5) / self.level.scale[1]) as usize / TILE;
        row(y as f64 - 1.0)..(row(y as f64 + 1.0) + 1).min(self.tiles.down)
    }

    /// Fills `runs` with the columns of the level in open tiles of these rows, and their
    /// neighbours, from left to right.
    pub fn open_runs(&self, tile_rows: Range<usize>, columns: Range<usize>, runs: &mut Vec<Range<usize>>) {
        runs.clear();
        let OpenTiles { across, is_open, .. } = self.tiles;
        let is_open = |tile: usize| tile < *across && tile_rows.clone().any(|row| is_open[row * across + tile]);
        // A picture pixel belongs to a level's pixel within half a pixel of its place; one more for
        // its neighbours, and one for rounding.
        let place = |tile: usize| (TILE * tile) as f64 * self.level.scale[0] - 0.5;
        let mut tile = 0;
        while tile < *across {
            if !is_open(tile) {
                tile += 1;
                continue;
            }
            let first = ((place(tile) - 2.0).max(0.0) as usize).max(columns.start);
            while is_open(tile) {
                tile += 1;
            }
            let end = ((place(tile) + 3.0) as usize).min(columns.end);
            match runs.last_mut() {
                Some(run) if first <= run.end + BRIDGED => run.end = end.max(run.end),
                _ if first < end => runs.push(first..end),
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use image::Luma;
    use proptest::prelude::*;

    use super::super::pyramid::Pyramid;
    use super::*;

    proptest! {
        /// Every open pixel is in a run of its row and of the rows above and below, and so are its
        /// neighbours.
        #[test]
        fn runs_cover_every_open_pixel(size in (33u32..150, 33u32..90), open in proptest::collection::vec((0u32..150, 0u32..90), 0..6), factor in 1.05..1.9f64) {
            let mut mask = GrayImage::new(size.0, size.1);
            open.iter().for_each(|(x, y)| mask.put_pixel(x % size.0, y % size.1, Luma([255])));
            let mut tiles = OpenTiles::default();
            tiles.update(&mask);
            let (mut pyramid, mut runs, mut columns) = (Pyramid::default(), Vec::new(), Vec::new());
            for level in pyramid.build(&mask, factor, 4, 12) {
                let (w, h) = (level.image.width() as usize, level.image.height() as usize);
                let seen = LevelMask { mask: &mask, tiles: &tiles, level };
                seen.find_columns(&mut columns);
                for y in 0..h {
                    seen.open_runs(seen.tile_rows(y), 0..w, &mut runs);
                    prop_assert!(runs.iter().all(|run| run.start < run.end && run.end <= w));
                    prop_assert!(runs.windows(2).all(|two| two[0].end < two[1].start));
                    let is_in = |x: usize| runs.iter().any(|run| run.contains(&x));
                    for v in y.saturating_sub(1)..(y + 2).min(h) {
                        let open = seen.open_row(v as u32, &columns);
                        for x in (0..w).filter(|x| open.is_open(*x)) {
                            prop_assert!((x.saturating_sub(1)..(x + 2).min(w)).all(is_in), "{x}, {y} of {w} x {h}: {runs:?}");
                        }
                    }
                }
                let is_closed = open.is_empty();
                prop_assert!(!is_closed || runs.is_empty());
            }
        }
    }

    #[test]
    fn runs_skip_masked_pixels() {
        let mask = GrayImage::from_fn(320, 64, |x, y| Luma([u8::from((100..120).contains(&x) && y > 40)]));
        let (mut tiles, mut runs, mut pyramid) = (OpenTiles::default(), Vec::new(), Pyramid::default());
        tiles.update(&mask);
        let level = &pyramid.build(&mask, 1.2, 1, 12)[0];
        let seen = LevelMask { mask: &mask, tiles: &tiles, level };
        seen.open_runs(seen.tile_rows(50), 0..320, &mut runs);
        assert_eq!((runs.len(), &runs[0]), (1, &(93..130)));
        seen.open_runs(seen.tile_rows(20), 0..320, &mut runs);
        assert!(runs.is_empty());
    }
}
