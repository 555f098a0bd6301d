//! The chosen pixels of a level, laid out for the kernels: surface by surface and tile by tile, whole lanes to a
//! surface, with their rays and what the camera saw there.

use super::Sensor;
use super::frame_levels::Level;
use super::lanes::LANES;
use super::rays::RayTable;
use super::selection::Chosen;

/// Most tiles across and down the part of the frame that the body covers; both even, because two by two tiles share a
/// cell of the light grid.
pub const MOST_TILES: [usize; 2] = [16, 10];
/// Least side of a tile, pixels of the level.
const LEAST_TILE_PX: usize = 8;

/// A level's grey that counts as burnt out or drowned.
const BRIGHTEST: f32 = 252.0;
const DARKEST: f32 = 0.5;

/// The tiles that a body's pixels are grouped by: a grid over the part of the frame that they cover.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TileGrid {
    /// Tiles across and down, even.
    pub count: [usize; 2],
    /// First pixel column and row of the level.
    origin: [usize; 2],
    /// Pixels of the level covered.
    size: [usize; 2],
}

impl TileGrid {
    fn covering(chosen: &[Chosen]) -> Self {
        let (mut low, mut high) = ([u16::MAX; 2], [0; 2]);
        for c in chosen {
            for k in 0..2 {
                low[k] = low[k].min(c.place[k]);
                high[k] = high[k].max(c.place[k]);
            }
        }
        let size = [0, 1].map(|k| (usize::from(high[k]) + 1).saturating_sub(usize::from(low[k])).max(1));
        let count = [0, 1].map(|k| (size[k] / LEAST_TILE_PX / 2 * 2).clamp(2, MOST_TILES[k]));
        Self { count, origin: low.map(|v| if v == u16::MAX { 0 } else { usize::from(v) }), size }
    }

    /// For each column (`axis` 0) or row (1) covered, from the first: its tile column or row, and where it is in the cell of two by two
    /// tiles, 0 to 1.
    fn places(&self, axis: usize, places: &mut Vec<(u16, f32)>) {
        let (count, size) = (self.count[axis], self.size[axis]);
        let cells = count as f32 / 2.0;
        places.clear();
        places.extend((0..size).map(|p| {
            let tile = p * count / size;
            (tile as u16, (p as f32 + 0.5) / size as f32 * cells - (tile / 2) as f32)
        }));
    }

    /// Tiles in all.
    pub fn len(&self) -> usize {
        self.count[0] * self.count[1]
    }

    /// Nodes of the light grid across and down: the corners of the cells.
    pub fn nodes(&self) -> [usize; 2] {
        self.count.map(|c| c / 2 + 1)
    }

    /// The light nodes at the corners of a tile's cell: top left, top right, bottom left, bottom right. Nodes are numbered
    /// column by column.
    pub fn nodes_of(&self, tile: usize) -> [usize; 4] {
        let rows = self.nodes()[1];
        let (column, row) = (tile % self.count[0] / 2, tile / self.count[0] / 2);
        let at = |c: usize, r: usize| c * rows + r;
        [at(column, row), at(column + 1, row), at(column, row + 1), at(column + 1, row + 1)]
    }
}

/// A run of pixels of one surface in one tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Run {
    /// Surface index in the body.
    pub surface: u32,
    /// Tile number.
    pub tile: u32,
    /// First pixel.
    pub start: u32,
    /// One beyond the last.
    pub end: u32,
}

/// Where pixels are taken from.
#[derive(Clone, Copy)]
pub struct Source<'a> {
    /// The level's number.
    pub l: usize,
    /// What the camera saw there.
    pub level: &'a Level,
    /// Its rays.
    pub table: &'a RayTable,
    /// The shutter.
    pub sensor: &'a Sensor,
    /// Height of the frame at full size, pixels.
    pub height: u32,
}

/// Chosen pixels, each a place in all of the lists.
#[derive(Debug, Default)]
pub struct Pixels {
    /// Ray at depth 1.
    pub x: Vec<f32>,
    /// Ray at depth 1.
    pub y: Vec<f32>,
    /// Derivative of the ray by pixels of the level.
    pub x_across: Vec<f32>,
    /// See `x_across`.
    pub x_down: Vec<f32>,
    /// See `x_across`.
    pub y_across: Vec<f32>,
    /// See `x_across`.
    pub y_down: Vec<f32>,
    /// Seconds from the frame's stamp to the middle of the row's exposure.
    pub delay_s: Vec<f32>,
    /// Grey that the camera saw.
    pub seen: Vec<f32>,
    /// 1 where that tells something, 0 where it is burnt out, drowned, or padding.
    pub counts: Vec<f32>,
    /// Place in the cell of the light grid, 0 to 1.
    pub cell: [Vec<f32>; 2],
    /// Row times width plus column.
    pub index: Vec<u32>,
    /// Runs in order.
    pub runs: Vec<Run>,
    /// Ranges of the surfaces, whole lanes: (surface, start, end).
    pub groups: Vec<(u32, u32, u32)>,
    /// The tiles.
    pub grid: TileGrid,
    /// Width of the level.
    pub width: usize,
    /// See [`TileGrid::places`]; where the next pixel of each surface's tile goes.
    columns: Vec<(u16, f32)>,
    rows: Vec<(u16, f32)>,
    next: Vec<u32>,
}

