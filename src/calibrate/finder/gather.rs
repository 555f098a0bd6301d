//! Collects the pixels of a corner's window from a level: their offsets, weights, and the
//! contribution of the next edges.
//!
//! The window is the intersection of a parallelogram and a circle around its centre, so each
//! picture row crosses it in one run. Eight pixels are processed side by side. As in the fit's
//! kernel, one body is compiled twice with the same operations in the same order.
//! [`Surroundings::sample`] computes the same for a single pixel in double precision.

use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::Vector2;

use super::level::Level;
use super::surroundings::{NextEdges, Surroundings, reach};
use super::window::{Eight, LANES, Window, erf_and_slope};
use crate::simd::multiversion;

/// Offsets of eight consecutive pixels from the first, pixels.
const STEPS: Eight = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

/// Argument below which the error function is -1 in single precision: 1 - erf(4) is 1.5e-8, less
/// than half its last digit. Raised, an edge's faint rim would be cut off; lowered, pixels are
/// computed that get nothing.
const NOTHING: f32 = -4.0;

/// The linear function `x * dx + y * dy + rest` of a pixel's offset from the centre.
#[derive(Debug, Clone, Copy, Default)]
struct Line {
    x: f64,
    y: f64,
    rest: f64,
}

impl Line {
    fn new(slope: Vector2<f64>, rest: f64) -> Self {
        Self { x: slope.x, y: slope.y, rest }
    }

    /// Returns the value at the first pixel, at this offset, and the increment per pixel.
    #[inline(always)]
    fn along_row(&self, dx: f64, dy: f64) -> [f32; 2] {
        [(self.x * dx + self.y * dy + self.rest) as f32, self.x as f32]
    }

    /// Returns the range along x, at `dy` from the centre, in which the value is between -1 and 1.
    fn within_one(&self, dy: f64) -> [f64; 2] {
        // A line that hardly changes along x is inside or outside everywhere.
        let slope = if self.x.abs() < 1e-9 { 1e-9 } else { self.x };
        let (middle, half) = (-(self.y * dy + self.rest) / slope, (1.0 / slope).abs());
        [middle - half, middle + half]
    }
}

/// A window and its parameters.
struct Area {
    centre: Vector2<f64>,
    /// Offsets along u and v, as fractions of the window's half width.
    squares: [Line; 2],
    /// Radius of the circle, pixels.
    reach: f64,
    /// The light, relative to the centre.
    light: Line,
    /// All zero if there are none. The compiler may compute with these values before it tests
    /// `has_edges`, so they must be defined.
    edges: Edges,
    has_edges: bool,
}

impl Area {
    fn new(centre: Vector2<f64>, [u, v]: [Vector2<f64>; 2], blur: f64, around: &Surroundings) -> Self {
        let per_window = 1.0 / (u.perp(&v) * around.window());
        Self {
            centre,
            squares: [Line::new(Vector2::new(v.y, -v.x) * per_window, 0.0), Line::new(Vector2::new(-u.y, u.x) * per_window, 0.0)],
            reach: reach(blur),
            light: Line::new(around.light, 1.0),
            edges: around.edges.map(|edges| Edges::new(&edges, centre, blur)).unwrap_or_default(),
            has_edges: around.edges.is_some(),
        }
    }
}

/// The next edges, with distances in units of the blur.
#[derive(Debug, Default)]
struct Edges {
    along: [[Line; 2]; 2],
    /// Number of pattern steps at each edge: two, or one at the board's end.
    sizes: [[f32; 2]; 2],
    /// 1 where the board ends, else 0.
    ends: [[f32; 2]; 2],
    beyond: f32,
}

impl Edges {
    fn new(edges: &NextEdges, centre: Vector2<f64>, blur: f64) -> Self {
        let scale = FRAC_1_SQRT_2 / blur;
        Self {
            along: edges.along.map(|pair| pair.map(|e| Line::new(e.normal * scale, scale * (e.normal.dot(&centre) - e.place)))),
            sizes: edges.along.map(|pair| pair.map(|e| if e.ends { 1.0 } else { 2.0 })),
            ends: edges.along.map(|pair| pair.map(|e| if e.ends { 1.0 } else { 0.0 })),
            beyond: edges.beyond as f32,
        }
    }
}

/// Fills `window` with the pixels around `centre`, where `u` and `v` are one square's steps along
/// the board's axes.
pub(super) fn gather(
    level: &Level,
    centre: Vector2<f64>,
    [u, v]: [Vector2<f64>; 2],
    blur: f64,
    around: &Surroundings,
    window: &mut Window,
) {
    let area = Area::new(centre, [u, v], blur, around);
    window.clear();
    let half = (u.y.abs() + v.y.abs()) * around.window();
    let half = half.min(area.reach);
    let rows = [(centre.y - half).ceil().max(0.0), (centre.y + half).floor().min(level.height as f64 - 1.0)];
    if rows[0] <= rows[1] {
        take(level, &area, [rows[0] as usize, rows[1] as usize], window);
    }
}

