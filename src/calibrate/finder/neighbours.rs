//! What a corner's neighbours tell about its surroundings: the slope of the light, the next edges,
//! and the area around the board.

use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::{Matrix3, Vector2, Vector3};

use super::lattice::{Extent, Lattice};
use super::level::Level;
use super::surroundings::{BLUR_REACHES, NextEdge, NextEdges, Surroundings};
use super::window::erf_and_slope;
use crate::geometry::robust_kernel::median;

/// The area around a board.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Margin {
    extent: Extent,
    /// Its level on the scale on which dark squares are -1 and light ones 1.
    pub lightness: f64,
}

/// How far outside the outermost corners the margin is sampled, squares: the board's last squares
/// end at 1, and half a square further the blur adds little of them. Raised, what lies behind the
/// board is taken for its margin.
const OUTSIDE: f64 = 1.5;

impl Margin {
    /// Measures the margin of a lattice that is the whole board and spans `extent`, hidden corners
    /// included.
    pub fn around(lattice: &Lattice, extent: Extent, level: &Level) -> Self {
        let mut seen = [Vec::new(), Vec::new()];
        for ((i, j), cell) in lattice.cells() {
            let Some([u, v]) = lattice.steps(i, j) else { continue };
            let sides = [(i == extent.low.0, -u), (i == extent.high.0, u), (j == extent.low.1, -v), (j == extent.high.1, v)];
            for (_, out) in sides.iter().filter(|(at_end, _)| *at_end) {
                let place = cell.position + out * OUTSIDE;
                if level.has(place, 1.0) {
                    let seen_here = (f64::from(level.sample(place)) - cell.middle) / cell.contrast.max(1.0);
                    // The blur adds the board's own squares, which are alternately dark and light.
                    let half_square = (OUTSIDE - 1.0) * u.perp(&v) / (if out.perp(&u) == 0.0 { v.norm() } else { u.norm() });
                    let own = erf_and_slope((half_square * FRAC_1_SQRT_2 / lattice.blur) as f32).0;
                    seen[(i + j).rem_euclid(2) as usize].push(seen_here / (0.5 + 0.5 * f64::from(own)));
                }
            }
        }
        let [even, odd] = seen.map(|mut all| median(&mut all));
        let lightness = even.zip(odd).map_or(1.0, |(even, odd)| 0.5 * (even + odd));
        Self { extent, lightness: lightness.clamp(-2.0, 2.0) }
    }
}

/// Blur, as a fraction of a square, above which a single corner's level is uncertain, since the
/// blur of the next edges reaches it. Lowered, narrow reflections are averaged out; raised, the
/// slope of the light over blurred corners is noisy and displaces them …
const MUCH_BLUR: f64 = 0.18;
/// … so that the light is fitted to the corners within this many squares; otherwise within one
/// square, since a reflection is narrow. Raised, the slope of the light is that of half the board.
const REACH_BLURRED: i32 = 3;

/// Alternation, relative to the squares inside, that separates squares from no squares: about
/// halfway between none and full. The outermost squares, which may be cut, reach it a quarter of a
/// square out; the area around the board does not. Raised, boards under uneven light seem to end
/// early; lowered, patterns behind the board seem to continue it.
const ALTERNATES: f64 = 0.45;
/// Minimum number of visible squares along a side for a verdict: fewer alternate by chance. A side
/// of three corners has two squares and gives none; raised, longer sides give none either.
const MIN_SQUARES: usize = 3;

impl Lattice {
    /// Whether the board ends where the lattice does: exactly one more row of squares beyond its
    /// outermost corners. Sides cut off by the picture give no verdict.
    pub(super) fn is_whole_board(&self, level: &Level) -> bool {
        (0..4).all(|side| {
            // The area around the board may look like anything but whole squares.
            let goes_on = self.goes_on(level, side) == Some(true);
            // Squares may be cut so narrow that they hardly exist; then the opposite side must have
            // a verdict and not continue either.
            let begins = self.has_squares(level, side) != Some(false) || self.goes_on(level, side ^ 1).is_some();
            !goes_on && begins
        })
    }

    /// Drops outermost corners with no squares beyond them, while the lattice is larger than `size`
    /// (the larger number first).
    pub(super) fn drop_false_ends(&mut self, level: &Level, size: (u32, u32)) {
        for side in 0..4 {
            let Some(extent) = self.extent() else { return };
            let (long, short) = extent.sorted_size();
            let larger = long > size.0 || short > size.1;
            if larger && self.has_squares(level, side) == Some(false) {
                let (low, high) = (extent.low, extent.high);
                self.retain(|at| [at.0 != low.0, at.0 != high.0, at.1 != low.1, at.1 != high.1][side]);
            }
        }
    }

    /// Whether there are squares beyond the outermost corners of a side; `None` if the picture cuts
    /// them off.
    fn has_squares(&self, level: &Level, side: usize) -> Option<bool> {
        // One square further out, the colours are swapped.
        Some(-self.share_of_inside(level, side, 0.25)? > ALTERNATES)
    }

    /// Whether there is a second row of squares beyond them, and so another row of corners.
    fn goes_on(&self, level: &Level, side: usize) -> Option<bool> {
        let shares = [1.25, 1.5, 1.75].map(|out| self.share_of_inside(level, side, out));
        let all: Option<Vec<f64>> = shares.into_iter().collect();
        all.map(|all| all.iter().all(|&share| share > ALTERNATES))
    }

