//! Finds the parts of a frame that no followed body explains: where a missing body can be.
//!
//! Once the stage's pose is known, so is what each pixel should show of it. Where the frame shows
//! that, nothing else can stand; elsewhere there is a prop, a person or a missing body. A prop
//! covers a hundredth of the frame, and of 1500 features spread over the whole frame a dozen fall
//! on it: too few to find it. Searching only the unexplained part yields hundreds, including its
//! faint corners, and a fully explained frame costs no search.
//!
//! Per frame: `expected_view` renders the known surfaces, the frame is compared with it,
//! `unexplained_cells` forms regions, `search_windows` chooses what to search. The comparison uses
//! a quarter of the frame's size, every second row, in squares of [`CELL_SIDE`] pixels, and is
//! invariant to gain and bias, as light may change.

use crate::track::acquire::tuning::TUNING;
use image::GrayImage;
use nalgebra::Vector2;

use super::expected_view::{ExpectedView, ROW_STEP};
use super::search_windows::{Extent, SearchWindows, Window};
use super::unexplained_cells::{CELL_SIDE_PX, UnexplainedCells};
use crate::features::{ExtractorOptions, Feature, FeatureExtractor, Workers};
use crate::geometry::{Body, Camera, Pose};
use crate::simd::multiversion;
use crate::track::align::{CameraRays, FrameLevels};
use crate::track::scene::reference::PreparedBody;

/// The level that is compared: a quarter of the frame's size. Raised, small props vanish in it;
/// lowered, the comparison costs four times as much.
const COMPARED_LEVEL: usize = 2;
/// Side of a cell, pixels of the level; follows from [`CELL_SIDE_PX`]. Three by three cells are
/// judged together.
const CELL_SIDE: usize = (CELL_SIDE_PX >> COMPARED_LEVEL) as usize;
/// Compared rows per cell.
const COMPARED_ROWS: usize = CELL_SIDE / ROW_STEP;
/// Minimum pixels of three by three cells to judge them. Raised, props at the border of the stage
/// are overlooked; lowered, a few pixels decide.
const MIN_JUDGED: f32 = (9 * CELL_SIDE * COMPARED_ROWS / 4) as f32;

/// A part of the frame that no followed body explains.
#[derive(Debug, Clone, Default)]
struct Region {
    /// First column and row of its bounding box, pixels of the frame.
    origin: [u32; 2],
    /// Mask of the bounding box: 255 where unexplained, 0 elsewhere.
    mask: GrayImage,
    /// Number of its cells.
    cells: usize,
}

impl Region {
    fn size(&self) -> [u32; 2] {
        [self.mask.width(), self.mask.height()]
    }

    /// Copies a window of the frame, and of the region's mask combined with the frame's own mask
    /// `closed`.
    fn cut_out(&self, window: &Window, frame: &GrayImage, closed: Option<&GrayImage>, picture: &mut GrayImage, mask: &mut GrayImage) {
        let [width, height] = window.size;
        let row_of = |image: &'_ GrayImage, [x, y]: [u32; 2], v: u32| -> std::ops::Range<usize> {
            let first = (y + v) as usize * image.width() as usize + x as usize;
            first..first + width as usize
        };
        let in_region = [0, 1].map(|k| window.origin[k] - self.origin[k]);
        let copy = |from: &GrayImage, origin: [u32; 2], to: &mut Vec<u8>| {
            to.clear();
            (0..height).for_each(|v| to.extend_from_slice(&from.as_raw()[row_of(from, origin, v)]));
        };
        let mut raw = std::mem::take(picture).into_raw();
        copy(frame, window.origin, &mut raw);
        // The length always matches, one byte per pixel; here and below.
        *picture = GrayImage::from_raw(width, height, raw).unwrap_or_default();
        let mut raw = std::mem::take(mask).into_raw();
        copy(&self.mask, in_region, &mut raw);
        if let Some(closed) = closed {
            for (v, own) in raw.chunks_exact_mut(width.max(1) as usize).enumerate() {
                let seen = &closed.as_raw()[row_of(closed, window.origin, v as u32)];
                own.iter_mut().zip(seen).for_each(|(open, seen)| *open &= seen);
            }
        }
        *mask = GrayImage::from_raw(width, height, raw).unwrap_or_default();
    }
}

