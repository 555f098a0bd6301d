//! The figures of a report: coverage, the pictures with their corners, the corners' errors, the
//! boards in space, the lens distortion, and maps over the picture.

use nalgebra::{Vector2, Vector3};

use super::scale::{self, BAR_HEIGHT};
use super::{INK, PALE};
use crate::calibrate::board::Board;
use crate::calibrate::guide::{PART_COLUMNS, PART_ROWS, ViewSet, ViewShape};
use crate::calibrate::judge::map::{self, MAP_COLUMNS, MAP_ROWS, PixelMap, places};
use crate::calibrate::judge::rounded;
use crate::calibrate::session::{CalibrationView, CameraCalibration};
use crate::calibrate::solve::adjust::{Observation, observations_of};
use crate::camera::CameraModel;
use crate::html_page::svg::{Drawing, data_uri, hue};

/// Draws the corners of all used pictures, coloured by their residuals.
pub(super) fn coverage(made: &CameraCalibration) -> String {
    let (w, h) = (f64::from(made.size.0), f64::from(made.size.1));
    let width = 480.0;
    let (scale, height) = (width / w, width * h / w);
    let mut drawing = Drawing::new(width, height + BAR_HEIGHT);
    drawing.rect([0.5, 0.5], [width - 1.0, height - 1.0], PALE, "var(--panel)");
    let part = [width / PART_COLUMNS as f64, height / PART_ROWS as f64];
    for (column, row) in missing_parts(made) {
        let [x, y] = [column as f64 * part[0], row as f64 * part[1]];
        drawing.rect([x, y], part, "none", "var(--hatch)");
        drawing.text([x + 0.5 * part[0], y + 0.5 * part[1] + 5.0], 14.0, "middle", INK, "no board here");
    }
    for (pixel, residual) in residuals(made) {
        let at = [(pixel.x + 0.5) * scale, (pixel.y + 0.5) * scale];
        drawing.circle(at, 2.4, INK, scale::colour(residual.norm()), 0.35);
    }
    scale::bar(&mut drawing, width, height);
    drawing.finish("Where in the picture the board has been")
}

/// Returns position and residual of every used corner.
fn residuals(made: &CameraCalibration) -> impl Iterator<Item = (Vector2<f64>, Vector2<f64>)> + '_ {
    let used = made.views.iter().filter_map(|view| Some((view, view.index?, view.corners.as_ref()?)));
    used.flat_map(move |(view, index, corners)| {
        let counted = corners.iter().enumerate().filter(|(k, _)| !view.outliers.contains(k));
        counted.filter_map(move |(k, corner)| {
            let seen = Observation { board_m: made.board.corner(k), pixel: (*corner)? };
            Some((seen.pixel, made.estimate.bundle.residual(index, &seen)?))
        })
    })
}

/// Returns the shape of a view with the estimated lens.
pub(super) fn shape(made: &CameraCalibration, corners: &[Option<Vector2<f64>>]) -> Option<ViewShape> {
    ViewShape::new(&observations_of(corners, &made.board), made.size, Some(&made.estimate.bundle.lens))
}

fn missing_parts(made: &CameraCalibration) -> Vec<(usize, usize)> {
    let mut set = ViewSet::default();
    let used = made.views.iter().filter(|view| view.used).filter_map(|view| view.corners.as_ref());
    used.filter_map(|corners| shape(made, corners)).for_each(|shape| set.add(shape));
    set.missing().parts
}