    /// Returns the alternation of the squares outside, relative to those inside.
    fn share_of_inside(&self, level: &Level, side: usize, out: f64) -> Option<f64> {
        let extent = self.extent()?;
        let inside = self.alternation(level, extent, side, -0.5).filter(|a| *a > 0.0)?;
        Some(self.alternation(level, extent, side, out)? / inside)
    }

    /// Returns how much the squares alternate along one side, `out` squares outside the outermost
    /// corners: 1 is full alternation; the sign tells which colour comes first.
    fn alternation(&self, level: &Level, extent: Extent, side: usize, out: f64) -> Option<f64> {
        let (w, h) = extent.size();
        let length = if side < 2 { h } else { w } as i32;
        let mut sum = (0.0, 0);
        for k in 0..length - 1 {
            let (at, next) = match side {
                0 => ((extent.low.0, extent.low.1 + k), (0, 1)),
                1 => ((extent.high.0, extent.low.1 + k), (0, 1)),
                2 => ((extent.low.0 + k, extent.low.1), (1, 0)),
                _ => ((extent.low.0 + k, extent.high.1), (1, 0)),
            };
            let (Some(a), Some(b)) = (self.get(at), self.get((at.0 + next.0, at.1 + next.1))) else { continue };
            let Some([u, v]) = self.steps(at.0, at.1) else { continue };
            let outward = [-u, u, -v, v][side];
            let place = (a.position + b.position) * 0.5 + outward * out;
            if level.has(place, 0.0) {
                let lightness = (f64::from(level.sample(place)) - 0.5 * (a.middle + b.middle)) / (0.5 * (a.contrast + b.contrast));
                let parity = if (at.0 + at.1).rem_euclid(2) == 0 { 1.0 } else { -1.0 };
                // The colour inside is that of the quadrant; which quadrant it is depends on the
                // side.
                let quadrant = if matches!(side, 1 | 3) { parity } else { -parity };
                sum = (sum.0 + quadrant * lightness.clamp(-1.5, 1.5), sum.1 + 1);
            }
        }
        (sum.1 >= MIN_SQUARES).then(|| sum.0 / sum.1 as f64)
    }

    /// Returns what the neighbours tell about a corner at `here`.
    pub(super) fn surroundings(&self, at: (i32, i32), here: Vector2<f64>, margin: Option<&Margin>) -> Surroundings {
        Surroundings { light: self.light(at, here).unwrap_or_default(), edges: self.next_edges(at, here, margin) }
    }

    /// Returns the relative change of the light per pixel, from a plane fitted to the middle levels
    /// of the corners around.
    pub(super) fn light(&self, (i, j): (i32, i32), here: Vector2<f64>) -> Option<Vector2<f64>> {
        let [u, v] = self.steps(i, j)?;
        let blurred = self.blur > MUCH_BLUR * u.perp(&v) / u.norm().max(v.norm());
        let reach = if blurred { REACH_BLURRED } else { 1 };
        let (mut normal, mut levels) = (Matrix3::zeros(), Vector3::zeros());
        self.around((i, j), reach).for_each(|cell| {
            let row = (cell.position - here).push(1.0);
            normal += row * row.transpose();
            levels += row * cell.middle;
        });
        let plane = normal.try_inverse()? * levels;
        let slope = plane.xy() / plane.z.max(1.0);
        // A change by half from one corner to the next is not a slope any more.
        (slope.dot(&u).abs() < 0.5 && slope.dot(&v).abs() < 0.5).then_some(slope)
    }

    /// Returns the four next edges; `None` if their blur does not reach the window.
    fn next_edges(&self, (i, j): (i32, i32), here: Vector2<f64>, margin: Option<&Margin>) -> Option<NextEdges> {
        let [u, v] = self.steps(i, j)?;
        let area = u.perp(&v);
        let nearest = area / u.norm().max(v.norm());
        if self.blur < BLUR_REACHES * nearest {
            return None;
        }
        let across_u = Vector2::new(v.y, -v.x) / v.norm();
        let across_v = Vector2::new(-u.y, u.x) / u.norm();
        let edge = |di: i32, dj: i32, normal: Vector2<f64>| {
            let next = self.at(i + di, j + dj).or_else(|| self.predicted(i + di, j + dj));
            let place = next.unwrap_or(here + u * f64::from(di) + v * f64::from(dj));
            let ends = margin.is_some_and(|m| !m.extent.contains((i + di, j + dj)));
            // An edge's direction changes slightly from one corner to the next.
            let rotated = self.steps(i + di, j + dj).map(|[u, v]| if di == 0 { Vector2::new(-u.y, u.x) } else { Vector2::new(v.y, -v.x) });
            let normal = rotated.filter(|_| !ends).map_or(normal, |n| n.normalize());
            NextEdge { normal, place: normal.dot(&place), ends }
        };
        let along = [[edge(0, -1, across_v), edge(0, 1, across_v)], [edge(-1, 0, across_u), edge(1, 0, across_u)]];
        let dark_first = (i + j).rem_euclid(2) == 0;
        let lightness = margin.map_or(1.0, |m| m.lightness);
        Some(NextEdges { along, beyond: if dark_first { -lightness } else { lightness } })
    }

    /// Returns the shorter side of the median square, level pixels.
    pub(super) fn square(&self) -> f64 {
        let across = |[u, v]: [Vector2<f64>; 2]| u.perp(&v) / u.norm().max(v.norm());
        let mut all: Vec<f64> = self.cells().filter_map(|((i, j), _)| self.steps(i, j)).map(across).collect();
        median(&mut all).unwrap_or(0.0)
    }
}
