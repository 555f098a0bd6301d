//! What of a frame no followed body explains: where a body that is missing can be.
//!
//! Once the stage's pose is known, so is what each pixel should show of it. Where the frame shows that, nothing else stands; where it does not, a
//! prop, a person or a body that is looked for does. A prop takes a hundredth of the frame, and of 1500 features that are spread over all of it a
//! dozen fall on it: too few to find it by. Looked for in what is left unexplained alone, it has hundreds, its faint corners count as well, and a
//! frame that is explained everywhere costs no search at all.
//!
//! The comparison is made at a quarter of the frame's size, in squares of [`CELL`] pixels, gain and bias free: light may change.

use image::GrayImage;
use nalgebra::{Matrix3, Vector2};

use super::align::{CameraRays, FrameLevels};
use super::reference::{PreparedBody, PreparedSurface};
use super::search_windows::{SearchWindows, Window};
use crate::features::{ExtractorOptions, Feature, FeatureExtractor, Workers};
use crate::geometry::{Body, Camera, Pose};

/// The level of the frame that is compared: a quarter of its size. Raised, small props vanish in it; lowered, the comparison costs four times as much.
const LEVEL: usize = 2;
/// Side of a cell, pixels of the level: 16 of the frame. Three by three cells are judged together. Chosen, not tuned: a prop that features can find is 60
/// pixels wide. Raised, small props are not told from what is beside them; lowered, a cell has too few pixels to be judged by.
const CELL: usize = 4;
/// A cell is explained where it correlates with its prediction by this. A followed stage has above 0.97 wherever it has detail, as the pose is known to a
/// tenth of a pixel; something else by chance rarely more than 0.8. Raised, moving shadows and folds are searched as well, which costs time; lowered, a prop that looks like
/// what is behind it is not.
const EXPLAINED_CORRELATION: f32 = 0.9;
/// Least standard deviation of a cell, grey levels, for it to be worth a search: corners stand out by more. Chosen, not tuned: a few times the noise at
/// this level. Raised, faint pictures are not found; lowered, plain walls are searched.
const LEAST_CONTRAST: f32 = 3.0;
/// Fewest pixels of three by three cells by which these are judged: a quarter of them. Chosen, not tuned. Raised, what stands at the border of the stage is
/// overlooked; lowered, a few pixels decide.
const LEAST_JUDGED: f32 = (9 * CELL * CELL / 4) as f32;
/// Fewest cells of a region that is searched: a quarter of a picture that is 64 pixels wide, which is the least that features find. Raised, props that come into view
/// are found later; lowered, specks are searched.
const LEAST_CELLS: usize = 6;
/// Most regions that are searched in a frame, the largest ones. Chosen: sixteen props, and people. Raised, a frame that is strewn with specks costs more.
const MOST_REGIONS: usize = 24;
/// Pixels of the frame around a region that are looked at: as far as the description of a corner reaches two octaves up. Raised, searches cost more; lowered, corners near a
/// region's border are found at full size alone.
const MARGIN_PX: u32 = 64;

/// A part of the frame that no followed body explains.
#[derive(Debug, Clone, Default)]
struct Region {
    /// First column and row of its rectangle, pixels of the frame.
    origin: [u32; 2],
    /// Of its rectangle: 255 where it is unexplained, 0 elsewhere.
    mask: GrayImage,
    /// Its cells.
    cells: usize,
}

impl Region {
    fn size(&self) -> [u32; 2] {
        [self.mask.width(), self.mask.height()]
    }

    /// Copies a window of the frame, and of its mask what the frame's own mask leaves.
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
        // There is one byte for each pixel, here and below.
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

/// Finds what is unexplained; keeps its buffers.
#[derive(Debug, Default)]
pub struct Unexplained {
    /// Of what is nearest: its depth, what should be seen of it, and the number of its surface from 1; 0 where no surface should be seen.
    depth: Vec<f32>,
    predicted: Vec<f32>,
    owners: Vec<u16>,
    moments: Vec<Moments>,
    /// Cells across and down.
    cells: [usize; 2],
    /// 0: explained. Else the region's number from 1, or [`UNNUMBERED`] on the way.
    labels: Vec<u32>,
    stack: Vec<usize>,
    sizes: Vec<(usize, u32)>,
    regions: Vec<Region>,
    windows: SearchWindows,
    /// The picture, the mask and the features of one window.
    picture: GrayImage,
    mask: GrayImage,
    features: Vec<Feature>,
}

/// A cell that is in no region yet.
const UNNUMBERED: u32 = u32::MAX;

/// Sums over the pixels of a cell.
#[derive(Debug, Clone, Copy, Default)]
struct Moments {
    /// Pixels that a surface covers; their grey, its square, the prediction, its square, the product.
    covered: [f32; 6],
    /// Pixels that none covers; their grey and its square.
    open: [f32; 3],
}

impl Moments {
    fn add(&mut self, other: &Self) {
        self.covered.iter_mut().zip(other.covered).for_each(|(sum, more)| *sum += more);
        self.open.iter_mut().zip(other.open).for_each(|(sum, more)| *sum += more);
    }