/// Draws a picture with the corners found, the board's outline, its first corner and the directions
/// of its sides.
pub(super) fn picture(view: &CalibrationView, size: (u32, u32), board: &Board) -> Option<String> {
    let small = view.thumbnail.as_ref()?;
    let (w, h) = (f64::from(small.width()), f64::from(small.height()));
    let mut drawing = Drawing::new(w, h);
    drawing.picture(&data_uri(small));
    let scale = |p: &Vector2<f64>| [(p.x + 0.5) * w / f64::from(size.0), (p.y + 0.5) * h / f64::from(size.1)];
    if let Some(corners) = &view.corners {
        let columns = board.columns() as usize;
        let at = |k: usize| corners.get(k).and_then(|c| c.as_ref()).map(scale);
        let rim = [0, columns - 1, corners.len() - 1, corners.len() - columns];
        let outline: Vec<[f64; 2]> = rim.into_iter().filter_map(at).collect();
        drawing.path(&outline, true, "#2b8cff", "none", 1.2);
        for (k, corner) in corners.iter().enumerate() {
            if let Some(corner) = corner {
                let wild = view.outliers.contains(&k);
                drawing.cross(scale(corner), if wild { 4.0 } else { 2.2 }, if wild { "#ff2020" } else { "#18c018" }, 0.9);
            }
        }
        if let (Some(origin), Some(x), Some(y)) = (at(0), at(2), at(2 * columns)) {
            drawing.line(origin, x, "#ff3030", 1.8);
            drawing.line(origin, y, "#ffb000", 1.8);
            drawing.circle(origin, 3.2, "#ff3030", "white", 1.4);
        }
    }
    Some(drawing.finish(&format!("Corners found in {}", view.file.display())))
}

/// Draws the residuals of all corners of all pictures in one plot.
pub(super) fn errors(made: &CameraCalibration) -> String {
    let side = 480.0;
    let reach = (4.0 * made.estimate.sigma_px).max(1e-3);
    let mut drawing = Drawing::new(side, side + BAR_HEIGHT);
    let to = |v: f64| side * (0.5 + 0.48 * (v / reach).clamp(-1.0, 1.0));
    drawing.line([0.0, to(0.0)], [side, to(0.0)], PALE, 0.8);
    drawing.line([to(0.0), 0.0], [to(0.0), side], PALE, 0.8);
    for (offset, error) in residuals(made).map(|(_, r)| ([to(r.x), to(r.y)], r.norm())) {
        drawing.circle(offset, 2.6, INK, scale::colour(error), 0.35);
    }
    let step = round_step(reach);
    for radius in (1..).map(|k| step * f64::from(k)).take_while(|radius| *radius < reach).take(4) {
        drawing.circle([to(0.0), to(0.0)], to(radius) - to(0.0), INK, "none", 0.7);
        drawing.text([to(0.0) + 4.0, to(-radius) - 4.0], 13.0, "start", INK, &format!("{} px", rounded(radius)));
    }
    scale::bar(&mut drawing, side, side);
    drawing.finish("How far corners lie from where they are expected")
}

/// Returns the largest of 1, 2 and 5 times a power of ten that fits at least twice into a length.
fn round_step(reach: f64) -> f64 {
    let power = 10_f64.powf((reach / 2.0).log10().floor());
    [5.0, 2.0, 1.0].map(|k| k * power).into_iter().find(|step| 2.0 * step <= reach).unwrap_or(power)
}

/// Width and height of the figure of the boards in space, in the figure's units.
const SPACE: [f64; 2] = [480.0, 360.0];

/// A parallel projection of boards and camera, seen from the side and from above.
struct Oblique {
    scale: f64,
    middle: [f64; 2],
}

impl Oblique {
    /// Chooses the scale so that all points fit, with room for the labels beside them.
    fn of(points: &[Vector3<f64>]) -> Self {
        let seen: Vec<[f64; 2]> = points.iter().map(|p| Self::rotated(*p)).collect();
        let end = |k: usize, f: fn(f64, f64) -> f64, start: f64| seen.iter().fold(start, |a, p| f(a, p[k]));
        let low = [0, 1].map(|k| end(k, f64::min, f64::INFINITY));
        let high = [0, 1].map(|k| end(k, f64::max, f64::NEG_INFINITY));
        let fits = |k: usize| 0.86 * SPACE[k] / (high[k] - low[k]).max(1e-9);
        Self { scale: fits(0).min(fits(1)), middle: [0, 1].map(|k| 0.5 * (low[k] + high[k])) }
    }

