//! Histograms of gradient directions over a grid that rotates and scales with the keypoint (Lowe,
//! Distinctive Image Features from Scale-Invariant Keypoints, IJCV 2004, section 6).

use super::Describer;
use super::gradients::Gradients;
use super::orientation::Orientation;
use super::region::{Patch, Region};
use super::shares::{self, Grids, Shares, bin};
use super::window::Window;
use crate::features::two_views::keypoint::{Descriptors, Features, Keypoint, PictureForms};
use crate::simd::multiversion;

/// 4 x 4 histograms of 8 directions: 128 numbers of unit length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SiftDescriber {
    /// Whether to take square roots of the normalised values (RootSIFT: Arandjelovic & Zisserman,
    /// Three things everyone should know to improve object retrieval, CVPR 2012), so that Euclidean
    /// distance compares histograms by the Hellinger kernel. Default true: on photographs of the
    /// same plane it has a twentieth more true matches at the same ratio and half as many wrong
    /// ones (measured on the Oxford pairs).
    pub root: bool,
}

impl Default for SiftDescriber {
    fn default() -> Self {
        Self { root: true }
    }
}

/// Grid cells each way (section 6.2, figure 8).
const CELLS: usize = 4;
/// Directions per histogram (section 6.2).
const DIRECTIONS: usize = 8;
/// Length of a descriptor.
pub const LENGTH: usize = CELLS * CELLS * DIRECTIONS;
/// Side of a cell in sigmas of the region; Lowe's own program uses 3. Raised, descriptors are more
/// distinctive and tolerate less deformation.
const CELL_SIGMAS: f64 = 3.0;
/// Maximum value in a unit descriptor (section 6.1), so that strong edges, which lighting affects,
/// count less. Raised, they count more.
const CLIP: f32 = 0.2;
/// Cells each way including the rim, which absorbs the shares of pixels outside the grid and is
/// discarded.
const RIMMED: usize = CELLS + 2;

impl Describer for SiftDescriber {
    fn describe(&self, picture: &PictureForms, keypoints: &[Keypoint]) -> Features {
        let (mut described, mut values) = (Vec::with_capacity(keypoints.len()), Vec::with_capacity(keypoints.len() * LENGTH));
        let (mut patch, mut orientation, mut grid) = (Patch::default(), Orientation::default(), Grid::default());
        for keypoint in picture.watch.over(keypoints) {
            let Some((region, keypoint)) = patch.region(picture, keypoint) else { continue };
            for direction in orientation.directions(&region) {
                let mut numbers = grid.gather(&region, direction);
                if normalise(&mut numbers, self.root) {
                    described.push(keypoint.rotated(f64::from(direction)));
                    values.extend(numbers);
                }
            }
        }
        Features { keypoints: described, descriptors: Descriptors::Vectors { length: LENGTH, values } }
    }
}

/// Scales a descriptor to unit length, clipping it in between; returns false if it is empty.
pub(super) fn normalise(numbers: &mut [f32], root: bool) -> bool {
    let unit = |numbers: &mut [f32]| {
        let length = numbers.iter().map(|v| v * v).sum::<f32>().sqrt();
        numbers.iter_mut().for_each(|v| *v /= length);
        length > 0.0 && length.is_finite()
    };
    if !unit(numbers) {
        return false;
    }
    numbers.iter_mut().for_each(|v| *v = v.min(CLIP));
    if root {
        let sum: f32 = numbers.iter().sum();
        numbers.iter_mut().for_each(|v| *v = (*v / sum).sqrt());
        return true;
    }
    unit(numbers)
}

#[derive(Debug, Default)]
struct Grid {
    window: Window,
    gradients: Gradients,
    shares: Shares,
}

/// A straight line of pixels in the grid's frame, in cells from the centre of the rim's first cell.
#[derive(Debug, Clone, Copy)]
struct Line {
    start: [f32; 2],
    step: [f32; 2],
    /// Rotation of the grid, radians.
    rotation: f32,
}