    /// Whether something is to be seen that is not what should be: where surfaces are expected, or where none is.
    fn is_unexplained(&self) -> bool {
        let has_detail = |n: f32, s: f32, ss: f32| n >= LEAST_JUDGED && ss / n - (s / n).powi(2) > LEAST_CONTRAST.powi(2);
        let [n, s, ss, p, pp, sp] = self.covered;
        let [m, t, tt] = self.open;
        let differs = || {
            let (seen, expected, both) = (ss - s * s / n, pp - p * p / n, sp - s * p / n);
            both <= 0.0 || both * both < EXPLAINED_CORRELATION.powi(2) * seen * expected
        };
        has_detail(m, t, tt) || (has_detail(n, s, ss) && differs())
    }
}

impl Unexplained {
    /// Looks at a frame of which these bodies are known to be where their poses say.
    pub fn look<'a>(
        &mut self,
        known: impl Iterator<Item = (&'a PreparedBody, Pose<Body, Camera>)>,
        levels: &mut FrameLevels,
        rays: &CameraRays,
    ) {
        let table = rays.table(LEVEL);
        let pixels = table.width * table.height;
        self.depth.clear();
        self.depth.resize(pixels, f32::INFINITY);
        self.predicted.clear();
        self.predicted.resize(pixels, 0.0);
        self.owners.clear();
        self.owners.resize(pixels, 0);
        let mut owner = 0;
        for (body, pose) in known {
            for surface in &body.surfaces {
                owner += 1;
                self.draw(surface, owner, &pose, rays);
            }
        }
        self.compare(levels.level(LEVEL).sums(), [table.width, table.height]);
        self.number_regions();
        self.collect_regions([rays.camera().width(), rays.camera().height()]);
    }

    /// The features of the regions of the frame that was looked at last, at most about so many; where there is much to search, of the parts whose turn it
    /// is. `closed`: the frame's own mask.
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
        let Self { regions, windows, picture, mask, features: own, .. } = self;
        let slice = windows.next_slice(regions.iter().map(|r| (r.origin, r.size())));
        // A small region gets more than its part: what is in it is seen small, and has the fewest corners.
        let weight = |window: &Window| {
            let region = &regions[window.region];
            let whole: u64 = region.size().iter().map(|n| u64::from(*n)).product();
            (region.cells as f64 * window.area() as f64 / whole as f64).sqrt()
        };
        let total: f64 = slice.iter().map(weight).sum();
        for window in slice {
            let count = (count as f64 * weight(window) / total).round() as usize;
            regions[window.region].cut_out(window, frame, closed, picture, mask);
            extractor.extract(picture, Some(mask), &ExtractorOptions { count, ..Default::default() }, workers, own);
            let origin = Vector2::from(window.origin.map(f64::from));
            features.extend(own.iter().map(|f| Feature { position: f.position + origin, ..*f }));
        }
        tracing::debug!(regions = regions.len(), windows = slice.len(), features = features.len(), "unexplained");
    }

