//! Histograms of gradient directions over a log-polar grid, reduced by principal components (GLOH:
//! Mikolajczyk & Schmid, A Performance Evaluation of Local Descriptors, PAMI 2005, section 4.1).
//!
//! 17 cells (an undivided centre and two rings of eight) with 16 directions each give 272 numbers.
//! Their principal components come from features of the project's own virtual backdrops, rendered
//! from many sides; the test in src/simulate/gloh_basis_tests.rs generates `gloh.basis` and
//! documents how.

use std::f32::consts::TAU;

use super::Describer;
use super::gradients::{Gradients, direction};
use super::orientation::Orientation;
use super::region::{Patch, Region};
use super::shares::{self, Grids, Shares, bin};
use super::sift::normalise;
use super::window::Window;
use crate::features::two_views::keypoint::{Descriptors, Features, Keypoint, PictureForms};
use crate::simd::multiversion;

/// 272 numbers of unit length, or their first 128 principal components.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GlohDescriber {
    /// Whether to reduce to 128 numbers, as in the source. Default true. Without reduction,
    /// matching takes twice as long.
    pub reduced: bool,
}

impl Default for GlohDescriber {
    fn default() -> Self {
        Self { reduced: true }
    }
}

/// Outer radii of the centre and of both rings (section 4.1), pixels of the normalised region.
const RADII: [f32; 3] = [6.0, 11.0, 15.0];
/// Sectors per ring (section 4.1).
const SECTORS: usize = 8;
/// Directions per histogram (section 4.1).
const DIRECTIONS: usize = 16;
/// Number of cells: the centre, the inner ring, the outer ring.
const PLACES: usize = 1 + 2 * SECTORS;
/// Length before reduction.
pub const FULL_LENGTH: usize = PLACES * DIRECTIONS;
/// Length after reduction (section 4.1).
pub const REDUCED_LENGTH: usize = 128;
/// Pixels of the normalised region per sigma of the keypoint: the grid is as wide as SIFT's, whose
/// half width is six sigmas. Raised, the grid covers less of the picture and is less distinctive.
const PIXELS_PER_SIGMA: f64 = 2.5;

impl Describer for GlohDescriber {
    fn describe(&self, picture: &PictureForms, keypoints: &[Keypoint]) -> Features {
        let reduction = self.reduced.then(|| Reduction::by(&Basis::own()));
        let length = if self.reduced { REDUCED_LENGTH } else { FULL_LENGTH };
        let (mut described, mut values) = (Vec::with_capacity(keypoints.len()), Vec::with_capacity(keypoints.len() * length));
        let (mut patch, mut orientation, mut grid) = (Patch::default(), Orientation::default(), PolarGrid::default());
        for keypoint in picture.watch.over(keypoints) {
            let Some((region, keypoint)) = patch.region(picture, keypoint) else { continue };
            for direction in orientation.directions(&region) {
                let mut numbers = grid.gather(&region, direction);
                if normalise(&mut numbers, true) {
                    described.push(keypoint.rotated(f64::from(direction)));
                    match &reduction {
                        Some(reduction) => values.extend(reduction.of(&numbers)),
                        None => values.extend(numbers),
                    }
                }
            }
        }
        Features { keypoints: described, descriptors: Descriptors::Vectors { length, values } }
    }
}

/// Mean and principal components of descriptors.
#[derive(Debug, Clone, PartialEq)]
pub struct Basis {
    /// `FULL_LENGTH` numbers.
    pub mean: Vec<f32>,
    /// `REDUCED_LENGTH` unit vectors of `FULL_LENGTH` numbers, largest variance first.
    pub components: Vec<f32>,
}

impl Basis {
    /// Returns the project's own basis.
    pub fn own() -> Self {
        Self::from_bytes(include_bytes!("gloh.basis"))
    }