/// Finds the unexplained parts; keeps its buffers between frames.
#[derive(Debug, Default)]
pub struct Unexplained {
    expected: ExpectedView,
    /// For a row of cells, sums over its rows of pixels, per column; as in [`Moments`].
    columns: [Vec<f32>; SUM_COUNT],
    moments: Vec<Moments>,
    /// Sums over three rows of cells.
    triples: Vec<Moments>,
    /// Whether each cell is unexplained.
    open: Vec<bool>,
    cells: UnexplainedCells,
    regions: Vec<Region>,
    windows: SearchWindows,
    /// See [`search_first`](Self::search_first).
    expected_places: Vec<Extent>,
    /// The picture, the mask and the features of one window.
    picture: GrayImage,
    mask: GrayImage,
    features: Vec<Feature>,
}

/// Sums over the pixels of a cell. Of those covered by a surface: count, grey, grey squared,
/// prediction, prediction squared, product. Of the others: count, grey, grey squared.
#[derive(Debug, Clone, Copy, Default)]
struct Moments([f32; SUM_COUNT]);

/// Number of sums: six of covered pixels and three of open ones.
const SUM_COUNT: usize = 9;

impl Moments {
    fn add(&mut self, other: &Self) {
        self.0.iter_mut().zip(other.0).for_each(|(sum, more)| *sum += more);
    }

    /// Whether the cells show detail that differs from the expected surfaces, or detail where no
    /// surface is expected.
    fn is_unexplained(&self) -> bool {
        let has_detail = |n: f32, s: f32, ss: f32| n >= MIN_JUDGED && ss / n - (s / n).powi(2) > TUNING.min_searched_contrast.powi(2);
        let [n, s, ss, p, pp, sp, m, t, tt] = self.0;
        let differs = || {
            let (seen, expected, both) = (ss - s * s / n, pp - p * p / n, sp - s * p / n);
            both <= 0.0 || both * both < TUNING.min_explained_correlation.powi(2) * seen * expected
        };
        has_detail(m, t, tt) || (has_detail(n, s, ss) && differs())
    }
}

multiversion! {
    /// Adds a row of pixels to the sums of its columns, except at its ends and at edges between
    /// surfaces, where a pixel shows both sides. `owners`: of the row above, this one and the one
    /// below.
    fn add_row(seen: &[u16], expected: &[f32], owners: [&[u16]; 3], columns: &mut [Vec<f32>; SUM_COUNT]); ["avx2"] => add_row_plain, else add_row_plain
}

#[inline(always)]
fn add_row_plain(seen: &[u16], expected: &[f32], owners: [&[u16]; 3], columns: &mut [Vec<f32>; SUM_COUNT]) {
    let n = seen.len().saturating_sub(2);
    let [above, here, below] = owners;
    let (left, right, own) = (&here[..n], &here[2..][..n], &here[1..][..n]);
    let (above, below, seen, expected) = (&above[1..][..n], &below[1..][..n], &seen[1..][..n], &expected[1..][..n]);
    let [c, s, ss, p, pp, sp, m, t, tt] = columns.each_mut().map(|sums| &mut sums[1..][..n]);
    for u in 0..n {
        let owner = own[u];
        let is_inside = (left[u] == owner) & (right[u] == owner) & (above[u] == owner) & (below[u] == owner);
        let covered = if is_inside & (owner > 0) { 1.0 } else { 0.0 };
        let open = if is_inside & (owner == 0) { 1.0 } else { 0.0 };
        let (grey, prediction) = (f32::from(seen[u]) * GREY_PER_SUM, expected[u]);
        c[u] += covered;
        s[u] += covered * grey;
        ss[u] += covered * grey * grey;
        p[u] += covered * prediction;
        pp[u] += covered * prediction * prediction;
        sp[u] += covered * grey * prediction;
        m[u] += open;
        t[u] += open * grey;
        tt[u] += open * grey * grey;
    }
}

