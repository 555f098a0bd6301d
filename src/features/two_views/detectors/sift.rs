//! Extrema of differences of Gaussians over position and scale (Lowe, Distinctive Image Features
//! from Scale-Invariant Keypoints, IJCV 2004, sections 3 and 4): blobs with a sigma of their own.

use nalgebra::{Matrix3, Vector2, Vector3};

use super::{Detector, strongest_first};
use crate::features::two_views::keypoint::{Keypoint, PictureForms};
use crate::features::two_views::scale_space::{Octave, SCALES};
use crate::features::two_views::watch::Watch;
use crate::simd::multiversion;

/// Which extrema to keep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SiftDetector {
    /// Maximum number of keypoints, strongest first. Default 5000: more than a 640x480 picture
    /// usually has. Raised, matching takes quadratically longer.
    pub count: usize,
    /// Minimum contrast of an extremum to its surroundings, as a fraction of the range from black
    /// to white, times the scales per octave. Default 0.04: with three scales it equals Lowe's 0.03
    /// (section 4) with his two. Raised, fewer and stronger ones remain.
    pub contrast: f64,
    /// Maximum ratio of the two principal curvatures. Default 10 (section 4.1). Raised, more
    /// keypoints are on edges, with an uncertain position along the edge.
    pub edge_ratio: f64,
}

impl Default for SiftDetector {
    fn default() -> Self {
        Self { count: 5000, contrast: 0.04, edge_ratio: 10.0 }
    }
}

/// Width of an octave's border without keypoints, pixels: most gradients around such a keypoint
/// would be guesses from beyond the border. Raised, keypoints near the border are lost.
const BORDER: usize = 5;
/// Grey levels from black to white.
const RANGE: f64 = 255.0;
/// Maximum number of steps to a neighbouring pixel or scale when the fitted extremum is closer to
/// it (section 4: "changed and the interpolation performed instead about that point"). Raised, a
/// few more keypoints in noise are kept.
const STEPS: usize = 5;
/// Maximum offset from a pixel to its fitted extremum, pixels or scales; beyond, the fit moves to
/// the neighbour. More than a half, because for an extremum midway between two pixels either fit
/// may point to the other, and it would be lost.
const MAX_OFFSET: f64 = 0.6;
/// Fraction of the minimum contrast that an extremum needs before subpixel fitting, which raises it
/// a little. Raised, weak extrema are lost.
const BEFORE_FIT: f64 = 0.5;

impl Detector for SiftDetector {
    fn detect(&self, picture: &PictureForms) -> Vec<Keypoint> {
        let mut keypoints = Vec::new();
        for octave in &picture.scale_space().octaves {
            let threshold = BEFORE_FIT * self.contrast / SCALES as f64 * RANGE;
            for cell in extrema(octave, threshold as f32, &picture.watch) {
                keypoints.extend(self.refined(octave, cell));
            }
        }
        strongest_first(&mut keypoints);
        // Extrema that lead to the same place are adjacent now.
        keypoints.dedup();
        keypoints.truncate(self.count);
        keypoints
    }
}

impl SiftDetector {
    /// Returns the keypoint of an extremum, unless it has too little contrast, is on an edge, or
    /// has no fit nearby.
    fn refined(&self, octave: &Octave, mut cell: Cell) -> Option<Keypoint> {
        let (width, height) = (octave.levels[0].width, octave.levels[0].height);
        for _ in 0..STEPS {
            let fit = Fit::around(octave, cell);
            let offset = fit.curvature.lu().solve(&-fit.slope).filter(|o| o.iter().all(|v| v.is_finite()))?;
            if offset.amax() > MAX_OFFSET {
                let limits = [(BORDER, width - BORDER - 1), (BORDER, height - BORDER - 1), (1, SCALES)];
                let stepped = |k: usize| (cell[k] as f64 + offset[k].round()).clamp(0.0, 1e9) as usize;
                cell = [stepped(0), stepped(1), stepped(2)];
                if cell.iter().zip(limits).any(|(c, (low, high))| *c < low || *c > high) {
                    return None;
                }
                continue;
            }
            let value = (fit.value + 0.5 * fit.slope.dot(&offset)).abs() / RANGE;
            if value * SCALES as f64 <= self.contrast || !fit.is_blob(self.edge_ratio) {
                return None;
            }
            let place = Vector2::new(cell[0] as f64 + offset.x, cell[1] as f64 + offset.y);
            let sigma = Octave::sigma(cell[2] as f64 + offset.z) * octave.step;
            return Some(Keypoint::round(octave.in_picture(place), sigma, value as f32));
        }
        None
    }
}