    /// Parses a file: the mean as `f32`, then each component as an `f32` scale and signed bytes;
    /// little-endian. Missing data are 0.
    pub fn from_bytes(bytes: &[u8]) -> Self {
        let number = |b: &[u8]| b.first_chunk().map_or(0.0, |four| f32::from_le_bytes(*four));
        let (mean, rest) = bytes.split_at(bytes.len().min(4 * FULL_LENGTH));
        let component = |part: &[u8]| {
            let scale = number(part);
            part.iter().skip(4).map(move |b| f32::from(*b as i8) * scale).collect::<Vec<f32>>()
        };
        let mut mean: Vec<f32> = mean.chunks(4).map(number).collect();
        let mut components: Vec<f32> = rest.chunks(4 + FULL_LENGTH).flat_map(component).collect();
        mean.resize(FULL_LENGTH, 0.0);
        components.resize(REDUCED_LENGTH * FULL_LENGTH, 0.0);
        Self { mean, components }
    }

    /// Writes the file; a component's largest number becomes 127.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes: Vec<u8> = self.mean.iter().flat_map(|v| v.to_le_bytes()).collect();
        for component in self.components.chunks_exact(FULL_LENGTH) {
            let scale = component.iter().fold(f32::MIN_POSITIVE, |a, b| a.max(b.abs())) / 127.0;
            bytes.extend(scale.to_le_bytes());
            bytes.extend(component.iter().map(|v| (v / scale).round() as i8 as u8));
        }
        bytes
    }
}

/// Applies the reduction.
struct Reduction {
    mean: Vec<f32>,
    /// For each input number its contribution to all components, so that these are summed side by
    /// side.
    parts: Vec<[f32; REDUCED_LENGTH]>,
}

impl Reduction {
    fn by(basis: &Basis) -> Self {
        let part = |k: usize| std::array::from_fn(|component| basis.components[component * FULL_LENGTH + k]);
        Self { mean: basis.mean.clone(), parts: (0..FULL_LENGTH).map(part).collect() }
    }

    /// Returns the components of a descriptor.
    fn of(&self, numbers: &[f32; FULL_LENGTH]) -> [f32; REDUCED_LENGTH] {
        let mut out = [0.0; REDUCED_LENGTH];
        let centred: [f32; FULL_LENGTH] = std::array::from_fn(|k| numbers[k] - self.mean[k]);
        multiply(&self.parts, &centred, &mut out);
        out
    }
}

multiversion! {
    /// Sums the contributions of all numbers.
    fn multiply(parts: &[[f32; REDUCED_LENGTH]], numbers: &[f32], out: &mut [f32; REDUCED_LENGTH]); ["avx2"] => multiply_plain, else multiply_plain
}

/// Number of components summed in registers at once: eight AVX2 registers. Raised, they no longer
/// fit beside the operands.
const BLOCK: usize = 64;

#[inline(always)]
fn multiply_plain(parts: &[[f32; REDUCED_LENGTH]], numbers: &[f32], out: &mut [f32; REDUCED_LENGTH]) {
    for (k, block) in out.as_chunks_mut::<BLOCK>().0.iter_mut().enumerate() {
        let mut sums = [0.0; BLOCK];
        for (part, number) in parts.iter().zip(numbers) {
            let part = &part.as_chunks::<BLOCK>().0[k];
            for i in 0..BLOCK {
                sums[i] += part[i] * number;
            }
        }
        *block = sums;
    }
}

/// Cells per ring, with the first one repeated at the end so that the last one has a successor. The
/// centre is stored as a ring and summed.
const ROW: usize = SECTORS + 1;
/// Total number of stored cells: the centre and both rings.
const CELLS: usize = 3 * ROW;

#[derive(Debug, Default)]
struct PolarGrid {
    window: Window,
    gradients: Gradients,
    shares: Shares,
}

