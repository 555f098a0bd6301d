//! Histograms of gradient directions over a log-polar grid, reduced by principal components (GLOH: Mikolajczyk & Schmid, A Performance Evaluation of
//! Local Descriptors, PAMI 2005, section 4.1).
//!
//! 17 places (one in the middle, which is not divided, and two rings of eight) with 16 directions each are 272 numbers. Their principal
//! components come from features of the project's own virtual backdrops, rendered from many sides; the test in src/simulate/gloh_basis_tests.rs
//! makes `gloh.basis` and says how.

use std::f32::consts::TAU;

use super::Describer;
use super::gradients::{Gradients, direction};
use super::orientation::Orientation;
use super::region::{Patch, Region};
use super::sift::normalise;
use super::window::Window;
use crate::features::keypoint::{Descriptors, Features, Keypoint, PictureForms};

/// 272 numbers of unit length, or their first 128 principal components.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GlohDescriber {
    /// Reduce to 128 numbers, as the source does. Default true. Without, matching takes twice as long.
    pub reduced: bool,
}

impl Default for GlohDescriber {
    fn default() -> Self {
        Self { reduced: true }
    }
}

/// Outer radii of the middle and of both rings (section 4.1), pixels of the normalised region.
const RADII: [f32; 3] = [6.0, 11.0, 15.0];
/// Parts of a ring (section 4.1).
const SECTORS: usize = 8;
/// Directions of a histogram (section 4.1).
const DIRECTIONS: usize = 16;
/// The middle, the inner ring, the outer ring.
const PLACES: usize = 1 + 2 * SECTORS;
/// Numbers before reduction.
pub const FULL_LENGTH: usize = PLACES * DIRECTIONS;
/// Numbers after it (section 4.1).
pub const REDUCED_LENGTH: usize = 128;
/// Pixels of the normalised region in a sigma of the keypoint: the grid is as wide as SIFT's, whose half is six sigmas. Raised, the grid covers
/// less of the picture and is less distinctive.
const PIXELS_PER_SIGMA: f64 = 2.5;

impl Describer for GlohDescriber {
    fn describe(&self, picture: &PictureForms, keypoints: &[Keypoint]) -> Features {
        let basis = self.reduced.then(Basis::own);
        let length = if self.reduced { REDUCED_LENGTH } else { FULL_LENGTH };
        let (mut described, mut values) = (Vec::with_capacity(keypoints.len()), Vec::with_capacity(keypoints.len() * length));
        let (mut patch, mut orientation, mut grid) = (Patch::default(), Orientation::default(), PolarGrid::default());
        for keypoint in keypoints {
            let Some((region, keypoint)) = patch.region(picture, keypoint) else { continue };
            for direction in orientation.directions(&region) {
                let mut numbers = grid.gather(&region, direction);
                if normalise(&mut numbers, true) {
                    described.push(keypoint.turned(f64::from(direction)));
                    match &basis {
                        Some(basis) => basis.reduce(&numbers, &mut values),
                        None => values.extend(numbers),
                    }
                }
            }
        }
        Features { keypoints: described, descriptors: Descriptors::Vectors { length, values } }
    }
}

/// Mean and principal components of descriptions.
#[derive(Debug, Clone, PartialEq)]
pub struct Basis {
    /// [`FULL_LENGTH`] numbers.
    pub mean: Vec<f32>,
    /// [`REDUCED_LENGTH`] unit vectors of [`FULL_LENGTH`] numbers, that of the largest variance first.
    pub components: Vec<f32>,
}

impl Basis {
    /// That of the project.
    pub fn own() -> Self {
        Self::from_bytes(include_bytes!("gloh.basis"))
    }

    /// From a file: the mean as `f32`, then each component as an `f32` that multiplies its signed bytes; little-endian. What is missing is 0.
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

    /// The file of it: a component's largest number becomes 127.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes: Vec<u8> = self.mean.iter().flat_map(|v| v.to_le_bytes()).collect();
        for component in self.components.chunks_exact(FULL_LENGTH) {
            let scale = component.iter().fold(f32::MIN_POSITIVE, |a, b| a.max(b.abs())) / 127.0;
            bytes.extend(scale.to_le_bytes());
            bytes.extend(component.iter().map(|v| (v / scale).round() as i8 as u8));
        }
        bytes
    }

    /// Adds the components of a description.
    fn reduce(&self, numbers: &[f32; FULL_LENGTH], values: &mut Vec<f32>) {
        let centred: Vec<f32> = numbers.iter().zip(&self.mean).map(|(v, m)| v - m).collect();
        let along = |component: &[f32]| component.iter().zip(&centred).map(|(c, v)| c * v).sum::<f32>();
        values.extend(self.components.chunks_exact(FULL_LENGTH).map(along));
    }
}