/// Column, row and level of a difference: level k is between copies k and k + 1.
type Cell = [usize; 3];

/// The quadratic through a difference of Gaussians and its neighbours.
struct Fit {
    value: f64,
    /// First derivatives by column, row and level.
    slope: Vector3<f64>,
    /// Second derivatives.
    curvature: Matrix3<f64>,
}

impl Fit {
    fn around(octave: &Octave, [x, y, level]: Cell) -> Self {
        let at = |i: isize, k: isize, l: isize| {
            let (level, place) =
                (level.wrapping_add_signed(l), y.wrapping_add_signed(k) * octave.levels[0].width + x.wrapping_add_signed(i));
            f64::from(octave.levels[level + 1].values[place] - octave.levels[level].values[place])
        };
        let value = at(0, 0, 0);
        let steps = [(1, 0, 0), (0, 1, 0), (0, 0, 1)];
        let ends = steps.map(|(i, k, l)| [at(i, k, l), at(-i, -k, -l)]);
        let mixed = |a: usize, b: usize| {
            let ((i, k, l), (p, q, r)) = (steps[a], steps[b]);
            let same = at(i + p, k + q, l + r) + at(-i - p, -k - q, -l - r);
            0.25 * (same - at(i - p, k - q, l - r) - at(p - i, q - k, r - l))
        };
        let slope = Vector3::from_fn(|k, _| 0.5 * (ends[k][0] - ends[k][1]));
        let curvature = Matrix3::from_fn(|a, b| if a == b { ends[a][0] + ends[a][1] - 2.0 * value } else { mixed(a, b) });
        Self { value, slope, curvature }
    }

    /// Whether the curvature has the same sign in all image directions, with a ratio of at most
    /// `ratio` (section 4.1).
    fn is_blob(&self, ratio: f64) -> bool {
        let c = &self.curvature;
        let (trace, determinant) = (c[(0, 0)] + c[(1, 1)], c[(0, 0)] * c[(1, 1)] - c[(0, 1)] * c[(0, 1)]);
        determinant > 0.0 && trace * trace * ratio < (ratio + 1.0).powi(2) * determinant
    }
}

/// Number of differences per octave.
const DIFFERENCES: usize = SCALES + 2;

/// Returns pixels whose difference is at least `threshold` and no smaller than its 26 neighbours,
/// or the same below zero; row by row. Of equal neighbours, the first by row, column and level
/// counts.
fn extrema(octave: &Octave, threshold: f32, watch: &Watch) -> Vec<Cell> {
    let (width, height) = (octave.levels[0].width, octave.levels[0].height);
    let mut found = Vec::new();
    if width <= 2 * BORDER || height <= 2 * BORDER {
        return found;
    }
    // Three rows of each difference are kept in rotation: they stay in the cache, and whole
    // differences are never stored.
    let mut rows = RowBuffers::new(width);
    rows.subtract(octave, BORDER - 1);
    rows.subtract(octave, BORDER);
    for y in watch.over(BORDER..height - BORDER) {
        rows.subtract(octave, y + 1);
        rows.bound();
        for level in 1..=SCALES {
            rows.mark(level, y, threshold);
            for x in marked(&rows.marks) {
                if (BORDER..width - BORDER).contains(&x) && rows.is_first(x, level, y) {
                    found.push([x, y, level]);
                }
            }
        }
    }
    found
}