/// A row of pixels relative to a region's centre.
#[derive(Debug, Clone, Copy)]
struct Line {
    /// Column and row of the first pixel.
    start: [f32; 2],
    /// Pixels of the normalised region per pixel.
    scale: f32,
    /// Rotation of the grid, radians.
    angle: f32,
}

impl PolarGrid {
    /// Returns the histograms of a region with the grid rotated by `angle` radians: the centre, the
    /// inner ring from that direction on, the outer ring.
    fn gather(&mut self, region: &Region, angle: f32) -> [f32; FULL_LENGTH] {
        let pixel = region.sigma / PIXELS_PER_SIGMA;
        let reach = f64::from(RADII[2] + OUTER_FADE) * pixel;
        self.window.set(region, reach, f64::from(RADII[2]) * pixel);
        // Wrapped to -pi..pi, so that no relative angle is below minus two turns.
        let angle = angle - TAU * (angle / TAU).round();
        let mut grids = [[[0.0; DIRECTIONS]; CELLS]; 2];
        for y in self.window.rows() {
            let half = (reach * reach - (y as f64 - region.middle.y).powi(2)).max(0.0).sqrt();
            let Some(row) = self.window.row(region, y, -half, half) else { continue };
            self.gradients.of_row(row.rows, row.weights, row.weight);
            let line = Line { start: row.place, scale: (1.0 / pixel) as f32, angle };
            self.shares.resize(self.gradients.directions.len());
            place_row(line, &self.gradients.directions, &mut self.gradients.lengths, &mut self.shares);
            add_row(&self.shares, &self.gradients.lengths, &mut grids);
        }
        let cell = |cell: usize, bin: usize| grids[0][cell][bin] + grids[1][cell][bin];
        std::array::from_fn(|k| {
            let (place, bin) = (k / DIRECTIONS, k % DIRECTIONS);
            if place == 0 {
                return (0..ROW).map(|sector| cell(sector, bin)).sum();
            }
            let (first, sector) = (ROW * (1 + (place - 1) / SECTORS), (place - 1) % SECTORS);
            cell(first + sector, bin) + if sector == 0 { cell(first + SECTORS, bin) } else { 0.0 }
        })
    }
}

/// Distance over which weights fade out at the outer ring, pixels of the normalised region, either
/// way: half the ring's width. Raised, the fade starts earlier.
const OUTER_FADE: f32 = 2.0;

/// Returns the radial position of a pixel `radius` from the centre, interpolated between the
/// mid-radii of the centre (0), the inner ring (1) and the outer ring (2); and its weight after
/// fading.
#[inline(always)]
fn ring(radius: f32) -> (f32, f32) {
    let middles = [0.5 * RADII[0], 0.5 * (RADII[0] + RADII[1]), 0.5 * (RADII[1] + RADII[2])];
    let between = |low: f32, high: f32| ((radius - low) / (high - low)).clamp(0.0, 1.0);
    let inside = 1.0 - between(RADII[2] - OUTER_FADE, RADII[2] + OUTER_FADE);
    (between(middles[0], middles[1]) + between(middles[1], middles[2]), inside)
}

multiversion! {
    /// Fills the shares of a row, and fades out the lengths.
    fn place_row(line: Line, directions: &[f32], lengths: &mut [f32], shares: &mut Shares); ["avx2"] => place_row_plain, else place_row_plain
}

#[inline(always)]
fn place_row_plain(line: Line, directions: &[f32], lengths: &mut [f32], shares: &mut Shares) {
    let n = directions.len();
    let (lengths, cells, bins) = (&mut lengths[..n], &mut shares.cells[..n], &mut shares.bins[..n]);
    let (next, outer) = (&mut shares.next[..n], &mut shares.below[..n]);
    for i in 0..n {
        let (x, y) = (line.start[0] + i as f32, line.start[1]);
        let (place, inside) = ring((x * x + y * y).sqrt() * line.scale);
        let place = place.min(2.0 - 1e-6);
        // Rounding may turn a value slightly below 0 into a whole turn.
        let sector = bin(direction(x, y) - line.angle, SECTORS as f32).min(SECTORS as f32 - 1e-6);
        let (first, column) = (place as i32, sector as i32);
        cells[i] = (first * ROW as i32 + column) as u32;
        next[i] = sector - column as f32;
        outer[i] = place - first as f32;
        bins[i] = bin(directions[i] - line.angle, DIRECTIONS as f32);
        lengths[i] *= inside;
    }
}