/// Factor from the level's pixel sums to grey values.
const GREY_PER_SUM: f32 = 1.0 / (1u32 << (2 * COMPARED_LEVEL)) as f32;

impl Unexplained {
    /// Compares a frame with the bodies known to be at these poses; each with the number of its
    /// first surface among all.
    pub fn look<'a>(
        &mut self,
        known: impl Iterator<Item = (u32, &'a PreparedBody, Pose<Body, Camera>)>,
        levels: &mut FrameLevels,
        rays: &CameraRays,
    ) {
        self.expected.clear(rays, COMPARED_LEVEL);
        for (first, body, pose) in known {
            (first as usize..).zip(&body.surfaces).for_each(|(number, surface)| self.expected.draw(number, surface, &pose, rays));
        }
        self.compare(levels.level(COMPARED_LEVEL).sums());
        self.cells.number_regions();
        self.collect_regions([rays.camera().width(), rays.camera().height()]);
    }

    /// Whether anything of the last frame is unexplained.
    pub fn is_anything(&self) -> bool {
        !self.regions.is_empty()
    }

    /// Returns the mask of the unexplained parts of the last frame, at the frame's size: 255 there,
    /// 0 elsewhere. `closed`: the frame's own mask.
    pub fn mask(&mut self, [width, height]: [u32; 2], closed: Option<&GrayImage>) -> &GrayImage {
        let mut raw = std::mem::take(&mut self.mask).into_raw();
        raw.clear();
        raw.resize(width as usize * height as usize, 0);
        for Region { origin, mask, .. } in &self.regions {
            let columns = origin[0] as usize..(origin[0] + mask.width()) as usize;
            for (open, y) in mask.as_raw().chunks_exact(mask.width().max(1) as usize).zip(origin[1] as usize..) {
                let row = &mut raw[y * width as usize..][columns.clone()];
                row.iter_mut().zip(open).for_each(|(own, open)| *own |= open);
            }
        }
        if let Some(closed) = closed {
            raw.iter_mut().zip(closed.as_raw()).for_each(|(own, seen)| *own &= seen);
        }
        // The length always matches, one byte per pixel.
        self.mask = GrayImage::from_raw(width, height, raw).unwrap_or_default();
        &self.mask
    }

    /// Makes the next search start at one of these places, where recently lost bodies are
    /// predicted.
    pub fn search_first(&mut self, expected_places: impl Iterator<Item = Extent>) {
        self.expected_places.clear();
        self.expected_places.extend(expected_places);
    }

    /// Extracts about `count` features at most from the unexplained regions of the last frame; if
    /// they are large, from their most urgent parts. `closed`: the frame's own mask.
    pub fn extract(
        &mut self,
        frame: &GrayImage,
        closed: Option<&GrayImage>,
        count: usize,
        extractor: &mut FeatureExtractor,
        workers: &Workers,
        features: &mut Vec<Feature>,
    ) {
        features.clear();
        let Self { regions, windows, cells, expected_places, picture, mask, features: own, .. } = self;
        let extents = || regions.iter().map(|r| [r.origin, [0, 1].map(|k| r.origin[k] + r.size()[k])]);
        let expected = windows.begin_slice(extents(), expected_places.iter().copied(), |window| cells.content(window));
        // Their cells must not also be urgent in the general search.
        expected.iter().for_each(|window| cells.note_searched(window));
        let expected = expected.first().copied();
        let slice = windows.fill_slice(extents(), |window| cells.content(window));
        slice.iter().for_each(|window| cells.note_searched(window));
        // A small region gets more than its proportional part: its content is seen small and has
        // the fewest corners.
        let weight = |window: &Window| {
            let region = &regions[window.region];
            let whole: u64 = region.size().iter().map(|n| u64::from(*n)).product();
            let part = (region.cells as f64 * window.area() as f64 / whole as f64).sqrt();
            if expected == Some(*window) { TUNING.predicted_window_weight * part } else { part }
        };
        let total: f64 = slice.iter().map(weight).sum();
        for window in slice {
            let count = (count as f64 * weight(window) / total).round() as usize;
            regions[window.region].cut_out(window, frame, closed, picture, mask);
            extractor.extract(picture, Some(mask), &ExtractorOptions { count, ..Default::default() }, workers, own);
            let origin = Vector2::from(window.origin.map(f64::from));
            features.extend(own.iter().map(|f| Feature { position: f.position + origin, ..*f }));
        }
        tracing::debug!(regions = regions.len(), ?slice, features = features.len(), "unexplained");
    }