/// Rows around the current one.
struct RowBuffers {
    width: usize,
    /// Row y of a difference is at index y % 3.
    differences: [[Vec<f32>; 3]; DIFFERENCES],
    /// Maximum and minimum of the three rows, per difference.
    bounds: [[Vec<f32>; 2]; DIFFERENCES],
    /// Maximum and minimum of the three rows over three differences.
    joined: [Vec<f32>; 2],
    /// Whether a pixel is an extremum.
    marks: Vec<u8>,
}

impl RowBuffers {
    fn new(width: usize) -> Self {
        let row = || vec![0.0; width];
        Self {
            width,
            differences: std::array::from_fn(|_| std::array::from_fn(|_| row())),
            bounds: std::array::from_fn(|_| std::array::from_fn(|_| row())),
            joined: std::array::from_fn(|_| row()),
            marks: vec![0; width.next_multiple_of(8)],
        }
    }

    fn subtract(&mut self, octave: &Octave, y: usize) {
        for (pair, difference) in octave.levels.windows(2).zip(&mut self.differences) {
            subtract_rows(pair[1].row(y), pair[0].row(y), &mut difference[y % 3]);
        }
    }

    /// Computes the bounds of the three rows.
    fn bound(&mut self) {
        for ([a, b, c], [high, low]) in self.differences.iter().zip(&mut self.bounds) {
            bound_rows([a, b, c], high, low);
        }
    }

    /// Marks the pixels of row y that reach the bounds of all three differences.
    fn mark(&mut self, level: usize, y: usize, threshold: f32) {
        let near = |side: usize| [level - 1, level, level + 1].map(|l| self.bounds[l][side].as_slice());
        let [high, low] = &mut self.joined;
        join_bounds(near(0), near(1), high, low);
        mark_row(&self.differences[level][y % 3], high, low, threshold, &mut self.marks[..self.width - 1]);
    }

    /// Whether no earlier neighbour is equal.
    fn is_first(&self, x: usize, level: usize, y: usize) -> bool {
        let own = self.differences[level][y % 3][x];
        let before = |k: usize, i: usize, l: usize| (k, i, l) < (y, x, level) && self.differences[l][k % 3][i] == own;
        !(y - 1..=y + 1).any(|k| (x - 1..=x + 1).any(|i| (level - 1..=level + 1).any(|l| before(k, i, l))))
    }
}

/// Returns the indices of non-zero marks, skipping eight zeros at a time.
fn marked(marks: &[u8]) -> impl Iterator<Item = usize> {
    let groups = marks.as_chunks::<8>().0.iter().enumerate().filter(|(_, group)| u64::from_le_bytes(**group) != 0);
    groups.flat_map(|(k, group)| group.iter().enumerate().filter(|(_, mark)| **mark != 0).map(move |(i, _)| 8 * k + i))
}

multiversion! {
    fn subtract_rows(a: &[f32], b: &[f32], out: &mut [f32]); ["avx2"] => subtract_rows_plain, else subtract_rows_plain
}

#[inline(always)]
fn subtract_rows_plain(a: &[f32], b: &[f32], out: &mut [f32]) {
    for ((o, a), b) in out.iter_mut().zip(a).zip(b) {
        *o = a - b;
    }
}

/// Like `f32::max` without NaN handling, which is one instruction.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Like `f32::min` without NaN handling.
#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

multiversion! {
    /// Computes maximum and minimum of three rows.
    fn bound_rows(rows: [&[f32]; 3], high: &mut [f32], low: &mut [f32]); ["avx2"] => bound_rows_plain, else bound_rows_plain
}

#[inline(always)]
fn bound_rows_plain([a, b, c]: [&[f32]; 3], high: &mut [f32], low: &mut [f32]) {
    for ((((h, l), a), b), c) in high.iter_mut().zip(low).zip(a).zip(b).zip(c) {
        *h = larger(larger(*a, *b), *c);
        *l = smaller(smaller(*a, *b), *c);
    }
}

multiversion! {
    /// Combines the bounds of three rows: `high` of the first, `low` of the second.
    fn join_bounds(highs: [&[f32]; 3], lows: [&[f32]; 3], high: &mut [f32], low: &mut [f32]);
    ["avx2"] => join_bounds_plain, else join_bounds_plain
}

