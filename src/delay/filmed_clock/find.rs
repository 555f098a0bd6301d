//! Finds the code in a picture: a dark ring with white on both of its sides, and the mark that
//! tells which corner is the top left one.

use image::GrayImage;
use nalgebra::Vector2;

use super::layout::{SIZE, margin_points, mark_centre, ring_centres};
use crate::geometry::robust_kernel::median;
use crate::geometry::{Homography, PointPair};

/// Sides of the windows over which brightness is averaged, as shares of the picture's width: for
/// codes that fill the picture, then for small ones in a dark room. Raised, the latter are missed;
/// lowered, the wide rings of the former.
const WINDOW_SHARES: [f64; 2] = [0.25, 0.06];
/// Brightness of a dark pixel relative to the mean around it. Raised, shadows count as dark;
/// lowered, rings on dim screens break.
const DARK_RATIO: f64 = 0.8;
/// Minimum width and height of the ring, pixels: three for a cell. Lowered, cells cannot be read.
const MIN_RING_PX: [u32; 2] = [54, 24];
/// Maximum number of dark regions that are examined, largest first. Raised, cluttered pictures take
/// longer.
const MAX_REGIONS: usize = 40;
/// Minimum difference between white and black cells, grey levels. Lowered, noise is read.
pub const MIN_CONTRAST: f64 = 12.0;
/// Minimum share of the cells of both rings that are as they should be. Lowered, windows and
/// picture frames pass for the code.
const MIN_RING_SHARE: f64 = 0.9;

/// Where a picture shows the code.
#[derive(Debug, Clone)]
pub struct Placed {
    from_cells: Homography,
    /// Grey levels of black and white cells.
    pub levels: [f64; 2],
}

impl Placed {
    /// Returns the mean grey level around a point of the code, in cells from its top left corner;
    /// `None` outside the picture.
    pub fn level(&self, image: &GrayImage, centre: Vector2<f64>) -> Option<f64> {
        let steps = [-0.24, -0.12, 0.0, 0.12, 0.24];
        let mut sum = 0.0;
        for (dx, dy) in steps.into_iter().flat_map(|dx| steps.map(|dy| (dx, dy))) {
            let at = self.from_cells.map(centre + Vector2::new(dx, dy))?;
            let is_inside = at.x > -0.5 && at.y > -0.5 && at.x < f64::from(image.width()) - 0.5 && at.y < f64::from(image.height()) - 0.5;
            sum += if is_inside { f64::from(image.get_pixel(at.x.round() as u32, at.y.round() as u32)[0]) } else { return None };
        }
        Some(sum / 25.0)
    }

    /// Returns the row of the picture on which a point of the code lies.
    pub fn row_px(&self, centre: Vector2<f64>) -> Option<f64> {
        Some(self.from_cells.map(centre)?.y)
    }

    /// Judges four corners, clockwise from the code's top left one.
    fn at(corners: [Vector2<f64>; 4], image: &GrayImage) -> Option<Self> {
        let [width, height] = SIZE.map(|size| size as f64);
        let ends = [[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]].map(Vector2::from);
        let pairs = [0, 1, 2, 3].map(|k| PointPair { from: ends[k], to: corners[k] });
        let from_cells = Homography::from_four(&pairs).filter(Homography::keeps_orientation)?;
        let mut placed = Self { from_cells, levels: [0.0; 2] };
        let levels = |inset: usize| -> Option<Vec<f64>> { ring_centres(inset).map(|centre| placed.level(image, centre)).collect() };
        let (black, white) = (levels(0)?, levels(1)?);
        let found = [median(&mut black.clone())?, median(&mut white.clone())?];
        let middle = 0.5 * (found[0] + found[1]);
        let margin = margin_points().filter(|at| placed.level(image, *at).is_some_and(|level| level > middle)).count();
        let is_framed = margin as f64 >= MIN_RING_SHARE * margin_points().count() as f64;
        let right = black.iter().filter(|v| **v < middle).count() + white.iter().filter(|v| **v > middle).count();
        let is_ring = right as f64 >= MIN_RING_SHARE * (black.len() + white.len()) as f64;
        let is_upright = placed.level(image, mark_centre())? < middle;
        placed.levels = found;
        (found[1] - found[0] > MIN_CONTRAST && is_ring && is_framed && is_upright).then_some(placed)
    }
}