multiversion! {
    fn add_row(shares: &Shares, lengths: &[f32], grids: &mut Grids<DIRECTIONS, CELLS>);
    ["avx2"] => shares::add_row::<DIRECTIONS, CELLS, ROW>, else shares::add_row::<DIRECTIONS, CELLS, ROW>
}

#[cfg(test)]
mod tests {
    use image::{GrayImage, Luma};
    use nalgebra::{Matrix2, Vector2};

    use super::*;
    use crate::features::two_views::FloatImage;
    use crate::features::two_views::detectors::{Detector, SiftDetector};

    fn grid(level: impl Fn(f32, f32) -> f32, angle: f32) -> [f32; FULL_LENGTH] {
        let values = (0..81 * 81).map(|k| level((k % 81) as f32 - 40.0, (k / 81) as f32 - 40.0)).collect();
        let image = FloatImage { width: 81, height: 81, values };
        let region = Region { image: &image, middle: Vector2::repeat(40.0), sigma: 5.0 };
        PolarGrid::default().gather(&region, angle)
    }

    #[test]
    fn an_edge_falls_into_its_location_and_direction_bins() {
        // An edge along y, 16 pixels to the right, 8 of the normalised region: the inner ring's
        // first sector, direction 0.
        let numbers = grid(|x, _| if x > 16.0 { 100.0 } else { 0.0 }, 0.0);
        let largest = (0..FULL_LENGTH).max_by(|a, b| numbers[*a].total_cmp(&numbers[*b]));
        assert_eq!(largest, Some(DIRECTIONS));
        let of_other_direction: f32 = numbers.iter().enumerate().filter(|(k, _)| k % DIRECTIONS != 0).map(|(_, v)| v).sum();
        assert!(of_other_direction < 1e-3 * numbers.iter().sum::<f32>());
        // In a frame rotated by a quarter turn it is a quarter earlier: sector 6, direction 12.
        let rotated = grid(|x, _| if x > 16.0 { 100.0 } else { 0.0 }, TAU / 4.0);
        let largest = (0..FULL_LENGTH).max_by(|a, b| rotated[*a].total_cmp(&rotated[*b]));
        assert_eq!(largest, Some((1 + 6) * DIRECTIONS + 12));
    }

    /// Like [`PolarGrid::gather`], pixel by pixel and cell by cell.
    fn plain_grid(region: &Region, angle: f64) -> Vec<f64> {
        let (image, pixel) = (region.image, region.sigma / PIXELS_PER_SIGMA);
        let mut histograms = vec![0.0; FULL_LENGTH];
        let around = |angle: f64, count: usize, bin: usize| {
            let away = (angle / f64::from(TAU) * count as f64 - bin as f64).rem_euclid(count as f64);
            (1.0 - away.min(count as f64 - away)).max(0.0)
        };
        for (x, y) in (1..image.height - 1).flat_map(|y| (1..image.width - 1).map(move |x| (x, y))) {
            let at = |x: usize, y: usize| f64::from(image.values[y * image.width + x]);
            let (gx, gy) = (at(x + 1, y) - at(x - 1, y), at(x, y + 1) - at(x, y - 1));
            let d = (Vector2::new(x as f64, y as f64) - region.middle) / pixel;
            // Mid-radii of the rings: 3, 8.5 and 13 pixels; weights fade out from 13 to 17.
            let radius = d.norm();
            let fade = ((17.0 - radius) / 4.0).clamp(0.0, 1.0);
            let rings = [(8.5 - radius) / 5.5, ((radius - 3.0) / 5.5).min((13.0 - radius) / 4.5), (radius - 8.5) / 4.5];
            let length = gx.hypot(gy) * (-0.5 * d.norm_squared() / 225.0).exp() * fade;
            for (k, number) in histograms.iter_mut().enumerate() {
                let (place, bin) = (k / DIRECTIONS, k % DIRECTIONS);
                let ring = if place == 0 { 0 } else { 1 + (place - 1) / SECTORS };
                let sector = if place == 0 { 1.0 } else { around(d.y.atan2(d.x) - angle, SECTORS, (place - 1) % SECTORS) };
                *number += length * rings[ring].clamp(0.0, 1.0) * sector * around(gy.atan2(gx) - angle, DIRECTIONS, bin);
            }
        }
        histograms
    }