    /// Finds the cells that are unexplained.
    fn compare(&mut self, sums: &[u16]) {
        let Self { expected, columns, moments, triples, open, cells, .. } = self;
        let [width, height] = expected.size();
        let [across, down] = [width / CELL_SIDE, height / COMPARED_ROWS];
        moments.clear();
        moments.resize(across * down, Moments::default());
        columns.iter_mut().for_each(|sums| sums.resize(width, 0.0));
        for (row, line_of_cells) in moments.chunks_exact_mut(across.max(1)).enumerate() {
            columns.iter_mut().for_each(|sums| sums.fill(0.0));
            // Skips the border of the level: its pixels lack neighbours.
            for v in (row * COMPARED_ROWS).max(1)..((row + 1) * COMPARED_ROWS).min(height - 1) {
                let line = |v: usize| v * width..(v + 1) * width;
                let owners = [v - 1, v, v + 1].map(|v| &expected.owners()[line(v)]);
                add_row(&sums[line(v * ROW_STEP)], &expected.grey()[line(v)], owners, columns);
            }
            for (k, cell) in line_of_cells.iter_mut().enumerate() {
                cell.0 = columns.each_ref().map(|sums| sums[k * CELL_SIDE..][..CELL_SIDE].iter().sum());
            }
        }
        open.clear();
        for row in 0..down {
            // Sums over three rows, then over three columns of these.
            let (first, last) = (row.saturating_sub(1), (row + 1).min(down - 1));
            triples.clear();
            triples.extend_from_slice(&moments[first * across..][..across]);
            for beside in first + 1..=last {
                triples.iter_mut().zip(&moments[beside * across..]).for_each(|(sum, more)| sum.add(more));
            }
            open.extend((0..across).map(|column| {
                let mut window = Moments::default();
                triples[column.saturating_sub(1)..(column + 2).min(across)].iter().for_each(|sums| window.add(sums));
                window.is_unexplained()
            }));
        }
        cells.renew([across, down], open.iter().copied());
    }

    /// Cuts out the regions, each with a margin.
    fn collect_regions(&mut self, frame: [u32; 2]) {
        let Self { cells, regions, .. } = self;
        regions.resize_with(cells.regions().len(), Region::default);
        for ((size, number), region) in cells.regions().iter().zip(regions) {
            let [low, high] = cells.extent(*number);
            let origin = low.map(|v| v.saturating_sub(TUNING.region_margin_px));
            let end = [0, 1].map(|k| (high[k] + TUNING.region_margin_px).min(frame[k]));
            let mut raw = std::mem::take(&mut region.mask).into_raw();
            raw.clear();
            let [width, height] = [0, 1].map(|k| end[k] - origin[k]);
            let mut y = origin[1];
            while y < end[1] {
                // Rows within one line of cells are identical.
                let next = end[1].min(y - y % CELL_SIDE_PX + CELL_SIDE_PX);
                let first = raw.len();
                cells.push_row([origin[0], end[0]], y, *number, &mut raw);
                (y + 1..next).for_each(|_| raw.extend_from_within(first..first + width as usize));
                y = next;
            }
            // The length always matches, one byte per pixel.
            *region = Region { origin, mask: GrayImage::from_raw(width, height, raw).unwrap_or_default(), cells: *size };
        }
    }
}

#[cfg(test)]
#[path = "unexplained_tests.rs"]
mod tests;