impl Grid {
    /// Returns the histograms of a region, with the grid rotated to `direction`.
    fn gather(&mut self, region: &Region, direction: f32) -> [f32; LENGTH] {
        let cell = CELL_SIGMAS * region.sigma;
        let (sin, cos) = f64::from(direction).sin_cos();
        let half = (CELLS + 1) as f64 / 2.0;
        self.window.set(region, half * cell * (sin.abs() + cos.abs()), CELLS as f64 / 2.0 * cell);
        let (along, across) = (cos / cell, sin / cell);
        let mut grids = [[[0.0; DIRECTIONS]; RIMMED * RIMMED]; 2];
        for y in self.window.rows() {
            let down = y as f64 - region.middle.y;
            let (low, high) = overlap(within(along, across * down, half), within(-across, along * down, half));
            let Some(row) = self.window.row(region, y, low, high) else { continue };
            self.gradients.of_row(row.rows, row.weights, row.weight);
            let [x, y] = row.place.map(f64::from);
            let start = [along * x + across * y + half, along * y - across * x + half].map(|v| v as f32);
            let line = Line { start, step: [along as f32, -across as f32], rotation: direction };
            self.shares.resize(self.gradients.directions.len());
            place_row(line, &self.gradients.directions, &mut self.shares);
            add_row(&self.shares, &self.gradients.lengths, &mut grids);
        }
        let inner = |k: usize| (k / CELLS + 1) * RIMMED + k % CELLS + 1;
        std::array::from_fn(|k| {
            let (cell, bin) = (inner(k / DIRECTIONS), k % DIRECTIONS);
            grids[0][cell][bin] + grids[1][cell][bin]
        })
    }
}

/// Returns the interval of x where |slope x + offset| < `half`.
fn within(slope: f64, offset: f64, half: f64) -> (f64, f64) {
    if slope.abs() < 1e-12 {
        return if offset.abs() < half { (f64::NEG_INFINITY, f64::INFINITY) } else { (f64::INFINITY, f64::NEG_INFINITY) };
    }
    let [a, b] = [-half, half].map(|end| (end - offset) / slope);
    (a.min(b), a.max(b))
}

fn overlap(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    (a.0.max(b.0), a.1.min(b.1))
}

multiversion! {
    fn place_row(line: Line, directions: &[f32], shares: &mut Shares); ["avx2"] => place_row_plain, else place_row_plain
}

#[inline(always)]
fn place_row_plain(line: Line, directions: &[f32], shares: &mut Shares) {
    let n = directions.len();
    let (cells, bins) = (&mut shares.cells[..n], &mut shares.bins[..n]);
    let (right, lower) = (&mut shares.next[..n], &mut shares.below[..n]);
    // Rounding may put a pixel on the rim's outer edge.
    let last = (RIMMED - 1) as f32 - 1e-4;
    for i in 0..n {
        let place = |k: usize| (line.start[k] + i as f32 * line.step[k]).max(0.0).min(last);
        let (u, v) = (place(0), place(1));
        let (column, row) = (u as i32, v as i32);
        cells[i] = (row * RIMMED as i32 + column) as u32;
        right[i] = u - column as f32;
        lower[i] = v - row as f32;
        bins[i] = bin(directions[i] - line.rotation, DIRECTIONS as f32);
    }
}

multiversion! {
    fn add_row(shares: &Shares, lengths: &[f32], grids: &mut Grids<DIRECTIONS, { RIMMED * RIMMED }>);
    ["avx2"] => shares::add_row::<DIRECTIONS, { RIMMED * RIMMED }, RIMMED>, else shares::add_row::<DIRECTIONS, { RIMMED * RIMMED }, RIMMED>
}

#[cfg(test)]
mod tests {
    use image::{GrayImage, Luma};
    use nalgebra::{Matrix2, Vector2};

    use super::*;

    /// An unbounded texture: waves of several wavelengths in all directions.
    fn texture(place: Vector2<f64>) -> f64 {
        let wave = |k: u32| {
            let (angle, length) = (f64::from(k) * 2.4, 7.0 + f64::from(k * 5 % 23));
            ((place.x * angle.cos() + place.y * angle.sin()) / length * std::f64::consts::TAU + f64::from(k)).sin()
        };
        128.0 + 18.0 * (0..12).map(wave).sum::<f64>()
    }

    const MIDDLE: f64 = 90.0;

    /// The texture with `matrix` applied about the picture's centre.
    fn seen_through(matrix: Matrix2<f64>) -> GrayImage {
        let inverse = matrix.try_inverse().unwrap();
        GrayImage::from_fn(181, 181, |x, y| {
            let place = Vector2::new(f64::from(x) - MIDDLE, f64::from(y) - MIDDLE);
            Luma([texture(inverse * place).round().clamp(0.0, 255.0) as u8])
        })
    }