#[inline(always)]
fn join_bounds_plain([a, b, c]: [&[f32]; 3], [p, q, r]: [&[f32]; 3], high: &mut [f32], low: &mut [f32]) {
    for (((h, a), b), c) in high.iter_mut().zip(a).zip(b).zip(c) {
        *h = larger(larger(*a, *b), *c);
    }
    for (((l, p), q), r) in low.iter_mut().zip(p).zip(q).zip(r) {
        *l = smaller(smaller(*p, *q), *r);
    }
}

multiversion! {
    /// Marks values of at least `threshold` and no smaller than the bounds of their column and both
    /// neighbours, or the same below zero. Skips the first and last pixel.
    fn mark_row(own: &[f32], high: &[f32], low: &[f32], threshold: f32, marks: &mut [u8]); ["avx2"] => mark_row_plain, else mark_row_plain
}

#[inline(always)]
fn mark_row_plain(own: &[f32], high: &[f32], low: &[f32], threshold: f32, marks: &mut [u8]) {
    let [(a, b, c), (p, q, r)] = [high, low].map(|row| (row, &row[1..], &row[2..]));
    let bounds = a.iter().zip(b).zip(c).zip(p.iter().zip(q).zip(r));
    for ((mark, value), (((a, b), c), ((p, q), r))) in marks[1..].iter_mut().zip(&own[1..]).zip(bounds) {
        let top = (*value >= threshold) & (*value >= larger(larger(*a, *b), *c));
        let bottom = (*value <= -threshold) & (*value <= smaller(smaller(*p, *q), *r));
        *mark = u8::from(top | bottom);
    }
}

#[cfg(test)]
mod tests {
    use image::{GrayImage, Luma};

    use super::*;
    use crate::features::two_views::FloatImage;
    use crate::features::two_views::PictureForms;
    use crate::features::two_views::scale_space::ScaleSpace;

    /// Gaussian blobs on grey: column, row, sigma, contrast in grey levels.
    fn blobs(width: u32, height: u32, blobs: &[[f64; 4]]) -> GrayImage {
        GrayImage::from_fn(width, height, |x, y| {
            let level =
                |b: &[f64; 4]| b[3] * (-0.5 * ((f64::from(x) - b[0]).powi(2) + (f64::from(y) - b[1]).powi(2)) / (b[2] * b[2])).exp();
            Luma([(100.0 + blobs.iter().map(level).sum::<f64>()).round() as u8])
        })
    }

    fn detect(picture: &GrayImage) -> Vec<Keypoint> {
        SiftDetector::default().detect(&PictureForms::new(picture))
    }

    #[test]
    fn a_blob_is_found_where_it_is_with_its_size() {
        // All phases of a pixel of the coarsest octave that these sigmas reach, in both directions.
        for sigma in [1.5, 2.3, 3.6, 6.0] {
            let mut mean = Vector2::zeros();
            for k in 0..12 {
                let middle = Vector2::new(60.0 + f64::from(k) * 0.37, 52.0 + f64::from(k) * 0.71);
                let found = detect(&blobs(128, 120, &[[middle.x, middle.y, sigma, 120.0]]));
                assert!(!found.is_empty(), "sigma {sigma}, phase {k}");
                let error = found[0].position - middle;
                assert!(error.norm() < 0.05, "sigma {sigma}, phase {k}: {error:?}");
                mean += error / 12.0;
                // The difference of Gaussians s and 2^(1/3) s responds most to a blob of 2^(1/6) s.
                let expected = sigma / (1.0_f64 / 6.0).exp2();
                assert!((found[0].scale() / expected - 1.0).abs() < 0.1, "sigma {sigma}: {} not {expected}", found[0].scale());
            }
            assert!(mean.amax() < 0.02, "sigma {sigma}: on average {mean:?}");
        }
    }

