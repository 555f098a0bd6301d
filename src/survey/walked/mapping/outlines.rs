//! How far a flat part of the set really reaches.
//!
//! The plane of a part is divided into cells. Where keyframes from different places show the same
//! picture on the plane, the set is there; where they disagree, something stands before or behind
//! it. What holds together becomes a facet, with a rectangle around it.

use nalgebra::{Matrix3, Vector2, Vector3};
use rayon::prelude::*;

use super::flat_parts::FlatPart;
use super::views::Views;
use crate::geometry::robust_kernel::median;
use crate::geometry::{Body, Pose, SurfaceFrame};

/// Side of a cell, metres. Raised, edges are coarse; lowered, cells show too little to compare.
pub const CELL_M: f64 = 0.04;
/// Samples across a cell: a sample every 5 mm, about the size of a pixel at 4 m.
const SAMPLES: usize = 8;
/// Maximum number of keyframes that are compared in a cell. Raised, it takes longer.
const MAX_VIEWS: usize = 12;
/// Minimum number of keyframes that show a cell.
const MIN_VIEWS: usize = 4;
/// Minimum cosine between a plane's normal and the direction to a camera that compares it.
const MIN_COSINE: f64 = 0.25;
/// Minimum median correlation of the keyframes' pictures of a cell with the mean of the others.
/// Raised, noisy cells are lost; lowered, wrong planes pass.
const MIN_CORRELATION: f32 = 0.85;
/// Maximum scatter of light in a cell for it to count as plain, as a share of its mean: noise.
const PLAIN: f32 = 0.03;
/// Minimum share of agreeing cells in a row or column at the rectangle's edge. Raised, parts with
/// ragged edges lose detail; lowered, rectangles reach beyond the set.
const MIN_EDGE_SHARE: f64 = 0.3;
/// Minimum share of agreeing cells among those with detail. Raised, walls behind many things are
/// lost; lowered, planes that only touch the set pass.
const MIN_AGREEING: f64 = 0.35;
/// Minimum sides of a facet, cells: the tracker needs pictures of 64 pixels.
const MIN_SIDES: usize = 4;
/// Cells up to this far apart hold together: a gap of plain ones between them.
const MAX_GAP: usize = 2;
/// Width of the border around a part's points that is looked at, cells.
const MARGIN: usize = 3;
/// Step of the directions tried for a rectangle, degrees.
const DIRECTION_STEP_DEG: usize = 2;
/// Share of a part's points that may lie outside of a rectangle at each side while its direction is
/// chosen.
const TRIMMED: f64 = 0.02;
/// Maximum share of a facet's cells that lie on another facet.
const MAX_SHARED: f64 = 0.3;
/// Distance from another facet's plane within which a cell lies on it, metres.
const ON_FACET_M: f64 = 0.015;
/// Maximum cells along a side: larger parts are looked at in their middle only.
const MAX_SIDE: usize = 1000;

/// What keyframes show in a cell of a plane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CellState {
    /// The same detail.
    Agreeing,
    /// No detail.
    Plain,
    /// Different things, or too few keyframes show it.
    Different,
}

/// A facet before it is painted.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    /// Its pose in the stage; its frame's origin is the middle of the rectangle.
    pub pose: Pose<Body, SurfaceFrame>,
    /// Cells across and down.
    pub sides: [usize; 2],
    /// What keyframes show in each cell, row by row from the top left.
    pub cells: Vec<CellState>,
}

impl Outline {
    /// Returns width and height, metres.
    pub fn size_m(&self) -> [f64; 2] {
        self.sides.map(|n| n as f64 * CELL_M)
    }

    /// Returns the place of a point given in cells from the top left corner, metres in the stage.
    pub fn place(&self, across: f64, down: f64) -> Vector3<f64> {
        let [w, h] = self.size_m();
        self.pose.transform(&Vector3::new(across * CELL_M - 0.5 * w, 0.5 * h - down * CELL_M, 0.0).into()).coords
    }

    /// Returns the index of the cell that a point of the stage lies in, if it lies on the facet.
    fn cell_of(&self, place: &Vector3<f64>) -> Option<usize> {
        let own = self.pose.inverse().transform(&(*place).into());
        let [w, h] = self.size_m();
        let (across, down) = ((own.x + 0.5 * w) / CELL_M, (0.5 * h - own.y) / CELL_M);
        let is_inside = across >= 0.0 && down >= 0.0 && across < self.sides[0] as f64 && down < self.sides[1] as f64;
        (is_inside && own.z.abs() < ON_FACET_M).then(|| down as usize * self.sides[0] + across as usize)
    }