    /// Rotates by 55 degrees about the vertical and looks down by 25 degrees.
    fn rotated(p: Vector3<f64>) -> [f64; 2] {
        let (s, c) = 55.0_f64.to_radians().sin_cos();
        let (right, depth) = (c * p.x + s * p.z, -s * p.x + c * p.z);
        let (s, c) = 25.0_f64.to_radians().sin_cos();
        [right, c * p.y - s * depth]
    }

    fn at(&self, p: Vector3<f64>) -> [f64; 2] {
        let seen = Self::rotated(p);
        [0, 1].map(|k| 0.5 * SPACE[k] + self.scale * (seen[k] - self.middle[k]))
    }
}

/// Draws the camera and every board in space; `number` returns a picture's number in the report.
pub(super) fn space(made: &CameraCalibration, number: impl Fn(usize) -> usize) -> String {
    let rim = |view: &CalibrationView| {
        let pose = made.estimate.bundle.poses[view.index?];
        let (w, h) = (f64::from(made.board.columns() - 1), f64::from(made.board.rows() - 1));
        let corners = [(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)];
        let place = |(x, y): (f64, f64)| pose.rotation * Vector3::new(x, y, 0.0) * made.board.square_m() + pose.translation;
        Some((view.index?, corners.map(place)))
    };
    let boards: Vec<(usize, [Vector3<f64>; 4])> = made.views.iter().filter_map(rim).collect();
    let all: Vec<Vector3<f64>> = boards.iter().flat_map(|(_, b)| *b).chain([Vector3::zeros()]).collect();
    let low = all.iter().fold(Vector3::repeat(f64::INFINITY), |a, p| a.inf(p));
    let high = all.iter().fold(Vector3::repeat(f64::NEG_INFINITY), |a, p| a.sup(p));
    let n = &made.estimate.bundle.lens.0;
    let depth = 0.16 * (high - low).norm();
    let (w, h) = (depth * f64::from(made.size.0) / n[0] * 0.5, depth * f64::from(made.size.1) / n[1] * 0.5);
    let frustum = [(-w, -h), (w, -h), (w, h), (-w, h)].map(|(x, y)| Vector3::new(x, y, depth));
    let view = Oblique::of(&[all.as_slice(), &frustum].concat());
    let frustum = frustum.map(|corner| view.at(corner));
    let mut drawing = Drawing::new(SPACE[0], SPACE[1]);
    for corner in frustum {
        drawing.line(view.at(Vector3::zeros()), corner, "var(--green)", 1.6);
    }
    drawing.path(&frustum, true, "var(--green)", "none", 1.6);
    for (index, board) in &boards {
        drawing.path(&board.map(|p| view.at(p)), true, &hue(*index), "none", 1.4);
        drawing.circle(view.at(board[0]), 2.2, &hue(*index), &hue(*index), 0.0);
        let [x, y] = view.at(board[0]);
        drawing.text([x + 4.0, y - 3.0], 14.0, "start", INK, &format!("{}", number(*index)));
    }
    let [x, y] = view.at(Vector3::zeros());
    drawing.text([x, y + 18.0], 14.0, "middle", "var(--green)", "camera");
    drawing.finish("The camera and the boards in space")
}

