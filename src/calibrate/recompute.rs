//! Refits the corners with the estimated camera.
//!
//! The finder assumes straight edges. Lens distortion bends them, and perspective makes one side of
//! a corner larger than the other. Once the lens and the board's pose are known, every pixel around
//! a corner is mapped to the board's plane, where edges are straight, and the fit is done there.
//! Lens and corners are then estimated alternately until nothing moves.

use image::GrayImage;
use nalgebra::{Matrix2, Matrix3, Vector2};

use super::board::Board;
use super::finder::fit;
use super::finder::level::{Level, rescaled};
use super::finder::surroundings::{self, NextEdge, NextEdges, Surroundings};
use super::finder::window::Window;
use super::finder::{FoundBoard, SMALL_SQUARE, WIDEST_BLUR};
use super::solve::adjust::BoardFrame;
use crate::camera::{CameraModel, Normalized, Pixel};
use crate::geometry::{Camera, Pose};

/// The part of a picture that shows the board, kept for refitting.
#[derive(Debug, Clone)]
pub(crate) struct BoardPatch {
    levels: Vec<Level>,
    /// The patch's top-left pixel, in picture pixels.
    corner: Vector2<f64>,
}

impl BoardPatch {
    /// Cuts out the board's bounding box with a margin, so that large pictures need not be kept in
    /// memory.
    pub fn cut(picture: &GrayImage, found: &FoundBoard) -> Self {
        let margin_px = 40.0 + 8.0 * found.blur_px;
        let fold = |f: fn(f64, f64) -> f64, start: f64, k: usize| found.corners.iter().flatten().fold(start, |a, c| f(a, c[k]));
        let low = |k: usize| (fold(f64::min, f64::INFINITY, k) - margin_px).max(0.0) as u32;
        let high = |k: usize, size: u32| ((fold(f64::max, 0.0, k) + margin_px) as u32 + 2).min(size);
        // Cut at multiples of 8, so that halving aligns with the same pixels for every cut.
        let (x, y) = (low(0) / 8 * 8, low(1) / 8 * 8);
        let (w, h) = (high(0, picture.width()).saturating_sub(x).max(1), high(1, picture.height()).saturating_sub(y).max(1));
        let level = Level::of_picture(&image::imageops::crop_imm(picture, x, y, w, h).to_image());
        Self::with_levels(level, Vector2::new(f64::from(x), f64::from(y)), found)
    }

    /// Returns the patch smoothed `passes` times, each by a Gaussian of sigma 1; `found` has the
    /// blur after that.
    pub fn smoothed(&self, passes: usize, found: &FoundBoard) -> Self {
        let full_size = (0..passes).fold(self.levels[0].clone(), |level, _| level.smoothed());
        Self::with_levels(full_size, self.corner, found)
    }

    /// Adds the halved levels that the blur asks for.
    fn with_levels(full_size: Level, corner: Vector2<f64>, found: &FoundBoard) -> Self {
        let mut levels = vec![full_size];
        let here = |px: f64, levels: &[Level]| px * 0.5_f64.powi(levels.len() as i32 - 1);
        while here(found.blur_px, &levels) > WIDEST_BLUR && here(found.square_px, &levels) >= SMALL_SQUARE && levels.len() < 5 {
            levels.push(levels[levels.len() - 1].halved());
        }
        Self { levels, corner }
    }
}

/// One view's geometry: maps pixels to the board and back.
pub(crate) struct BoardView<'a> {
    model: &'a CameraModel,
    pose: &'a Pose<Camera, BoardFrame>,
    to_board: Matrix3<f64>,
    board: &'a Board,
    found: &'a FoundBoard,
}

impl<'a> BoardView<'a> {
    /// Prepares the geometry; `None` if the board is seen edge-on.
    pub fn new(model: &'a CameraModel, pose: &'a Pose<Camera, BoardFrame>, board: &'a Board, found: &'a FoundBoard) -> Option<Self> {
        let r = pose.rotation_matrix();
        let from_board = Matrix3::from_columns(&[r.column(0).into_owned(), r.column(1).into_owned(), pose.translation]);
        Some(Self { model, pose, to_board: from_board.try_inverse()?, board, found })
    }

    /// Returns the position on the board, metres, that a raw pixel shows.
    fn on_board(&self, pixel: Vector2<f64>) -> Option<Vector2<f64>> {
        let Normalized(n) = self.model.unproject(Pixel(pixel))?;
        let p = self.to_board * n.push(1.0);
        (p.z > 0.0).then(|| p.xy() / p.z)
    }

    /// Returns the raw pixel of a position on the board, and its derivative by that position.
    fn in_picture(&self, place: Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let r = self.pose.rotation_matrix();
        let p = r * place.push(0.0) + self.pose.translation;
        if p.z <= 1e-9 {
            return None;
        }
        let n = p.xy() / p.z;
        let (pixel, by_n) = self.model.project_with_jacobian(Normalized(n));
        let column = |k: usize| (r.column(k).xy() - n * r[(2, k)]) / p.z;
        Some((pixel.0, by_n * Matrix2::from_columns(&[column(0), column(1)])))
    }

    /// Fits corner `index` near `start` (raw pixel) on the board's plane; `None` if the fit fails.
    pub fn corner(&self, patch: &BoardPatch, index: usize, start: Vector2<f64>, window: &mut Window) -> Option<Vector2<f64>> {
        let mut centre = start;
        for _ in 0..3 {
            let moved = self.corner_once(patch, index, centre, window)?;
            let step = (moved - centre).norm();
            centre = moved;
            if step < 0.05 {
                return Some(centre);
            }
        }
        // A fit that moves this far is not a measurement.
        ((centre - start).norm() < 1.5).then_some(centre)
    }