impl Pixels {
    /// Lays out a choice.
    pub fn arrange(&mut self, chosen: &[Chosen], surfaces: usize, source: &Source) {
        let Source { l, level, table, sensor, height } = *source;
        self.width = table.width;
        self.grid = TileGrid::covering(chosen);
        self.grid.places(0, &mut self.columns);
        self.grid.places(1, &mut self.rows);
        self.make_room(chosen, surfaces);
        let to_grey = 1.0 / f32::from(1u16 << (2 * l));
        let [left, top] = self.grid.origin;
        for c in chosen {
            let [u, v] = c.place.map(usize::from);
            let ((column, a), (row, b)) = (self.columns[u - left], self.rows[v - top]);
            let next =
                &mut self.next[usize::from(c.surface) * self.grid.len() + usize::from(row) * self.grid.count[0] + usize::from(column)];
            let k = *next as usize;
            *next += 1;
            let index = v * table.width + u;
            let ([x, y], slope) = (table.rays[index], table.slope(u, v));
            let grey = f32::from(level.sums()[index]) * to_grey;
            (self.x[k], self.y[k]) = (x, y);
            (self.x_across[k], self.x_down[k]) = (slope.x_across, slope.x_down);
            (self.y_across[k], self.y_down[k]) = (slope.y_across, slope.y_down);
            self.delay_s[k] = sensor.delay_s(l, v as f64, height) as f32;
            self.seen[k] = grey;
            self.counts[k] = tells_something(grey);
            (self.cell[0][k], self.cell[1][k]) = (a, b);
            self.index[k] = index as u32;
        }
        self.pad();
    }

    /// Takes what another frame shows at the same pixels.
    pub fn renew(&mut self, l: usize, level: &Level) {
        let to_grey = 1.0 / f32::from(1u16 << (2 * l));
        for run in &self.runs {
            for k in run.start as usize..run.end as usize {
                let grey = f32::from(level.sums()[self.index[k] as usize]) * to_grey;
                self.seen[k] = grey;
                self.counts[k] = tells_something(grey);
            }
        }
    }

    /// Column and row of pixel `k`.
    pub fn place(&self, k: usize) -> [usize; 2] {
        let index = self.index[k] as usize;
        [index % self.width, index / self.width]
    }

    /// Pixels, padding included.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Finds the runs and groups of a choice, and sizes the lists for them.
    fn make_room(&mut self, chosen: &[Chosen], surfaces: usize) {
        let tiles = self.grid.len();
        let [left, top] = self.grid.origin;
        self.next.clear();
        self.next.resize(surfaces * tiles, 0);
        for c in chosen {
            let [u, v] = c.place.map(usize::from);
            let tile = usize::from(self.rows[v - top].0) * self.grid.count[0] + usize::from(self.columns[u - left].0);
            self.next[usize::from(c.surface) * tiles + tile] += 1;
        }
        self.runs.clear();
        self.groups.clear();
        let mut end = 0u32;
        for surface in 0..surfaces {
            let group_start = end;
            for tile in 0..tiles {
                let start = end;
                end += std::mem::replace(&mut self.next[surface * tiles + tile], start);
                if end > start {
                    self.runs.push(Run { surface: surface as u32, tile: tile as u32, start, end });
                }
            }
            end = end.next_multiple_of(LANES as u32);
            if end > group_start {
                self.groups.push((surface as u32, group_start, end));
            }
        }
        for list in self.lists() {
            list.resize(end as usize, 0.0);
        }
        self.index.resize(end as usize, 0);
    }

    fn lists(&mut self) -> [&mut Vec<f32>; 11] {
        let [a, b] = &mut self.cell;
        let Self { x, y, x_across, x_down, y_across, y_down, delay_s, seen, counts, .. } = self;
        [x, y, x_across, x_down, y_across, y_down, delay_s, seen, counts, a, b]
    }

    /// Repeats the last pixel of each surface, unseen, up to whole lanes.
    fn pad(&mut self) {
        for g in 0..self.groups.len() {
            let (surface, _, end) = self.groups[g];
            let last_run = self.runs.iter().rev().find(|r| r.surface == surface);
            let Some(filled) = last_run.map(|r| r.end as usize) else { continue };
            for list in self.lists() {
                let value = list[filled - 1];
                list[filled..end as usize].fill(value);
            }
            self.counts[filled..end as usize].fill(0.0);
            let index = self.index[filled - 1];
            self.index[filled..end as usize].fill(index);
        }
    }
}

/// 1 for a grey that is neither burnt out nor drowned.
fn tells_something(grey: f32) -> f32 {
    if grey > DARKEST && grey < BRIGHTEST { 1.0 } else { 0.0 }
}