    #[test]
    fn the_grid_matches_a_plain_implementation() {
        let value = |k: usize| ((k % 71 / 6 * 73 + k / 71 / 5 * 151 + k * 37 % 29) % 200) as f32;
        let image = FloatImage { width: 71, height: 64, values: (0..71 * 64).map(value).collect() };
        for (sigma, angle, middle) in
            [(1.7, 0.3, [35.2, 30.0]), (3.3, 6.1, [30.0, 33.3]), (2.4, -2.5, [4.4, 60.1]), (2.0, 0.0, [40.0, 30.0])]
        {
            let region = Region { image: &image, middle: Vector2::from(middle), sigma };
            let fast = PolarGrid::default().gather(&region, angle);
            let plain = plain_grid(&region, f64::from(angle));
            let length = plain.iter().map(|v| v * v).sum::<f64>().sqrt();
            for (k, (a, b)) in fast.iter().zip(plain).enumerate() {
                assert!((f64::from(*a) - b).abs() < 1e-3 * length, "{sigma} {angle}, {k}: {a} not {b}");
            }
        }
    }

    #[test]
    fn a_reduced_descriptor_is_the_projection_on_each_component() {
        let (basis, numbers) = (Basis::own(), std::array::from_fn(|k| (k * 7 % 13) as f32 * 0.01));
        let reduced = Reduction::by(&basis).of(&numbers);
        for (value, component) in reduced.iter().zip(basis.components.chunks_exact(FULL_LENGTH)) {
            let exact: f32 = component.iter().zip(&numbers).zip(&basis.mean).map(|((c, v), m)| c * (v - m)).sum();
            assert!((value - exact).abs() < 1e-5, "{value} not {exact}");
        }
    }

    #[test]
    fn a_pixels_bin_weights_sum_to_one() {
        // Shares of two neighbours add up to 1 by construction; the rings' total is limited only by
        // the fade.
        for (radius, place, inside) in
            [(0.0, 0.0, 1.0), (3.0, 0.0, 1.0), (5.75, 0.5, 1.0), (8.5, 1.0, 1.0), (13.0, 2.0, 1.0), (15.0, 2.0, 0.5)]
        {
            let found = ring(radius);
            assert!((found.0 - place).abs() < 1e-6 && (found.1 - inside).abs() < 1e-6, "{radius}: {found:?}");
        }
        assert_eq!(ring(17.0).1, 0.0);
        // Exactly on a bin, all around, and so close below 0 that rounding makes it a whole turn.
        assert_eq!(bin(0.0, 8.0), 0.0);
        assert!((-60..30).all(|k| (0.0..=8.0).contains(&bin(f32::from(k as i8) * 0.2, 8.0))));
        assert!(bin(-1e-9, 8.0) <= 8.0);
        let mut shares = Shares::default();
        shares.resize(1);
        place_row(Line { start: [1.0, -1e-9], scale: 1.0, angle: 0.0 }, &[-1e-9], &mut [1.0], &mut shares);
        let mut grids = [[[0.0; DIRECTIONS]; CELLS]; 2];
        add_row(&shares, &[1.0], &mut grids);
        assert!((grids.iter().flatten().flatten().sum::<f32>() - 1.0).abs() < 1e-5);
    }