multiversion! {
    fn take(level: &Level, area: &Area, rows: [usize; 2], window: &mut Window);
    ["avx2"] => take_lanes, else take_lanes
}

#[inline(always)]
fn take_lanes(level: &Level, area: &Area, rows: [usize; 2], window: &mut Window) {
    let per_reach = 1.0 / area.reach;
    for y in rows[0]..=rows[1] {
        let dy = y as f64 - area.centre.y;
        let [(a, b), (c, d)] = area.squares.map(|line| line.within_one(dy).into());
        let half = (area.reach * area.reach - dy * dy).max(0.0).sqrt();
        let first = (a.max(c).max(-half) + area.centre.x).ceil().max(0.0);
        let last = (b.min(d).min(half) + area.centre.x).floor().min(level.width as f64 - 1.0);
        if first > last {
            continue;
        }
        let (first, count) = (first as usize, (last - first) as usize + 1);
        window.pixels.reserve(window.count + count + LANES);
        for k in (0..count).step_by(LANES) {
            let dx = (first + k) as f64 - area.centre.x;
            let grey = level.eight_from(y * level.width + first + k);
            let at = window.count + k;
            take_eight(area, [dx, dy], per_reach, &grey, at, window);
            if area.has_edges {
                take_edges(&area.edges, [dx, dy], at, window);
            }
        }
        window.count += count;
    }
    let (count, pixels) = (window.count, &mut window.pixels);
    pixels.reserve(count + LANES);
    // Pixels written behind the last one must not count.
    pixels.root_weight[count..count + LANES].fill(0.0);
    if !area.has_edges {
        let [across_u, across_v] = &mut pixels.beside;
        for row in [across_u, across_v, &mut pixels.beyond] {
            row[..count + LANES].fill(0.0);
        }
    }
}

/// Writes eight pixels of a row, the first at offset [dx, dy] from the centre, from place `at` on.
#[inline(always)]
fn take_eight(area: &Area, [dx, dy]: [f64; 2], per_reach: f64, grey: &Eight, at: usize, window: &mut Window) {
    let ([s, by_s], [t, by_t]) = (area.squares[0].along_row(dx, dy), area.squares[1].along_row(dx, dy));
    let ([r, by_r], [light, by_light]) = ([(dx * per_reach) as f32, per_reach as f32], area.light.along_row(dx, dy));
    let in_row = 1.0 - (dy * per_reach * dy * per_reach) as f32;
    let (dx, mut x, mut lit, mut root) = (dx as f32, [0.0_f32; LANES], [0.0_f32; LANES], [0.0_f32; LANES]);
    for k in 0..LANES {
        x[k] = dx + STEPS[k];
        let (s, t, r) = (s + by_s * STEPS[k], t + by_t * STEPS[k], r + by_r * STEPS[k]);
        lit[k] = grey[k] / at_least(light + by_light * STEPS[k], 0.1);
        root[k] = (at_least(1.0 - s * s, 0.0) * at_least(1.0 - t * t, 0.0) * at_least(in_row - r * r, 0.0)).sqrt();
    }
    let pixels = &mut window.pixels;
    for (row, values) in [(&mut pixels.x, x), (&mut pixels.y, [dy as f32; LANES]), (&mut pixels.grey, lit), (&mut pixels.root_weight, root)]
    {
        row[at..at + LANES].copy_from_slice(&values);
    }
}

/// Writes what the next edges add to the same eight pixels.
#[inline(always)]
fn take_edges(edges: &Edges, [dx, dy]: [f64; 2], at: usize, window: &mut Window) {
    let mut on_board = [1.0_f32; LANES];
    for axis in 0..2 {
        let [[z, by_z], [w, by_w]] = [edges.along[axis][0].along_row(dx, dy), edges.along[axis][1].along_row(dx, dy)];
        let ([size_before, size_after], [end_before, end_after]) = (edges.sizes[axis], edges.ends[axis]);
        let ([before, after], mut beside) = ([past([-z, -by_z]), past([w, by_w])], [0.0_f32; LANES]);
        for k in 0..LANES {
            beside[k] = size_before * before[k] - size_after * after[k];
            on_board[k] *= 1.0 - end_before * before[k] - end_after * after[k];
        }
        window.pixels.beside[axis][at..at + LANES].copy_from_slice(&beside);
    }
    for (beyond, on_board) in window.pixels.beyond[at..at + LANES].iter_mut().zip(on_board) {
        *beyond = edges.beyond * (1.0 - on_board);
    }
}