    /// Whether enough of its detail agrees.
    fn holds(&self) -> bool {
        let plain = self.cells.iter().filter(|cell| **cell == CellState::Plain).count();
        self.agreeing() as f64 >= MIN_AGREEING * (self.cells.len() - plain) as f64
    }

    fn agreeing(&self) -> usize {
        self.cells.iter().filter(|cell| **cell == CellState::Agreeing).count()
    }
}

/// Returns the outlines of all flat parts, without those that lie on others. `points` are those of
/// the parts.
pub fn outlines(
    views: &Views<'_>,
    parts: &[FlatPart],
    points: &[Vector3<f64>],
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Option<Vec<Outline>> {
    let mut found: Vec<Outline> = Vec::new();
    for part in parts {
        if !goes_on() {
            return None;
        }
        let whole = examined(views, &around(part, points));
        for outline in connected(&whole).into_iter().filter_map(trimmed).filter(Outline::holds) {
            let is_new = !is_shared(&outline, &found);
            found.extend(is_new.then_some(outline));
        }
    }
    Some(found)
}

/// Returns the rectangle around a part's points, in the direction in which it is smallest, with
/// nothing known of its cells.
fn around(part: &FlatPart, points: &[Vector3<f64>]) -> Outline {
    let normal = part.normal;
    let helper = if normal.z.abs() < 0.8 { Vector3::z() } else { Vector3::y() };
    let right = helper.cross(&normal).normalize();
    let up = normal.cross(&right);
    let flat: Vec<Vector2<f64>> =
        part.members.iter().map(|k| points[*k] - part.centre).map(|d| Vector2::new(d.dot(&right), d.dot(&up))).collect();
    // Directions from -44 to 44 degrees, the upright one first.
    let directions =
        (0..45 / DIRECTION_STEP_DEG).flat_map(|n| [1.0, -1.0].map(|sign| sign * ((n * DIRECTION_STEP_DEG) as f64).to_radians()));
    let tried = directions.map(|angle| (angle, extent(&flat, angle)));
    let area = |[low, high]: &[Vector2<f64>; 2]| (high.x - low.x) * (high.y - low.y);
    let (angle, [low, high]) = tried.min_by(|a, b| area(&a.1).total_cmp(&area(&b.1))).unwrap_or_default();
    let (sin, cos) = angle.sin_cos();
    let [x, y] = [right * cos + up * sin, up * cos - right * sin];
    let middle = part.centre + x * (0.5 * (low.x + high.x)) + y * (0.5 * (low.y + high.y));
    let sides = [high.x - low.x, high.y - low.y].map(|side| ((side / CELL_M).ceil() as usize + 2 * MARGIN).min(MAX_SIDE));
    let pose = Pose::from_matrix(&Matrix3::from_columns(&[x, y, normal]), middle);
    Outline { pose, sides, cells: vec![CellState::Different; sides[0] * sides[1]] }
}

/// Returns the corners of the rectangle around points in a direction, in its axes.
fn extent(flat: &[Vector2<f64>], angle: f64) -> [Vector2<f64>; 2] {
    let (sin, cos) = angle.sin_cos();
    let bounds = |axis: fn(&Vector2<f64>, f64, f64) -> f64| {
        let mut along: Vec<f64> = flat.iter().map(|p| axis(p, sin, cos)).collect();
        along.sort_by(f64::total_cmp);
        let cut = (TRIMMED * along.len() as f64) as usize;
        [along[cut], along[along.len() - 1 - cut]]
    };
    let [x, y] = [bounds(|p, sin, cos| p.x * cos + p.y * sin), bounds(|p, sin, cos| p.y * cos - p.x * sin)];
    [Vector2::new(x[0], y[0]), Vector2::new(x[1], y[1])]
}

/// Compares the keyframes in every cell.
fn examined(views: &Views<'_>, outline: &Outline) -> Outline {
    let state = |n: usize| cell_state(views, outline, n % outline.sides[0], n / outline.sides[0]);
    Outline { cells: (0..outline.cells.len()).into_par_iter().map(state).collect(), ..outline.clone() }
}

fn cell_state(views: &Views<'_>, outline: &Outline, across: usize, down: usize) -> CellState {
    let centre = outline.place(across as f64 + 0.5, down as f64 + 0.5);
    let normal = outline.pose.rotation * Vector3::z();
    let showing: Vec<usize> = (0..views.views.len())
        .filter(|k| views.views[*k].faced_by(&centre, &normal).0 > MIN_COSINE && views.pixel(*k, &centre).is_some())
        .collect();
    let step = showing.len().div_ceil(MAX_VIEWS).max(1);
    let share = |n: usize| (n as f64 + 0.5) / SAMPLES as f64;
    let places: Vec<Vector3<f64>> =
        (0..SAMPLES * SAMPLES).map(|n| outline.place(across as f64 + share(n % SAMPLES), down as f64 + share(n / SAMPLES))).collect();
    let patch = |k: &usize| -> Option<Vec<f32>> { places.iter().map(|place| Some(views.light(*k, views.pixel(*k, place)?))).collect() };
    let patches: Vec<Vec<f32>> = showing.iter().step_by(step).filter_map(patch).collect();
    agreement(patches)
}

/// Compares patches of light that should show the same.
fn agreement(mut patches: Vec<Vec<f32>>) -> CellState {
    if patches.len() < MIN_VIEWS {
        return CellState::Different;
    }
    let mut contrasts = Vec::with_capacity(patches.len());
    for patch in &mut patches {
        let mean = patch.iter().sum::<f32>() / patch.len() as f32;
        patch.iter_mut().for_each(|v| *v -= mean);
        let norm = patch.iter().map(|v| v * v).sum::<f32>().sqrt();
        contrasts.push(f64::from(norm / (patch.len() as f32).sqrt() / mean.max(1.0)));
        patch.iter_mut().for_each(|v| *v /= norm.max(f32::EPSILON));
    }
    let is_plain = median(&mut contrasts).is_none_or(|contrast| contrast < f64::from(PLAIN));
    if is_plain {
        return CellState::Plain;
    }
    let sum: Vec<f32> = (0..patches[0].len()).map(|n| patches.iter().map(|patch| patch[n]).sum()).collect();
    let correlation = |patch: &Vec<f32>| {
        let others = sum.iter().zip(patch).map(|(sum, own)| sum - own);
        let (product, norm) = others.zip(patch).fold((0.0, 0.0), |(p, n), (other, own)| (p + other * own, n + other * other));
        f64::from(product / norm.sqrt().max(f32::EPSILON))
    };
    let mut correlations: Vec<f64> = patches.iter().map(correlation).collect();
    let agrees = median(&mut correlations).is_some_and(|correlation| correlation > f64::from(MIN_CORRELATION));
    if agrees { CellState::Agreeing } else { CellState::Different }
}

/// Divides an outline into the pieces that hold together, each with the rectangle around it.
fn connected(whole: &Outline) -> Vec<Outline> {
    let [columns, rows] = whole.sides;
    let mut is_left: Vec<bool> = whole.cells.iter().map(|cell| *cell == CellState::Agreeing).collect();
    let mut pieces = Vec::new();
    for start in 0..is_left.len() {
        if !std::mem::take(&mut is_left[start]) {
            continue;
        }
        let (mut found, mut at) = (vec![start], 0);
        while let Some(from) = found.get(at).copied() {
            let (x, y) = (from % columns, from / columns);
            let near = |v: usize, most: usize| v.saturating_sub(MAX_GAP)..(v + MAX_GAP + 1).min(most);
            for n in near(y, rows).flat_map(|j| near(x, columns).map(move |i| j * columns + i)) {
                if std::mem::take(&mut is_left[n]) {
                    found.push(n);
                }
            }
            at += 1;
        }
        pieces.push(piece(whole, &found));
    }
    pieces
}

/// Returns the rectangle around some cells, in which other agreeing cells count as different.
fn piece(whole: &Outline, members: &[usize]) -> Outline {
    let columns = whole.sides[0];
    let bounds = |values: Vec<usize>| [values.iter().copied().min().unwrap_or(0), values.iter().copied().max().unwrap_or(0) + 1];
    let x = bounds(members.iter().map(|n| n % columns).collect());
    let y = bounds(members.iter().map(|n| n / columns).collect());
    let mut is_member = vec![false; whole.cells.len()];
    members.iter().for_each(|n| is_member[*n] = true);
    let cells = whole.cells.iter().zip(is_member);
    let own = cells.map(|(cell, own)| if *cell == CellState::Agreeing && !own { CellState::Different } else { *cell }).collect();
    part_of(&Outline { cells: own, ..whole.clone() }, x, y)
}

/// Cuts an outline to columns and rows.
fn part_of(whole: &Outline, x: [usize; 2], y: [usize; 2]) -> Outline {
    let centre = whole.place(0.5 * (x[0] + x[1]) as f64, 0.5 * (y[0] + y[1]) as f64);
    let cells = (y[0]..y[1]).flat_map(|j| (x[0]..x[1]).map(move |i| j * whole.sides[0] + i)).map(|n| whole.cells[n]).collect();
    Outline { pose: Pose::new(whole.pose.rotation, centre), sides: [x[1] - x[0], y[1] - y[0]], cells }
}

/// Cuts off edges where little agrees; `None` if too little is left.
fn trimmed(mut outline: Outline) -> Option<Outline> {
    while outline.sides.iter().all(|side| *side >= MIN_SIDES) {
        let [columns, rows] = outline.sides;
        let share = |cells: &mut dyn Iterator<Item = usize>, of: usize| {
            cells.filter(|n| outline.cells[*n] == CellState::Agreeing).count() as f64 / of as f64
        };
        let edges = [
            (share(&mut (0..columns), columns), [0, columns], [1, rows]),
            (share(&mut (0..columns).map(|i| (rows - 1) * columns + i), columns), [0, columns], [0, rows - 1]),
            (share(&mut (0..rows).map(|j| j * columns), rows), [1, columns], [0, rows]),
            (share(&mut (0..rows).map(|j| j * columns + columns - 1), rows), [0, columns - 1], [0, rows]),
        ];
        let (least, x, y) = edges.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
        if least >= MIN_EDGE_SHARE {
            return Some(outline);
        }
        outline = part_of(&outline, x, y);
    }
    None
}

/// Whether much of a facet lies on others.
fn is_shared(outline: &Outline, others: &[Outline]) -> bool {
    let on_other = |n: &usize| {
        let place = outline.place((n % outline.sides[0]) as f64 + 0.5, (n / outline.sides[0]) as f64 + 0.5);
        others.iter().any(|other| other.cell_of(&place).is_some_and(|cell| other.cells[cell] == CellState::Agreeing))
    };
    let own = (0..outline.cells.len()).filter(|n| outline.cells[*n] == CellState::Agreeing);
    own.filter(on_other).count() as f64 > MAX_SHARED * outline.agreeing() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outline(picture: &[&str]) -> Outline {
        let cell = |c: char| match c {
            '#' => CellState::Agreeing,
            '.' => CellState::Plain,
            _ => CellState::Different,
        };
        let cells = picture.iter().flat_map(|row| row.chars().map(cell)).collect();
        Outline { pose: Pose::identity(), sides: [picture[0].len(), picture.len()], cells }
    }

    #[test]
    fn pieces_apart_become_facets_of_their_own_without_ragged_edges() {
        let whole = outline(&[
            "####x  x    ", //
            "#####       ",
            "####     ###",
            "####    ####",
            "        ####",
            "        ####",
            "        ####",
            "        #   ",
        ]);
        let found: Vec<Outline> = connected(&whole).into_iter().filter_map(trimmed).collect();
        assert_eq!(found.iter().map(|piece| piece.sides).collect::<Vec<_>>(), [[4, 4], [4, 5]]);
        // The first one's middle is two cells right of and below the corner of twelve by eight.
        assert!((found[0].pose.translation - Vector3::new(-4.0 * CELL_M, 2.0 * CELL_M, 0.0)).norm() < 1e-12);
        assert!(is_shared(&found[0], &found[..1]) && !is_shared(&found[0], &found[1..]));
    }

    #[test]
    fn cells_agree_where_patches_are_alike_whatever_the_exposure() {
        let patch = |seed: u32, gain: f32| {
            (0..64u32).map(|n| gain * (50.0 + (n.wrapping_mul(2_654_435_761) ^ seed).wrapping_mul(97) as u8 as f32)).collect::<Vec<f32>>()
        };
        assert_eq!(agreement(vec![patch(1, 1.0), patch(1, 0.5), patch(1, 2.0), patch(1, 1.0), patch(9, 1.0)]), CellState::Agreeing);
        assert_eq!(agreement(vec![patch(1, 1.0), patch(2, 1.0), patch(3, 1.0), patch(4, 1.0)]), CellState::Different);
        assert_eq!(agreement(vec![vec![80.0; 64]; 5]), CellState::Plain);
        assert_eq!(agreement(vec![patch(1, 1.0); 3]), CellState::Different);
    }
}