    #[test]
    fn the_strongest_bright_and_dark_blobs_come_first() {
        let picture = blobs(200, 160, &[[40.0, 40.0, 3.0, 60.0], [140.0, 50.0, 3.0, 120.0], [90.0, 120.0, 4.0, -90.0]]);
        let found = detect(&picture);
        let places = [[140.0, 50.0], [90.0, 120.0], [40.0, 40.0]];
        for (keypoint, [x, y]) in found.iter().zip(places) {
            assert!((keypoint.position - Vector2::new(x, y)).norm() < 0.1, "{found:?}");
        }
        assert!(found.windows(2).all(|pair| pair[0].response >= pair[1].response));
        let two = SiftDetector { count: 2, ..Default::default() }.detect(&PictureForms::new(&picture));
        assert_eq!(two, found[..2]);
    }

    #[test]
    fn faint_blobs_and_edges_are_left_out() {
        assert!(detect(&blobs(90, 90, &[[45.0, 45.0, 3.0, 8.0]])).is_empty());
        let edge = GrayImage::from_fn(120, 120, |x, y| Luma([if 2 * x + y > 170 { 200 } else { 40 }]));
        let inner = |k: &&Keypoint| k.position.iter().all(|c| (25.0..95.0).contains(c));
        assert_eq!(detect(&edge).iter().filter(inner).count(), 0);
        assert!(!SiftDetector { edge_ratio: 1e6, contrast: 0.0, ..Default::default() }.detect(&PictureForms::new(&edge)).is_empty());
    }

    #[test]
    fn the_marked_pixels_are_the_extrema_of_all_neighbours() {
        // Noise of few levels, so that equal neighbours occur.
        let values = (0..61 * 47).map(|k: u32| ((k.wrapping_mul(2_654_435_761) >> 13) % 23) as f32).collect();
        let picture = FloatImage { width: 61, height: 47, values };
        let mut space = ScaleSpace::of(&picture);
        // Rounding the copies to multiples of a half keeps many ties.
        for octave in &mut space.octaves {
            octave.levels.iter_mut().flat_map(|l| &mut l.values).for_each(|v| *v = (*v * 2.0).round() / 2.0);
        }
        let mut total = 0;
        for octave in &space.octaves {
            let found = extrema(octave, 0.5, &Watch::NONE);
            total += found.len();
            assert_eq!(found, plain_extrema(octave, 0.5));
        }
        assert!(total > 50, "{total}");
    }

    /// Like [`extrema`], by its definition.
    fn plain_extrema(octave: &Octave, threshold: f32) -> Vec<Cell> {
        let (w, h) = (octave.levels[0].width, octave.levels[0].height);
        let at = |[x, y, l]: Cell| octave.levels[l + 1].values[y * w + x] - octave.levels[l].values[y * w + x];
        let rows = (BORDER..h.saturating_sub(BORDER)).flat_map(|y| (1..=SCALES).map(move |l| (y, l)));
        let cells = rows.flat_map(|(y, l)| (BORDER..w.saturating_sub(BORDER)).map(move |x| [x, y, l]));
        cells
            .filter(|&[x, y, l]| {
                let own = at([x, y, l]);
                let near = (y - 1..=y + 1).flat_map(|k| (x - 1..=x + 1).flat_map(move |i| (l - 1..=l + 1).map(move |m| [i, k, m])));
                let beaten = |[i, k, m]: Cell| {
                    let (other, earlier) = (at([i, k, m]) * own.signum(), (k, i, m) < (y, x, l));
                    other > own.abs() || (earlier && other == own.abs())
                };
                own.abs() >= threshold && !near.clone().any(beaten)
            })
            .collect()
    }

    #[test]
    fn blank_pictures_have_no_keypoints() {
        for (width, height) in [(0, 0), (1, 1), (300, 1), (1, 300), (11, 11), (64, 64)] {
            let even = GrayImage::from_pixel(width, height, Luma([128]));
            assert!(detect(&even).is_empty(), "{width} x {height}");
        }
        let checks = GrayImage::from_fn(97, 83, |x, y| Luma([((x + y) % 2 * 255) as u8]));
        assert_eq!(detect(&checks), detect(&checks));
    }
}