/// Returns the fraction of each of eight pixels that lies beyond an edge; the first is `z` past the
/// edge, each further one `by_z` more.
#[inline(always)]
fn past([z, by_z]: [f32; 2]) -> Eight {
    let mut past = [0.0_f32; LANES];
    // Most pixels are so far inside that the fraction is zero.
    if z > NOTHING || z + by_z * STEPS[LANES - 1] > NOTHING {
        for k in 0..LANES {
            past[k] = 0.5 * (1.0 + erf_and_slope(z + by_z * STEPS[k]).0);
        }
    }
    past
}

/// Returns the larger value in one instruction.
#[inline(always)]
fn at_least(value: f32, least: f32) -> f32 {
    if value > least { value } else { least }
}

#[cfg(test)]
mod tests {
    use super::super::surroundings::NextEdge;
    use super::*;

    /// A level with noise-like grey levels, and surroundings of a corner on it.
    fn drawn(with_edges: bool) -> (Level, Surroundings) {
        let (width, height) = (61_usize, 47);
        let grey = (0..width * height).map(|k| (k.wrapping_mul(2_654_435_761) >> 7 & 255) as f32).collect();
        let edge = |x: f64, y: f64, [at_x, at_y]: [f64; 2], ends: bool| {
            let normal = Vector2::new(x, y).normalize();
            NextEdge { normal, place: normal.dot(&Vector2::new(at_x, at_y)), ends }
        };
        let edges = NextEdges {
            along: [
                [edge(-0.1, 1.0, [31.0, 14.0], false), edge(-0.1, 1.0, [32.0, 30.5], true)],
                [edge(1.0, 0.2, [19.0, 22.0], true), edge(1.0, 0.2, [43.0, 22.5], false)],
            ],
            beyond: -0.8,
        };
        (Level { width, height, grey }, Surroundings { light: Vector2::new(0.01, -0.02), edges: with_edges.then_some(edges) })
    }

    const STEP: [Vector2<f64>; 2] = [Vector2::new(12.0, 2.0), Vector2::new(-2.5, 8.0)];

    #[test]
    fn gather_matches_per_pixel_sampling() {
        for (with_edges, x, y, blur) in [(false, 30.3, 22.4, 0.6), (true, 30.3, 22.4, 2.4), (true, 3.2, 4.1, 1.5), (false, 58.9, 44.8, 3.0)]
        {
            let ((level, around), centre) = (drawn(with_edges), Vector2::new(x, y));
            let (mut eights, mut single) = (Window::default(), Window::default());
            gather(&level, centre, STEP, blur, &around, &mut eights);
            for (k, &grey) in level.grey.iter().enumerate() {
                let place = Vector2::new((k % level.width) as f64, (k / level.width) as f64);
                let (offset, area) = (place - centre, STEP[0].perp(&STEP[1]));
                let squares = [offset.perp(&STEP[1]) / area, STEP[0].perp(&offset) / area];
                if let Some(sample) = around.sample(place, offset, squares, (reach(blur), blur), f64::from(grey)) {
                    single.push(&sample);
                }
            }
            assert_eq!(eights.len(), single.len(), "{centre} {blur}");
            assert!(eights.len() > 30);
            for ((name, a), (_, b)) in numbers(&eights).iter().zip(numbers(&single)) {
                for k in 0..eights.len() {
                    // Near 0 the square of the root is what is accurate.
                    let off = if *name == "root weight" { a[k] * a[k] - b[k] * b[k] } else { a[k] - b[k] };
                    assert!(
                        off.abs() < 2e-6 * (1.0 + b[k].abs()) * if *name == "grey" { 2.0 } else { 1.0 },
                        "{name} {k}: {} is not {}",
                        a[k],
                        b[k]
                    );
                }
            }
        }
    }

    #[test]
    fn both_kernels_give_the_same_bits() {
        for with_edges in [false, true] {
            let (level, around) = drawn(with_edges);
            let area = Area::new(Vector2::new(29.7, 21.2), STEP, 2.2, &around);
            let (mut chosen, mut plain) = (Window::default(), Window::default());
            take(&level, &area, [10, 40], &mut chosen);
            take_lanes(&level, &area, [10, 40], &mut plain);
            assert!(chosen.len() > 60);
            assert_eq!(chosen.len(), plain.len());
            for ((_, a), (name, b)) in numbers(&chosen).into_iter().zip(numbers(&plain)) {
                let bits = |of: &[f32]| of[..plain.len()].iter().map(|v| v.to_bits()).collect::<Vec<_>>();
                assert_eq!(bits(a), bits(b), "{name}");
            }
        }
    }

    fn numbers(window: &Window) -> [(&'static str, &[f32]); 7] {
        let of = &window.pixels;
        let [across_u, across_v] = [&of.beside[0][..], &of.beside[1][..]];
        [
            ("x", &of.x),
            ("y", &of.y),
            ("grey", &of.grey),
            ("root weight", &of.root_weight),
            ("beside u", across_u),
            ("beside v", across_v),
            ("beyond", &of.beyond),
        ]
    }
}
