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
    fn covering(chosen: &[Chosen], width: usize) -> Self {
        let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
        for c in chosen {
            let p = [c.index as usize % width, c.index as usize / width];
            for k in 0..2 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
        }
        let size = [0, 1].map(|k| (high[k] + 1).saturating_sub(low[k]).max(1));
        let count = [0, 1].map(|k| (size[k] / LEAST_TILE_PX / 2 * 2).clamp(2, MOST_TILES[k]));
        Self { count, origin: low.map(|v| if v == usize::MAX { 0 } else { v }), size }
    }

    /// The tile of a pixel, and where it is in the cell of two by two tiles (0 to 1 across and down).
    fn place(&self, u: usize, v: usize) -> (usize, [f32; 2]) {
        let tile = [(u - self.origin[0]) * self.count[0] / self.size[0], (v - self.origin[1]) * self.count[1] / self.size[1]];
        let part = |p: usize, k: usize| {
            let cells = self.count[k] as f32 / 2.0;
            ((p - self.origin[k]) as f32 + 0.5) / self.size[k] as f32 * cells
        };
        let (a, b) = (part(u, 0) - (tile[0] / 2) as f32, part(v, 1) - (tile[1] / 2) as f32);
        (tile[1] * self.count[0] + tile[0], [a, b])
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
    places: Vec<u32>,
    order: Vec<u32>,
}

impl Pixels {
    /// Lays out a choice.
    pub fn arrange(&mut self, chosen: &[Chosen], surfaces: usize, source: &Source) {
        let Source { l, level, table, sensor, height } = *source;
        let width = table.width;
        self.width = width;
        self.grid = TileGrid::covering(chosen, width);
        self.sort(chosen, surfaces, width);
        self.clear();
        let order = std::mem::take(&mut self.order);
        let tiles = self.grid.len();
        let to_grey = 1.0 / f32::from(1u16 << (2 * l));
        let mut at = 0;
        for surface in 0..surfaces {
            let group_start = self.x.len();
            for tile in 0..tiles {
                let end = self.places[surface * tiles + tile] as usize;
                let start = self.x.len() as u32;
                for &k in &order[at..end] {
                    let index = chosen[k as usize].index as usize;
                    let (_, cell) = self.grid.place(index % width, index / width);
                    let grey = f32::from(level.sums()[index]) * to_grey;
                    let delay = sensor.delay_s(l, (index / width) as f64, height) as f32;
                    self.push(index, table, delay, grey, cell);
                }
                at = end;
                if self.x.len() as u32 > start {
                    self.runs.push(Run { surface: surface as u32, tile: tile as u32, start, end: self.x.len() as u32 });
                }
            }
            if self.x.len() > group_start {
                self.pad();
                self.groups.push((surface as u32, group_start as u32, self.x.len() as u32));
            }
        }
        self.order = order;
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

    fn sort(&mut self, chosen: &[Chosen], surfaces: usize, width: usize) {
        let tiles = self.grid.len();
        self.places.clear();
        self.places.resize(surfaces * tiles, 0);
        let key = |c: &Chosen| c.surface as usize * tiles + self.grid.place(c.index as usize % width, c.index as usize / width).0;
        for c in chosen {
            self.places[key(c)] += 1;
        }
        let mut sum = 0;
        for count in &mut self.places {
            sum += std::mem::replace(count, sum);
        }
        self.order.clear();
        self.order.resize(chosen.len(), 0);
        for (k, c) in chosen.iter().enumerate() {
            let place = &mut self.places[key(c)];
            self.order[*place as usize] = k as u32;
            *place += 1;
        }
    }

    fn clear(&mut self) {
        let [a, b] = &mut self.cell;
        let lists = [&mut self.x, &mut self.y, &mut self.x_across, &mut self.x_down, &mut self.y_across, &mut self.y_down];
        for list in lists.into_iter().chain([&mut self.delay_s, &mut self.seen, &mut self.counts, a, b]) {
            list.clear();
        }
        self.index.clear();
        self.runs.clear();
        self.groups.clear();
    }

    fn push(&mut self, index: usize, table: &RayTable, delay_s: f32, grey: f32, cell: [f32; 2]) {
        let rays = &table.rays;
        let [x, y] = rays[index];
        let (left, right, above, below) = (rays[index - 1], rays[index + 1], rays[index - table.width], rays[index + table.width]);
        self.x.push(x);
        self.y.push(y);
        self.x_across.push(0.5 * (right[0] - left[0]));
        self.y_across.push(0.5 * (right[1] - left[1]));
        self.x_down.push(0.5 * (below[0] - above[0]));
        self.y_down.push(0.5 * (below[1] - above[1]));
        self.delay_s.push(delay_s);
        self.seen.push(grey);
        self.counts.push(tells_something(grey));
        self.cell[0].push(cell[0]);
        self.cell[1].push(cell[1]);
        self.index.push(index as u32);
    }

    /// Repeats the last pixel, unseen, up to whole lanes.
    fn pad(&mut self) {
        let Some(last) = self.x.len().checked_sub(1) else { return };
        while !self.x.len().is_multiple_of(LANES) {
            let [a, b] = &mut self.cell;
            let lists = [&mut self.x, &mut self.y, &mut self.x_across, &mut self.x_down, &mut self.y_across, &mut self.y_down];
            for list in lists.into_iter().chain([&mut self.delay_s, &mut self.seen, a, b]) {
                list.push(list[last]);
            }
            self.counts.push(0.0);
            self.index.push(self.index[last]);
        }
    }
}

/// 1 for a grey that is neither burnt out nor drowned.
fn tells_something(grey: f32) -> f32 {
    if grey > DARKEST && grey < BRIGHTEST { 1.0 } else { 0.0 }
}