    /// Regions of the texture, relative to its origin.
    fn regions() -> Vec<Keypoint> {
        let place = |k: u32| Vector2::new(f64::from(k % 4) * 9.0 - 13.5, f64::from(k / 4) * 9.0 - 13.5);
        (0..16).map(|k| Keypoint::round(place(k), 2.5, 1.0)).collect()
    }

    fn describe(picture: &GrayImage, keypoints: &[Keypoint]) -> Features {
        SiftDescriber::default().describe(&PictureForms::new(picture), keypoints)
    }

    fn vectors(features: &Features) -> Vec<&[f32]> {
        let Descriptors::Vectors { length, values } = &features.descriptors else { panic!("no vectors") };
        assert_eq!(*length, LENGTH);
        values.chunks_exact(LENGTH).collect()
    }

    fn distance(a: &[f32], b: &[f32]) -> f32 {
        a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt()
    }

    /// Number of the 16 regions whose nearest descriptor under `matrix` is their own, and the
    /// errors of the directions.
    fn found_again(matrix: Matrix2<f64>) -> (usize, Vec<f64>) {
        let middle = Vector2::from_element(MIDDLE);
        let placed = |matrix: Matrix2<f64>| -> Vec<Keypoint> {
            regions().iter().map(|k| Keypoint { position: matrix * k.position + middle, shape: matrix * k.shape, ..*k }).collect()
        };
        let [a, b] = [Matrix2::identity(), matrix].map(|m| describe(&seen_through(m), &placed(m)));
        let (mut right, mut off) = (0, Vec::new());
        for region in regions() {
            let at =
                |m: Matrix2<f64>, f: &Features| f.keypoints.iter().position(|k| (k.position - m * region.position - middle).norm() < 1e-6);
            let own = at(Matrix2::identity(), &a).unwrap();
            let away = |k: &usize| distance(vectors(&a)[own], vectors(&b)[*k]);
            let nearest = (0..b.keypoints.len()).min_by(|p, q| away(p).total_cmp(&away(q))).unwrap();
            let place = matrix * region.position + middle;
            if (b.keypoints[nearest].position - place).norm() < 1e-6 && away(&nearest) < 0.35 {
                right += 1;
                let expected = matrix * a.keypoints[own].shape.column(0);
                off.push(b.keypoints[nearest].shape.column(0).angle(&expected));
            }
        }
        (right, off)
    }

    #[test]
    fn descriptors_match_under_rotation_scale_and_tilt() {
        let rotation = |angle: f64| Matrix2::new(angle.cos(), -angle.sin(), angle.sin(), angle.cos());
        for (matrix, least) in [
            (rotation(0.7), 16),
            (rotation(-2.9), 16),
            (rotation(0.4) * 1.7, 15),
            (Matrix2::new(1.0, 0.3, 0.0, 1.4), 15),
            (rotation(1.0) * Matrix2::new(2.2, 0.0, 0.0, 0.8) * rotation(0.3), 15),
        ] {
            let (right, off) = found_again(matrix);
            assert!(right >= least, "{matrix}: {right}");
            assert!(off.iter().filter(|o| **o < 0.12).count() >= least, "{matrix}: {off:?}");
        }
    }

    #[test]
    fn descriptors_have_unit_length_and_ignore_lighting() {
        let picture = seen_through(Matrix2::identity());
        let dim = GrayImage::from_fn(181, 181, |x, y| Luma([(picture.get_pixel(x, y)[0] as f32 * 0.6 + 30.0).round() as u8]));
        let middle = Vector2::from_element(MIDDLE);
        let keypoints: Vec<Keypoint> = regions().iter().map(|k| Keypoint { position: k.position + middle, ..*k }).collect();
        for root in [false, true] {
            let describer = SiftDescriber { root };
            let [a, b] = [&picture, &dim].map(|p| describer.describe(&PictureForms::new(p), &keypoints));
            assert!(a.keypoints.len() >= 16);
            for (keypoint, vector) in a.keypoints.iter().zip(vectors(&a)) {
                assert!((distance(vector, &[0.0; LENGTH]) - 1.0).abs() < 1e-4);
                let same = b.keypoints.iter().zip(vectors(&b)).filter(|(k, _)| (k.position - keypoint.position).norm() < 1e-6);
                let nearest = same.map(|(_, v)| distance(vector, v)).fold(f32::MAX, f32::min);
                assert!(nearest < 0.1, "{nearest}");
            }
        }
    }

