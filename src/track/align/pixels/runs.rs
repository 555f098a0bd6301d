//! The chosen pixels of a level, laid out for the kernels. They are sorted by surface and tile into
//! runs, each filled up to whole lanes, with their rays, the light that the camera saw, and the
//! light.
//!
//! Runs, tiles and light belong together and are only created together, by [`Pixels::arrange`]. So
//! every run has the four nodes of its light.

use super::level_spec::LevelSpec;
use super::touching_planes::{Rays, TouchingPlanes};
use crate::motion::Motion;
use crate::track::align::lanes::{LANES, resize_with_room};
use crate::track::align::learned::light::{Light, RememberedLight, TileLight};
use crate::track::frame::light_levels::LightLevel;
use crate::track::frame::tile_grid::{Chosen, TileGrid};

/// A run of pixels of one surface in one tile: whole lanes. The last lanes may repeat a pixel; a
/// repeated one has no weight.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Run {
    /// Index of the surface in the body.
    pub surface: u32,
    /// Number of the tile in the grid.
    pub tile: u32,
    /// First pixel.
    pub start: u32,
    /// One past the last, including repeated ones.
    pub end: u32,
}

impl Run {
    /// Returns the places of its pixels in the lists of [`Pixels`].
    pub fn range(&self) -> std::ops::Range<usize> {
        self.start as usize..self.end as usize
    }
}

/// Chosen pixels. All lists of pixels have the same order and length.
#[derive(Debug, Default)]
pub struct Pixels {
    /// Ray at depth 1: x.
    pub x: Vec<f32>,
    /// Ray at depth 1: y.
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
    /// Light that the camera saw, 0 to 255.
    pub seen: Vec<f32>,
    /// 1 where that counts; 0 where it is saturated, clipped to black, or padding.
    pub counts: Vec<f32>,
    /// Place in the cell of the light grid, 0 to 1 across and down.
    pub cell: [Vec<f32>; 2],
    /// Column and row of the level.
    pub place: [Vec<f32>; 2],
    /// Row times width plus column.
    pub index: Vec<u32>,
    /// Where their light is read: see [`LightLevel::place`].
    read_at: Vec<u32>,
    /// Runs in order.
    runs: Vec<Run>,
    /// Ranges of the surfaces, whole lanes: (surface, start, end).
    pub groups: Vec<(u32, u32, u32)>,
    /// Maps to the tangent planes of bent surfaces.
    pub planes: TouchingPlanes,
    /// The light, on the grid that the tiles of the runs belong to.
    light: Light,
    /// Buffers: see [`TileGrid::places`]; where the next pixel of each tile of each surface goes.
    columns: Vec<(u16, f32)>,
    rows: Vec<(u16, f32)>,
    next: Vec<u32>,
    /// Which of the chosen pixels goes to each place; which places repeat one.
    order: Vec<u32>,
    repeats: Vec<u32>,
}

impl Pixels {
    /// Lays out a choice of pixels, with the remembered light on its grid.
    pub fn arrange(&mut self, chosen: &[Chosen], spec: &LevelSpec, level: LightLevel, light: &RememberedLight) {
        let (table, height) = (spec.rays.table(spec.level), spec.rays.camera().height());
        let grid = TileGrid::covering(chosen);
        grid.places(0, &mut self.columns);
        grid.places(1, &mut self.rows);
        self.sort(chosen, spec.surfaces.len(), &grid);
        self.light.spread_over(grid, light);
        let n = self.order.len();
        for list in self.lists() {
            resize_with_room(list, n, 0.0);
        }
        resize_with_room(&mut self.index, n, 0);
        resize_with_room(&mut self.read_at, n, 0);
        let [left, top] = grid.origin();
        // List by list, in the order of the places: in short loops many loads from the table
        // overlap.
        for ((index, read_at), k) in self.index.iter_mut().zip(&mut self.read_at).zip(&self.order) {
            let [u, v] = chosen[*k as usize].place.map(usize::from);
            (*index, *read_at) = ((v * table.width + u) as u32, level.place([u, v]));
        }
        for ((x, y), index) in self.x.iter_mut().zip(&mut self.y).zip(&self.index) {
            [*x, *y] = table.rays[*index as usize];
        }
        self.see(level);
        for (n, k) in self.order.iter().enumerate() {
            let [u, v] = chosen[*k as usize].place.map(usize::from);
            let slope = table.slope(u, v);
            (self.x_across[n], self.x_down[n]) = (slope.x_across, slope.x_down);
            (self.y_across[n], self.y_down[n]) = (slope.y_across, slope.y_down);
            (self.place[0][n], self.place[1][n]) = (u as f32, v as f32);
            self.delay_s[n] = spec.shutter.delay_s(spec.frame_y(v as f64), height) as f32;
            (self.cell[0][n], self.cell[1][n]) = (self.columns[u - left].1, self.rows[v - top].1);
        }
    }