/// Draws how far the lens distortion moves the points of a grid.
pub(super) fn distortion(model: &CameraModel) -> String {
    let (w, h) = (f64::from(model.width()), f64::from(model.height()));
    let scale = 480.0 / w;
    let mut drawing = Drawing::new(480.0, h * scale);
    drawing.rect([0.0, 0.0], [480.0, h * scale], PALE, "none");
    let shift = |p: Vector2<f64>| {
        let n = model.from_undistorted_pixel(p);
        (n.0.norm() <= model.valid_radius()).then(|| model.project(n).0 - p)
    };
    let mut worst: f64 = 0.0;
    let (columns, rows) = (16, 12);
    for r in 0..=rows {
        for c in 0..=columns {
            let p = Vector2::new(w * f64::from(c) / f64::from(columns) - 0.5, h * f64::from(r) / f64::from(rows) - 0.5);
            let Some(d) = shift(p) else { continue };
            worst = worst.max(d.norm());
            let from = [(p.x + 0.5) * scale, (p.y + 0.5) * scale];
            drawing.line(from, [from[0] + d.x * scale, from[1] + d.y * scale], "var(--blue)", 1.5);
            drawing.circle(from, 1.2, "none", INK, 0.0);
        }
    }
    let i = model.intrinsics();
    drawing.cross([(i.cx + 0.5) * scale, (i.cy + 0.5) * scale], 7.0, "var(--bad)", 2.0);
    drawing.text([474.0, h * scale - 8.0], 14.0, "end", INK, &format!("longest line {worst:.1} px"));
    drawing.finish("Where the lens moves points to")
}

/// Draws a map of pixel values over the picture as coloured tiles with numbers.
pub(super) fn map(map: &PixelMap, size: (u32, u32), title: &str) -> String {
    let (w, h) = (f64::from(size.0), f64::from(size.1));
    let height = 480.0 * h / w;
    let mut drawing = Drawing::new(480.0, height + BAR_HEIGHT);
    let (tile_w, tile_h) = (480.0 / MAP_COLUMNS as f64, height / MAP_ROWS as f64);
    let tiles = || map.values_px.iter().enumerate().map(|(k, value)| ((k % MAP_COLUMNS, k / MAP_COLUMNS), value));
    for ((c, r), value) in tiles() {
        let colour = value.map_or(PALE, scale::colour);
        drawing.rect([c as f64 * tile_w, r as f64 * tile_h], [tile_w + 0.3, tile_h + 0.3], "none", colour);
    }
    // Numbers are wider than tiles, so only every second tile of every second row has one.
    for ((c, r), value) in tiles().filter(|((c, r), _)| c % 2 == 0 && r % 2 == 0) {
        let label = value.map_or("-".to_owned(), |v| if v < 10.0 { format!("{v:.2}") } else { format!("{v:.0}") });
        // Centred ones would be cut at the rim.
        let anchor = if c == 0 {
            ("start", 2.0)
        } else if c + 1 == MAP_COLUMNS {
            ("end", tile_w - 2.0)
        } else {
            ("middle", 0.5 * tile_w)
        };
        let at = [c as f64 * tile_w + anchor.1, (r as f64 + 0.5) * tile_h + 4.5];
        drawing.text(at, 12.5, anchor.0, value.map_or(INK, scale::text_colour), &label);
    }
    scale::bar(&mut drawing, 480.0, height);
    drawing.finish(title)
}

/// Draws differences as arrows, enlarged so that a long one is as long as a tile.
pub(super) fn arrows(field: &[Option<Vector2<f64>>], size: (u32, u32)) -> String {
    let scale = 480.0 / f64::from(size.0);
    let mut drawing = Drawing::new(480.0, f64::from(size.1) * scale);
    drawing.rect([0.0, 0.0], [480.0, f64::from(size.1) * scale], PALE, "none");
    // Extreme values at the rim would make all other arrows vanish.
    let long = map::lengths(field).quantile(0.9).max(1e-9);
    for (place, difference) in places(size).zip(field) {
        let from = [(place.x + 0.5) * scale, (place.y + 0.5) * scale];
        drawing.circle(from, 1.2, "none", INK, 0.0);
        if let Some(d) = difference {
            let enlarged = d * (480.0 / MAP_COLUMNS as f64 / long.max(d.norm() / 3.0));
            drawing.line(from, [from[0] + enlarged.x, from[1] + enlarged.y], scale::colour(d.norm()), 2.0);
        }
    }
    drawing.finish("Differences as arrows")
}