/// Buffers.
#[derive(Debug, Default)]
struct PolarGrid {
    window: Window,
    gradients: Gradients,
}

impl PolarGrid {
    /// The histograms of a region, its grid turned to `turn` radians: the middle, the inner ring from that direction on, the outer ring.
    fn gather(&mut self, region: &Region, turn: f32) -> [f32; FULL_LENGTH] {
        let pixel = region.sigma / PIXELS_PER_SIGMA;
        let reach = f64::from(RADII[2] + OUTER_FADE) * pixel;
        self.window.set(region, reach, f64::from(RADII[2]) * pixel);
        let mut histograms = [[0.0; DIRECTIONS]; PLACES];
        for y in self.window.rows() {
            let half = (reach * reach - (y as f64 - region.middle.y).powi(2)).max(0.0).sqrt();
            let Some(row) = self.window.row(region, y, -half, half) else { continue };
            self.gradients.of_row(row.rows, row.weights, row.weight);
            for (i, (length, slope)) in self.gradients.lengths.iter().zip(&self.gradients.directions).enumerate() {
                let (dx, dy) = (row.place[0] + i as f32, row.place[1]);
                let radius = dx.hypot(dy) / pixel as f32;
                let sector = bins(direction(dx, dy) - turn, SECTORS);
                let bin = bins(slope - turn, DIRECTIONS);
                for (ring, share) in rings(radius) {
                    add(&mut histograms, ring, sector, bin, share * length);
                }
            }
        }
        std::array::from_fn(|k| histograms[k / DIRECTIONS][k % DIRECTIONS])
    }
}

/// Pixels of the normalised region over which what lies outside of the outer ring fades out: half the ring.
const OUTER_FADE: f32 = 2.0;

/// The two rings that share a pixel `radius` from the middle, by its distance to the middles of both; 0 is the undivided middle.
fn rings(radius: f32) -> [(usize, f32); 2] {
    let middles = [0.5 * RADII[0], 0.5 * (RADII[0] + RADII[1]), 0.5 * (RADII[1] + RADII[2])];
    let between = |low: f32, high: f32| ((radius - low) / (high - low)).clamp(0.0, 1.0);
    if radius < middles[1] {
        let share = between(middles[0], middles[1]);
        return [(0, 1.0 - share), (1, share)];
    }
    let share = between(middles[1], middles[2]);
    let inside = 1.0 - between(RADII[2] - OUTER_FADE, RADII[2] + OUTER_FADE);
    [(1, (1.0 - share) * inside), (2, share * inside)]
}

/// The two of `count` bins around the circle that share an angle, and the second one's share.
fn bins(angle: f32, count: usize) -> (usize, usize, f32) {
    let place = angle.rem_euclid(TAU) * (count as f32 / TAU);
    let first = place as usize;
    (first % count, (first + 1) % count, (place - first as f32).clamp(0.0, 1.0))
}

/// Adds a pixel to a ring.
fn add(
    histograms: &mut [[f32; DIRECTIONS]; PLACES],
    ring: usize,
    sector: (usize, usize, f32),
    (first, second, share): (usize, usize, f32),
    length: f32,
) {
    // The middle takes all, a ring by sector.
    let place = |sector: usize| if ring == 0 { 0 } else { 1 + (ring - 1) * SECTORS + sector };
    for (place, part) in [(place(sector.0), 1.0 - sector.2), (place(sector.1), sector.2)] {
        histograms[place][first] += length * part * (1.0 - share);
        histograms[place][second] += length * part * share;
    }
}

#[cfg(test)]
mod tests {
    use image::{GrayImage, Luma};
    use nalgebra::{Matrix2, Vector2};

    use super::*;
    use crate::features::FloatImage;
    use crate::features::detectors::{Detector, SiftDetector};