    /// Finds the tangent planes of bent surfaces at the pixels, as seen from a motion.
    pub fn touch(&mut self, spec: &LevelSpec, motion: &Motion) {
        let Self { x, y, delay_s, groups, planes, .. } = self;
        planes.find(&Rays { x, y, delay_s, groups }, spec, motion);
    }

    /// Takes the light that a frame shows at the pixels.
    pub fn see(&mut self, level: LightLevel) {
        let Self { seen, counts, read_at, .. } = self;
        level.read(read_at, |k, pixel| {
            seen[k] = pixel.light;
            counts[k] = if pixel.is_in_range { 1.0 } else { 0.0 };
        });
        for k in &self.repeats {
            self.counts[*k as usize] = 0.0;
        }
    }

    /// Whether place `k` repeats another place's pixel.
    #[cfg(test)]
    pub fn is_repeat(&self, k: u32) -> bool {
        self.repeats.binary_search(&k).is_ok()
    }

    /// Returns the number of pixels, padding included.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Returns the runs in order.
    pub fn runs(&self) -> &[Run] {
        &self.runs
    }

    /// Returns the light on the grid of the runs.
    pub fn light(&self) -> &Light {
        &self.light
    }

    /// Returns the light of one of the runs.
    pub fn light_of(&self, run: &Run) -> TileLight {
        self.light.of_tile(run.tile)
    }

    /// Resets the light to a remembered one, on the same grid.
    pub fn recall_light(&mut self, light: &RememberedLight) {
        self.light.spread_over(*self.light.grid(), light);
    }

    /// Adds a fraction of a solution's changes of the gains, the point spread and the bias to the
    /// light.
    pub fn correct_light(&mut self, fraction: f64, gains: &[f64], psf_variance: f64, bias: f64) {
        self.light.correct(fraction, gains, psf_variance, bias);
    }

    /// Takes a light from guesses: `gains` of tiles, pulled towards the usual gain.
    pub fn guess_light(&mut self, bias: f64, psf_variance: f64, usual: f64, gains: impl Iterator<Item = (u32, f64)>) {
        self.light.guess(bias, psf_variance, usual, gains);
    }

    /// Finds the runs and groups of a choice, and the place of each pixel.
    fn sort(&mut self, chosen: &[Chosen], surfaces: usize, grid: &TileGrid) {
        let tiles = grid.len();
        let [left, top] = grid.origin();
        let (columns, rows) = (&self.columns, &self.rows);
        let slot = |c: &Chosen| {
            let [u, v] = c.place.map(usize::from);
            usize::from(c.surface) * tiles + grid.tile(columns[u - left].0, rows[v - top].0)
        };
        self.next.clear();
        self.next.resize(surfaces * tiles, 0);
        chosen.iter().for_each(|c| self.next[slot(c)] += 1);
        self.runs.clear();
        self.groups.clear();
        self.repeats.clear();
        // The most that any choice can need, so that it never grows.
        self.repeats.reserve(surfaces * tiles * (LANES - 1));
        let mut end = 0u32;
        for surface in 0..surfaces as u32 {
            let group_start = end;
            for tile in 0..tiles as u32 {
                let next = &mut self.next[surface as usize * tiles + tile as usize];
                let (start, filled) = (end, end + *next);
                end = filled.next_multiple_of(LANES as u32);
                *next = start;
                if end > start {
                    self.runs.push(Run { surface, tile, start, end });
                    self.repeats.extend(filled..end);
                }
            }
            if end > group_start {
                self.groups.push((surface, group_start, end));
            }
        }
        resize_with_room(&mut self.order, end as usize, 0);
        for (k, c) in chosen.iter().enumerate() {
            let next = &mut self.next[slot(c)];
            self.order[*next as usize] = k as u32;
            *next += 1;
        }
        // A run is never empty, so a place that repeats has a pixel before it.
        for &k in &self.repeats {
            self.order[k as usize] = self.order[k as usize - 1];
        }
    }

    fn lists(&mut self) -> [&mut Vec<f32>; 13] {
        let ([a, b], [u, v]) = (&mut self.cell, &mut self.place);
        let Self { x, y, x_across, x_down, y_across, y_down, delay_s, seen, counts, .. } = self;
        [x, y, x_across, x_down, y_across, y_down, delay_s, seen, counts, a, b, u, v]
    }
}