    #[test]
    fn the_grid_matches_a_plain_implementation() {
        let picture = seen_through(Matrix2::identity());
        let forms = PictureForms::new(&picture);
        for (sigma, direction, middle) in [(1.7, 0.3, 90.2), (4.0, 2.0, 60.0), (2.4, 5.9, 8.4)] {
            let keypoint = Keypoint::round(Vector2::new(middle, 70.7), sigma, 1.0);
            let mut patch = Patch::default();
            let (region, _) = patch.region(&forms, &keypoint).unwrap();
            let fast = Grid::default().gather(&region, direction);
            let plain = plain_grid(&region, f64::from(direction));
            let length = plain.iter().map(|v| v * v).sum::<f64>().sqrt();
            for (a, b) in fast.iter().zip(plain) {
                assert!((f64::from(*a) - b).abs() < 1e-3 * length, "{sigma} {direction}: {a} not {b}");
            }
        }
    }

    /// Like [`Grid::gather`], pixel by pixel and cell by cell.
    fn plain_grid(region: &Region, direction: f64) -> [f64; LENGTH] {
        let (image, cell) = (region.image, CELL_SIGMAS * region.sigma);
        let mut grid = [0.0; LENGTH];
        for (x, y) in (1..image.height - 1).flat_map(|y| (1..image.width - 1).map(move |x| (x, y))) {
            let at = |x: usize, y: usize| f64::from(image.values[y * image.width + x]);
            let (gx, gy) = (at(x + 1, y) - at(x - 1, y), at(x, y + 1) - at(x, y - 1));
            let (dx, dy) = (x as f64 - region.middle.x, y as f64 - region.middle.y);
            let u = (dx * direction.cos() + dy * direction.sin()) / cell;
            let v = (dy * direction.cos() - dx * direction.sin()) / cell;
            let bin = (gy.atan2(gx) - direction).rem_euclid(std::f64::consts::TAU) * 8.0 / std::f64::consts::TAU;
            let weight = gx.hypot(gy) * (-(u * u + v * v) / 8.0).exp();
            for (k, number) in grid.iter_mut().enumerate() {
                let share = |a: f64| (1.0 - a.abs()).max(0.0);
                let away = (bin - (k % 8) as f64).abs();
                *number += weight * share(u + 1.5 - (k / 8 % 4) as f64) * share(v + 1.5 - (k / 32) as f64) * share(away.min(8.0 - away));
            }
        }
        grid
    }

    #[test]
    fn undescribable_keypoints_are_dropped() {
        let picture = seen_through(Matrix2::identity());
        let at = |x: f64, y: f64, shape: Matrix2<f64>| Keypoint { position: Vector2::new(x, y), shape, response: 1.0 };
        let round = Matrix2::identity() * 3.0;
        let needle = Matrix2::new(1e9, 0.0, 0.0, 1.0);
        let bad = [
            at(f64::NAN, 4.0, round),
            at(-5.0, 4.0, round),
            at(50.0, 1e300, round),
            at(50.0, 50.0, Matrix2::zeros()),
            at(50.0, 50.0, round * f64::NAN),
            at(50.0, 50.0, needle),
            at(50.0, 50.0, Matrix2::identity() * f64::INFINITY),
        ];
        assert!(describe(&picture, &bad).keypoints.is_empty());
        assert!(describe(&picture, &[]).descriptors.is_empty());
        // Very small, very large, and at the very corner.
        let odd = [
            at(50.0, 50.0, round * 1e-9),
            at(50.0, 50.0, round * 1e7),
            at(0.0, 0.0, round),
            at(180.0, 180.0, Matrix2::new(9.0, 1.0, 0.0, 2.0)),
        ];
        let features = describe(&picture, &odd);
        assert!(features.keypoints.len() >= 3 && vectors(&features).iter().all(|v| v.iter().all(|n| n.is_finite())));
        for (width, height) in [(0, 0), (1, 1), (200, 1), (64, 64)] {
            let even = GrayImage::from_pixel(width, height, Luma([77]));
            assert!(describe(&even, &[at(0.0, 0.0, round), at(32.0, 32.0, round)]).keypoints.is_empty());
        }
    }
}