    fn grid(level: impl Fn(f32, f32) -> f32, turn: f32) -> [f32; FULL_LENGTH] {
        let values = (0..81 * 81).map(|k| level((k % 81) as f32 - 40.0, (k / 81) as f32 - 40.0)).collect();
        let image = FloatImage { width: 81, height: 81, values };
        let region = Region { image: &image, middle: Vector2::repeat(40.0), sigma: 5.0 };
        PolarGrid::default().gather(&region, turn)
    }

    #[test]
    fn an_edge_is_in_the_places_and_the_direction_where_it_is() {
        // Along y at 16 pixels to the right, which are 8 of the normalised region: the inner ring's first sector, direction 0.
        let numbers = grid(|x, _| if x > 16.0 { 100.0 } else { 0.0 }, 0.0);
        let largest = (0..FULL_LENGTH).max_by(|a, b| numbers[*a].total_cmp(&numbers[*b]));
        assert_eq!(largest, Some(DIRECTIONS));
        let of_other_direction: f32 = numbers.iter().enumerate().filter(|(k, _)| k % DIRECTIONS != 0).map(|(_, v)| v).sum();
        assert!(of_other_direction < 1e-3 * numbers.iter().sum::<f32>());
        // Seen from a frame turned by a quarter, it lies a quarter before: sector 6, direction 12.
        let turned = grid(|x, _| if x > 16.0 { 100.0 } else { 0.0 }, TAU / 4.0);
        let largest = (0..FULL_LENGTH).max_by(|a, b| turned[*a].total_cmp(&turned[*b]));
        assert_eq!(largest, Some((1 + 6) * DIRECTIONS + 12));
    }

    #[test]
    fn a_pixel_counts_once_however_it_is_shared() {
        for k in 0..=65_u8 {
            let radius = f32::from(k) * 0.2;
            let sum: f32 = rings(radius).iter().map(|(_, share)| share).sum();
            assert!((sum - 1.0).abs() < 1e-5, "{radius}: {sum}");
            let (first, second, share) = bins(f32::from(k) - 30.0, SECTORS);
            assert!(first < SECTORS && second == (first + 1) % SECTORS && (0.0..=1.0).contains(&share));
        }
        assert_eq!(rings(17.0).map(|(_, share)| share), [0.0, 0.0]);
        // Exactly on a bin, and so close below 0 that rounding makes it a whole turn.
        assert_eq!(bins(0.0, 8), (0, 1, 0.0));
        assert!(bins(-1e-9, 8).0 < 8);
    }

    #[test]
    fn the_own_basis_is_of_unit_vectors_at_right_angles() {
        let basis = Basis::own();
        let components: Vec<&[f32]> = basis.components.chunks_exact(FULL_LENGTH).collect();
        assert_eq!((components.len(), basis.mean.len()), (REDUCED_LENGTH, FULL_LENGTH));
        for (i, a) in components.iter().enumerate() {
            for (k, b) in components.iter().enumerate() {
                let product: f32 = a.iter().zip(*b).map(|(a, b)| a * b).sum();
                assert!((product - f32::from(i == k)).abs() < 0.03, "{i} {k}: {product}");
            }
        }
        // A file that was cut off is no panic.
        assert_eq!(Basis::from_bytes(&[]).components.len(), REDUCED_LENGTH * FULL_LENGTH);
        assert_eq!(Basis::from_bytes(&basis.to_bytes()), basis);
    }

    #[test]
    fn the_same_place_is_known_again_when_the_picture_is_turned() {
        let level = |x: u32, y: u32| ((x / 11 * 73 + y / 9 * 151 + (x * x + y * 3) / 400 * 37) % 200 + 20) as u8;
        let picture = GrayImage::from_fn(150, 130, |x, y| Luma([level(x, y)]));
        let turned = image::imageops::rotate90(&picture);
        let forms = [&picture, &turned].map(PictureForms::new);
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
    fn what_cannot_be_described_is_left_out() {
        let even = GrayImage::from_pixel(64, 64, Luma([77]));
        let at = |x: f64, shape: Matrix2<f64>| Keypoint { position: Vector2::new(x, 30.0), shape, response: 1.0 };
        let keypoints = [at(30.0, Matrix2::identity()), at(f64::NAN, Matrix2::identity()), at(3.0, Matrix2::zeros())];
        assert!(GlohDescriber::default().describe(&PictureForms::new(&even), &keypoints).descriptors.is_empty());
        assert!(GlohDescriber::default().describe(&PictureForms::new(&GrayImage::new(0, 0)), &keypoints).keypoints.is_empty());
    }
}