    fn corner_once(&self, patch: &BoardPatch, index: usize, centre: Vector2<f64>, window: &mut Window) -> Option<Vector2<f64>> {
        let steps = patch.levels.len() as i32 - 1;
        let level = &patch.levels[steps as usize];
        let scale = 0.5_f64.powi(steps);
        let place = self.on_board(centre)?;
        let (_, per_metre) = self.in_picture(place)?;
        let per_metre = per_metre * scale;
        let [u, v] = [0, 1].map(|k| per_metre.column(k) * self.board.square_m());
        let area = u.perp(&v);
        let blur = self.found.blur_px * scale;
        let reach = surroundings::reach(blur);
        let around = self.surroundings(index, place, [u, v], scale);
        let middle = rescaled(centre - patch.corner, steps);
        let flat = Unbent::new(middle, reach, |p| {
            let pixel = rescaled(p, -steps) + patch.corner;
            Some(per_metre * (self.on_board(pixel)? - place))
        })?;
        window.clear();
        let rows = (middle.y - reach).ceil().max(0.0) as usize..((middle.y + reach).floor() + 1.0).clamp(0.0, level.height as f64) as usize;
        for y in rows {
            let columns =
                (middle.x - reach).ceil().max(0.0) as usize..((middle.x + reach).floor() + 1.0).clamp(0.0, level.width as f64) as usize;
            for x in columns {
                let offset = flat.at(Vector2::new(x as f64, y as f64) - middle);
                let squares = [offset.perp(&v) / area, u.perp(&offset) / area];
                let grey = f64::from(level.grey[y * level.width + x]);
                if let Some(sample) = around.sample(offset, offset, squares, (reach, blur), grey) {
                    window.push(&sample);
                }
            }
        }
        let farthest = 0.3 * area / u.norm().max(v.norm());
        let found = fit::fit_window(window, [u, v], blur, farthest)?;
        let metres = per_metre.try_inverse()? * found.offset;
        (found.residual < fit::MAX_RESIDUAL).then_some(())?;
        Some(self.in_picture(place + metres)?.0)
    }
}

impl BoardView<'_> {
    /// Returns the surroundings of corner `index` on the undistorted plane around `place` (board,
    /// metres), where `u` and `v` are one square's steps.
    fn surroundings(&self, index: usize, place: Vector2<f64>, [u, v]: [Vector2<f64>; 2], scale: f64) -> Surroundings {
        let light = self.found.light.get(index).copied().unwrap_or_default() / scale;
        let nearest = u.perp(&v) / u.norm().max(v.norm());
        if self.found.blur_px * scale < surroundings::BLUR_REACHES * nearest {
            return Surroundings { light, edges: None };
        }
        let columns = self.board.columns() as usize;
        let (column, row) = (index % columns, index / columns);
        // Offset of `place` from the corner's true position, squares, so that the next edges stay
        // where they belong.
        let off = (place - self.board.corner(index)) / self.board.square_m();
        let edge = |across: Vector2<f64>, step: Vector2<f64>, squares: f64, ends: bool| {
            let normal = across / across.norm();
            NextEdge { normal, place: normal.dot(&step) * squares, ends }
        };
        let (across_u, across_v) = (Vector2::new(v.y, -v.x), Vector2::new(-u.y, u.x));
        let (last_column, last_row) = (columns - 1, self.board.rows() as usize - 1);
        let along = [
            [edge(across_v, v, -1.0 - off.y, row == 0), edge(across_v, v, 1.0 - off.y, row == last_row)],
            [edge(across_u, u, -1.0 - off.x, column == 0), edge(across_u, u, 1.0 - off.x, column == last_column)],
        ];
        let beyond = if self.found.is_dark_beyond(index, columns) { -self.found.margin } else { self.found.margin };
        Surroundings { light, edges: Some(NextEdges { along, beyond }) }
    }
}

/// Map from pixels around a corner to the undistorted plane: quadratic in x and y, through nine
/// exact points.
struct Unbent {
    nodes: [[Vector2<f64>; 3]; 3],
    reach: f64,
}

impl Unbent {
    fn new(middle: Vector2<f64>, reach: f64, exact: impl Fn(Vector2<f64>) -> Option<Vector2<f64>>) -> Option<Self> {
        let mut nodes = [[Vector2::zeros(); 3]; 3];
        for (row, dy) in nodes.iter_mut().zip([-reach, 0.0, reach]) {
            for (node, dx) in row.iter_mut().zip([-reach, 0.0, reach]) {
                *node = exact(middle + Vector2::new(dx, dy))?;
            }
        }
        Some(Self { nodes, reach })
    }

    fn at(&self, offset: Vector2<f64>) -> Vector2<f64> {
        let weights = |t: f64| [0.5 * t * (t - 1.0), 1.0 - t * t, 0.5 * t * (t + 1.0)];
        let (wx, wy) = (weights(offset.x / self.reach), weights(offset.y / self.reach));
        let row = |nodes: &[Vector2<f64>; 3]| nodes[0] * wx[0] + nodes[1] * wx[1] + nodes[2] * wx[2];
        row(&self.nodes[0]) * wy[0] + row(&self.nodes[1]) * wy[1] + row(&self.nodes[2]) * wy[2]
    }
}