    /// Draws a surface as the camera should see it; what is nearest wins. A bent one is taken for its plane: folds are small at this size.
    fn draw(&mut self, surface: &PreparedSurface, owner: u16, t_body_camera: &Pose<Body, Camera>, rays: &CameraRays) {
        let table = rays.table(LEVEL);
        let rectangle = &surface.rectangle;
        let to_surface = rectangle.rotation.transpose();
        let turn: Matrix3<f32> = (to_surface * t_body_camera.rotation_matrix()).cast();
        let from = (to_surface * (t_body_camera.translation - rectangle.centre)).cast::<f32>();
        // Its face must look at the camera.
        if from.z <= 0.0 {
            return;
        }
        let Some([columns, rows]) = extent(surface, t_body_camera, rays, [table.width, table.height]) else { return };
        let scale = f64::from(1u32 << LEVEL);
        let see = |place| rectangle.see(t_body_camera, rays.camera(), place, 0.0).map(|seen| seen.in_smaller(scale));
        let texels = rectangle.texels_log2([table.width as f64, table.height as f64], see).unwrap_or(0.0);
        // The finer of the two that are nearest: a coarser one lacks the detail that the frame shows, and correlates by 0.9 where this one does by 0.98.
        let octave = (texels.floor().max(0.0) as usize).min(surface.octaves.len() - 1);
        let picture = Picture::new(&surface.octaves[octave].image);
        let [width, height] = rectangle.size_m.map(|m| m as f32);
        for v in rows {
            for u in columns.clone() {
                let k = v * table.width + u;
                let [x, y] = table.rays[k];
                let along = |row: usize| turn[(row, 0)] * x + turn[(row, 1)] * y + turn[(row, 2)];
                let depth = -from.z / along(2);
                // Not a number where the lens has no ray, negative behind the camera.
                if !(depth > 0.0 && depth < self.depth[k]) {
                    continue;
                }
                let place = [(from.x + depth * along(0)) / width + 0.5, 0.5 - (from.y + depth * along(1)) / height];
                if place.iter().all(|share| (0.0..=1.0).contains(share)) {
                    self.depth[k] = depth;
                    self.predicted[k] = picture.at(place);
                    self.owners[k] = owner;
                }
            }
        }
    }

    /// Leaves in `labels` which cells are unexplained.
    fn compare(&mut self, sums: &[u16], [width, height]: [usize; 2]) {
        let [across, down] = [width / CELL, height / CELL];
        self.cells = [across, down];
        self.moments.clear();
        self.moments.resize(across * down, Moments::default());
        let grey = 1.0 / f32::from(1u16 << (2 * LEVEL));
        // The rim of the level is left out: its pixels have no neighbours.
        for v in 1..(down * CELL).min(height - 1) {
            for u in 1..(across * CELL).min(width - 1) {
                let k = v * width + u;
                let owner = self.owners[k];
                // A pixel on an edge shows both sides of it.
                if [k - 1, k + 1, k - width, k + width].iter().any(|beside| self.owners[*beside] != owner) {
                    continue;
                }
                let (seen, predicted) = (f32::from(sums[k]) * grey, self.predicted[k]);
                let cell = &mut self.moments[v / CELL * across + u / CELL];
                let sums = if owner > 0 { &mut cell.covered[..] } else { &mut cell.open[..] };
                let more = [1.0, seen, seen * seen, predicted, predicted * predicted, seen * predicted];
                sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
            }
        }
        self.labels.clear();
        for cell in 0..across * down {
            let (column, row) = (cell % across, cell / across);
            let mut window = Moments::default();
            for v in row.saturating_sub(1)..(row + 2).min(down) {
                for u in column.saturating_sub(1)..(column + 2).min(across) {
                    window.add(&self.moments[v * across + u]);
                }
            }
            self.labels.push(if window.is_unexplained() { UNNUMBERED } else { 0 });
        }
    }

    /// Numbers the regions: cells that share a side.
    fn number_regions(&mut self) {
        let [across, down] = self.cells;
        self.sizes.clear();
        for first in 0..self.labels.len() {
            if self.labels[first] != UNNUMBERED {
                continue;
            }
            let number = self.sizes.len() as u32 + 1;
            let mut size = 0;
            self.labels[first] = number;
            self.stack.push(first);
            while let Some(cell) = self.stack.pop() {
                size += 1;
                let (column, row) = (cell % across, cell / across);
                let beside = [
                    (column > 0).then(|| cell - 1),
                    (column + 1 < across).then_some(cell + 1),
                    (row > 0).then(|| cell - across),
                    (row + 1 < down).then_some(cell + across),
                ];
                for next in beside.into_iter().flatten() {
                    if self.labels[next] == UNNUMBERED {
                        self.labels[next] = number;
                        self.stack.push(next);
                    }
                }
            }
            self.sizes.push((size, number));
        }
        self.sizes.retain(|(size, _)| *size >= LEAST_CELLS);
        // The largest first; where two are equal, in reading order.
        self.sizes.sort_unstable_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
        self.sizes.truncate(MOST_REGIONS);
    }