    #[test]
    fn the_built_in_basis_is_orthonormal() {
        let basis = Basis::own();
        let components: Vec<&[f32]> = basis.components.chunks_exact(FULL_LENGTH).collect();
        assert_eq!((components.len(), basis.mean.len()), (REDUCED_LENGTH, FULL_LENGTH));
        for (i, a) in components.iter().enumerate() {
            for (k, b) in components.iter().enumerate() {
                let product: f32 = a.iter().zip(*b).map(|(a, b)| a * b).sum();
                assert!((product - f32::from(i == k)).abs() < 0.03, "{i} {k}: {product}");
            }
        }
        // A truncated file causes no panic.
        assert_eq!(Basis::from_bytes(&[]).components.len(), REDUCED_LENGTH * FULL_LENGTH);
        assert_eq!(Basis::from_bytes(&basis.to_bytes()), basis);
    }

    #[test]
    fn descriptors_match_in_a_rotated_picture() {
        let level = |x: u32, y: u32| ((x / 11 * 73 + y / 9 * 151 + (x * x + y * 3) / 400 * 37) % 200 + 20) as u8;
        let picture = GrayImage::from_fn(150, 130, |x, y| Luma([level(x, y)]));
        let rotated = image::imageops::rotate90(&picture);
        let forms = [&picture, &rotated].map(PictureForms::new);
        let place = |p: Vector2<f64>| Vector2::new(129.0 - p.y, p.x);
        for (describer, length) in [(GlohDescriber { reduced: true }, REDUCED_LENGTH), (GlohDescriber { reduced: false }, FULL_LENGTH)] {
            let keypoints = SiftDetector { count: 60, ..Default::default() }.detect(&forms[0]);
            let other: Vec<Keypoint> = keypoints.iter().map(|k| Keypoint { position: place(k.position), ..*k }).collect();
            let [a, b] = [describer.describe(&forms[0], &keypoints), describer.describe(&forms[1], &other)];
            let [p, q] = [&a, &b].map(|f| match &f.descriptors {
                Descriptors::Vectors { length: own, values } if *own == length => values.chunks_exact(length).collect::<Vec<_>>(),
                _ => Vec::new(),
            });
            assert!(p.len() >= 30, "{}", p.len());
            let distance = |v: &[f32], w: &[f32]| v.iter().zip(w).map(|(v, w)| (v - w) * (v - w)).sum::<f32>();
            let nearest = |v: &[f32]| (0..q.len()).min_by(|i, k| distance(v, q[*i]).total_cmp(&distance(v, q[*k])));
            let right =
                |k: &usize| nearest(p[*k]).is_some_and(|n| (b.keypoints[n].position - place(a.keypoints[*k].position)).norm() < 1e-6);
            let count = (0..p.len()).filter(right).count();
            assert!(10 * count >= 9 * p.len(), "{count} of {}", p.len());
        }
    }

    #[test]
    fn undescribable_keypoints_are_dropped() {
        let even = GrayImage::from_pixel(64, 64, Luma([77]));
        let at = |x: f64, shape: Matrix2<f64>| Keypoint { position: Vector2::new(x, 30.0), shape, response: 1.0 };
        let keypoints = [at(30.0, Matrix2::identity()), at(f64::NAN, Matrix2::identity()), at(3.0, Matrix2::zeros())];
        assert!(GlohDescriber::default().describe(&PictureForms::new(&even), &keypoints).descriptors.is_empty());
        assert!(GlohDescriber::default().describe(&PictureForms::new(&GrayImage::new(0, 0)), &keypoints).keypoints.is_empty());
    }
}
