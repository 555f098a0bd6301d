//! A surface's picture as alignment reads it: a copy of twice the size, the picture, and a chain of halved copies,
//! and for each the texels with the steepest grey, block by block.
//!
//! The enlarged copy makes linear interpolation good enough: between the texels of the picture itself it would lose
//! detail that the camera sees, and those losses, other at every place, pull at the pose.

use image::GrayImage;
use image::imageops::{self, FilterType};

use super::lanes::LANES;
use crate::track::reference::halved;

/// Side of a block of texels that candidates are chosen from.
pub const BLOCK: usize = 16;
/// Candidates kept per block.
const KEPT: usize = 160;
/// Pictures of more pixels are not enlarged.
const LARGEST_ENLARGED: u32 = 6_000_000;
/// Least grey difference per texel of a candidate.
const LEAST_GRADIENT: f32 = 1.5;
/// The chain ends when a side falls below this.
const LEAST_SIDE: u32 = 8;

/// All levels of a picture.
#[derive(Debug, Clone)]
pub struct Texture {
    /// Grey of all levels, row by row.
    pub texels: Vec<u8>,
    /// Where each level starts in `texels`; unused entries repeat the last.
    pub base: [i32; LANES],
    /// Texels per row of each level.
    pub stride: [i32; LANES],
    /// Texels of each level by pixels of the picture.
    pub scale: [f32; LANES],
    /// Largest column and row that interpolation may start from, in each level.
    pub last_column: [f32; LANES],
    /// See `last_column`.
    pub last_row: [f32; LANES],
    /// Levels in use.
    pub levels: usize,
    /// Candidates of each level.
    pub candidates: Vec<Candidates>,
}

/// The steepest texels of a level, block by block.
#[derive(Debug, Clone)]
pub struct Candidates {
    /// Blocks across.
    pub columns: usize,
    /// Blocks down.
    pub rows: usize,
    /// Where the candidates of block k start; one entry more than blocks.
    starts: Vec<u32>,
    /// Offsets inside the block, steepest first.
    offsets: Vec<[u8; 2]>,
}

impl Candidates {
    fn none() -> Self {
        Self { columns: 0, rows: 0, starts: vec![0], offsets: Vec::new() }
    }

    /// The offsets of block (column, row) inside it, steepest first.
    pub fn of_block(&self, column: usize, row: usize) -> &[[u8; 2]] {
        let k = row * self.columns + column;
        &self.offsets[self.starts[k] as usize..self.starts[k + 1] as usize]
    }
}

impl Texture {
    /// Prepares a picture of at least 16 x 16 pixels.
    pub fn new(picture: &GrayImage) -> Self {
        let mut texture = Self {
            texels: Vec::new(),
            base: [0; LANES],
            stride: [0; LANES],
            scale: [0.0; LANES],
            last_column: [0.0; LANES],
            last_row: [0.0; LANES],
            levels: 0,
            candidates: Vec::new(),
        };
        if picture.width() * picture.height() <= LARGEST_ENLARGED {
            let enlarged = imageops::resize(picture, 2 * picture.width(), 2 * picture.height(), FilterType::Lanczos3);
            texture.push(&enlarged, 2.0);
        }
        let mut level = picture.clone();
        let mut scale = 1.0;
        while texture.levels < LANES {
            texture.push(&level, scale);
            scale *= 0.5;
            if level.width() / 2 < LEAST_SIDE || level.height() / 2 < LEAST_SIDE {
                break;
            }
            level = halved(&level);
        }
        for l in texture.levels..LANES {
            texture.base[l] = texture.base[l - 1];
            texture.stride[l] = texture.stride[l - 1];
            texture.scale[l] = texture.scale[l - 1];
            texture.last_column[l] = texture.last_column[l - 1];
            texture.last_row[l] = texture.last_row[l - 1];
        }
        // Interpolation reads four bytes at a time.
        texture.texels.extend([0; 4]);
        texture
    }

    /// The level that is the picture itself.
    pub fn own_level(&self) -> usize {
        usize::from(self.scale[0] > 1.0)
    }

    fn push(&mut self, level: &GrayImage, scale: f32) {
        let (w, h) = (level.width() as usize, level.height() as usize);
        let l = self.levels;
        self.base[l] = self.texels.len() as i32;
        self.stride[l] = w as i32;
        self.scale[l] = scale;
        (self.last_column[l], self.last_row[l]) = (w as f32 - 1.001, h as f32 - 1.001);
        self.texels.extend_from_slice(level.as_raw());
        let raw = level.as_raw();
        // Pixels are never chosen by texels that the picture does not have.
        self.candidates.push(if scale > 1.0 { Candidates::none() } else { candidates(raw, w, h) });
        self.levels += 1;
    }
}

fn candidates(raw: &[u8], w: usize, h: usize) -> Candidates {
    let (columns, rows) = (w.div_ceil(BLOCK), h.div_ceil(BLOCK));
    let mut out = Candidates { columns, rows, starts: vec![0], offsets: Vec::new() };
    let mut ranked: Vec<(f32, [u8; 2])> = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            ranked.clear();
            for dy in 0..BLOCK {
                for dx in 0..BLOCK {
                    let (i, j) = (column * BLOCK + dx, row * BLOCK + dy);
                    if i == 0 || j == 0 || i + 1 >= w || j + 1 >= h {
                        continue;
                    }
                    let at = j * w + i;
                    let gx = 0.5 * (f32::from(raw[at + 1]) - f32::from(raw[at - 1]));
                    let gy = 0.5 * (f32::from(raw[at + w]) - f32::from(raw[at - w]));
                    let squared = gx * gx + gy * gy;
                    if squared >= LEAST_GRADIENT * LEAST_GRADIENT {
                        ranked.push((squared, [dx as u8, dy as u8]));
                    }
                }
            }
            ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            out.offsets.extend(ranked.iter().take(KEPT).map(|r| r.1));
            out.starts.push(out.offsets.len() as u32);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_hold_their_steepest_texels() {
        let picture = GrayImage::from_fn(50, 40, |x, y| image::Luma([if x < 21 { 10 } else { 200 } + (y % 2) as u8]));
        let t = Texture::new(&picture);
        assert_eq!((t.scale[0], t.scale[1], t.scale[2], t.stride[0], t.stride[1]), (2.0, 1.0, 0.5, 100, 50));
        assert_eq!(t.texels[t.base[1] as usize + 7 * 50 + 20], 11);
        // The edge between columns 20 and 21 lies in the second column of blocks.
        let steepest = t.candidates[1].of_block(1, 1);
        assert!(steepest[..8].iter().all(|o| o[0] == 4 || o[0] == 5), "{steepest:?}");
        assert!(t.candidates[1].of_block(0, 1).is_empty());
    }
}