/// Returns where a picture shows the code, if it does.
pub fn find_code(image: &GrayImage) -> Option<Placed> {
    let turned = |corners: [Vector2<f64>; 4], by: usize| [0, 1, 2, 3].map(|k| corners[(k + by) % 4]);
    WINDOW_SHARES.iter().find_map(|share| {
        let mut regions = dark_regions(image, *share);
        regions.sort_by_key(|region| std::cmp::Reverse(region.pixels));
        regions.iter().take(MAX_REGIONS).find_map(|region| (0..4).find_map(|by| Placed::at(turned(region.corners(), by), image)))
    })
}

/// A connected region of dark pixels.
#[derive(Debug, Clone, Copy)]
struct Region {
    pixels: usize,
    /// The pixels farthest to the top left, top right, bottom right and bottom left.
    farthest: [[i64; 2]; 4],
}

impl Region {
    fn new(at: [i64; 2]) -> Self {
        Self { pixels: 0, farthest: [at; 4] }
    }

    fn add(&mut self, [x, y]: [i64; 2]) {
        self.pixels += 1;
        let towards = [[-1, -1], [1, -1], [1, 1], [-1, 1]];
        for (farthest, [right, down]) in self.farthest.iter_mut().zip(towards) {
            if right * x + down * y > right * farthest[0] + down * farthest[1] {
                *farthest = [x, y];
            }
        }
    }

    /// Returns its corners, at the outer edges of its pixels, clockwise from the top left.
    fn corners(&self) -> [Vector2<f64>; 4] {
        let outwards = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
        [0, 1, 2, 3].map(|k| Vector2::from(self.farthest[k].map(|v| v as f64)) + Vector2::from(outwards[k]))
    }

    fn is_large(&self) -> bool {
        let [left_top, right_top, _, left_bottom] = self.farthest;
        let length = |a: [i64; 2], b: [i64; 2]| ((a[0] - b[0]) as f64).hypot((a[1] - b[1]) as f64);
        let sides = [length(left_top, right_top), length(left_top, left_bottom)];
        sides[0].max(sides[1]) >= f64::from(MIN_RING_PX[0]) && sides[0].min(sides[1]) >= f64::from(MIN_RING_PX[1])
    }
}

/// Returns the connected regions of dark pixels that are large enough.
fn dark_regions(image: &GrayImage, window_share: f64) -> Vec<Region> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let mut open = dark_pixels(image, window_share);
    let (mut regions, mut stack) = (Vec::new(), Vec::new());
    for first in 0..open.len() {
        if !open[first] {
            continue;
        }
        let mut region = Region::new([(first % width) as i64, (first / width) as i64]);
        open[first] = false;
        stack.push(first);
        while let Some(k) = stack.pop() {
            let (x, y) = (k % width, k / width);
            region.add([x as i64, y as i64]);
            let neighbours =
                [(x > 0, k.wrapping_sub(1)), (x + 1 < width, k + 1), (y > 0, k.wrapping_sub(width)), (y + 1 < height, k + width)];
            for (is_inside, neighbour) in neighbours {
                if is_inside && std::mem::take(&mut open[neighbour]) {
                    stack.push(neighbour);
                }
            }
        }
        if region.is_large() {
            regions.push(region);
        }
    }
    regions
}

/// Returns whether each pixel is darker than the window around it.
fn dark_pixels(image: &GrayImage, window_share: f64) -> Vec<bool> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let half = ((window_share * 0.5 * width as f64) as usize).max(4);
    // Sums over everything above and left of each corner of a pixel.
    let mut sums = vec![0_u64; (width + 1) * (height + 1)];
    for y in 0..height {
        let mut row = 0;
        for x in 0..width {
            row += u64::from(image.as_raw()[y * width + x]);
            sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
        }
    }
    let sum_to = |x: usize, y: usize| sums[y * (width + 1) + x];
    let mut dark = Vec::with_capacity(width * height);
    for y in 0..height {
        let (top, bottom) = (y.saturating_sub(half), (y + half + 1).min(height));
        for x in 0..width {
            let (left, right) = (x.saturating_sub(half), (x + half + 1).min(width));
            let sum = sum_to(right, bottom) + sum_to(left, top) - sum_to(left, bottom) - sum_to(right, top);
            let mean = sum as f64 / ((right - left) * (bottom - top)) as f64;
            dark.push(f64::from(image.as_raw()[y * width + x]) < DARK_RATIO * mean);
        }
    }
    dark
}