    /// Cuts the regions out, each with a margin.
    fn collect_regions(&mut self, frame: [u32; 2]) {
        let across = self.cells[0];
        let side = (CELL << LEVEL) as u32;
        self.regions.resize_with(self.sizes.len(), Region::default);
        for ((size, number), region) in self.sizes.iter().zip(&mut self.regions) {
            let own = |cell: &usize| self.labels[*cell] == *number;
            let (mut low, mut high) = ([u32::MAX; 2], [0; 2]);
            for cell in (0..self.labels.len()).filter(own) {
                for (k, at) in [cell % across, cell / across].into_iter().enumerate() {
                    low[k] = low[k].min(at as u32 * side);
                    high[k] = high[k].max((at as u32 + 1) * side);
                }
            }
            let origin = low.map(|v| v.saturating_sub(MARGIN_PX));
            let end = [0, 1].map(|k| (high[k] + MARGIN_PX).min(frame[k]));
            let mut raw = std::mem::take(&mut region.mask).into_raw();
            raw.clear();
            let [width, height] = [0, 1].map(|k| end[k] - origin[k]);
            for y in origin[1]..end[1] {
                for x in origin[0]..end[0] {
                    let cell = (y / side) as usize * across + (x / side) as usize;
                    let is_own = ((x / side) as usize) < across && self.labels.get(cell) == Some(number);
                    raw.push(if is_own { 255 } else { 0 });
                }
            }
            // There is one byte for each pixel.
            *region = Region { origin, mask: GrayImage::from_raw(width, height, raw).unwrap_or_default(), cells: *size };
        }
    }
}

/// Columns and rows of the level that a surface may cover; all where a corner of it is behind the camera or beyond the lens.
fn extent(
    surface: &PreparedSurface,
    t_body_camera: &Pose<Body, Camera>,
    rays: &CameraRays,
    size: [usize; 2],
) -> Option<[std::ops::Range<usize>; 2]> {
    let [x, y] = surface.rectangle.size_m.map(|m| 0.5 * m);
    let corner = |place| surface.rectangle.see(t_body_camera, rays.camera(), place, 0.0);
    // The middles of the sides as well: a lens bends them outwards.
    let places = [[-x, -y], [0.0, -y], [x, -y], [x, 0.0], [x, y], [0.0, y], [-x, y], [-x, 0.0]];
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for place in places {
        let Some(seen) = corner(place) else { return Some(size.map(|n| 0..n)) };
        for k in 0..2 {
            low[k] = low[k].min(seen.pixel[k]);
            high[k] = high[k].max(seen.pixel[k]);
        }
    }
    let scale = f64::from(1u32 << LEVEL);
    let range = |k: usize| {
        // Two pixels more, and a hundredth for what the lens bends between the points.
        let more = 2.0 + 0.01 * (high[k] - low[k]) / scale;
        let at = |v: f64| v.clamp(0.0, size[k] as f64) as usize;
        at(low[k] / scale - more)..at(high[k] / scale + more)
    };
    let both = [range(0), range(1)];
    both.iter().all(|r| !r.is_empty()).then_some(both)
}

/// A picture that is looked up by shares of its width and height.
struct Picture<'a> {
    raw: &'a [u8],
    size: [usize; 2],
}

impl<'a> Picture<'a> {
    fn new(image: &'a GrayImage) -> Self {
        Self { raw: image.as_raw(), size: [image.width() as usize, image.height() as usize] }
    }

    /// Grey at a place, straight lines between the pixels.
    fn at(&self, place: [f32; 2]) -> f32 {
        let [width, height] = self.size;
        let axis = |share: f32, n: usize| {
            let at = (share * n as f32 - 0.5).clamp(0.0, (n - 1) as f32);
            let first = (at as usize).min(n.saturating_sub(2));
            (first, at - first as f32)
        };
        let ((i, a), (j, b)) = (axis(place[0], width), axis(place[1], height));
        let row = |j: usize| {
            let at = j * width + i;
            f32::from(self.raw[at]) * (1.0 - a) + f32::from(self.raw[at + 1]) * a
        };
        row(j) * (1.0 - b) + row(j + 1) * b
    }
}

#[cfg(test)]
#[path = "unexplained_tests.rs"]
mod tests;
