//! Paints the poster's picture: black and white noise with edges of every size, generated from a
//! seed.
//!
//! Which picture constrains a camera's pose best? A pixel contributes its squared gradient over its
//! noise variance (the Cramer-Rao bound), after lens and pixel have blurred the picture to the
//! pixel's own size. So only detail of a few pixels counts, and which detail that is depends on the
//! distance. For a camera at any distance, the picture needs contrast in every octave of sizes that
//! appears as a few pixels from somewhere; and of all pictures with such a spectrum, a purely black
//! and white one has the most contrast. Hence:
//!
//! 1. One layer of smooth noise per octave of sizes, each on its own lattice, rotated against the
//!    others, so that nothing is aligned and nothing repeats.
//! 2. Their sum, with the finer ones slightly weaker, because a distant camera sees only the coarse
//!    ones.
//! 3. Black where the sum is below its median, white above: half of the picture is black, so its
//!    mean is mid-grey however the exposure is metered.
//! 4. Edges two pixels wide, so that the file itself has no steps.

use image::GrayImage;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

/// Number of cells of the coarsest layer's lattice across the picture's shorter side. A cell is
/// about a quarter of a wavelength, so the coarsest shapes are a quarter of the side. A camera at
/// 10 widths, at half its resolution, sees the picture 27 pixels wide, and these shapes as 7 of its
/// pixels. Lowered, most of those pixels lie inside a shape and contribute nothing: with 4, sigma
/// at 10 widths is a sixth larger. Raised, a camera farther away sees grey.
const COARSEST_CELLS: f64 = 16.0;
/// Number of layers, each with cells half the size of the previous one: the last has 1024 across
/// the shorter side, so that its marks are about 1/500 of it. Raised, marks are finer than a
/// printer prints; lowered, a camera at 0.3 widths lacks detail.
const LAYERS: u32 = 7;
/// Strength of a layer relative to the previous, coarser one; 1 gives the same contrast in every
/// octave. A distant camera sees only the coarse layers and loses the contrast spent on fine ones:
/// with 0.6, sigma at 10 widths is a tenth smaller than with 0.8, but at 0.3 widths, where it is
/// smallest by far, twice as large.
const FINER_BY_COARSER: f64 = 0.75;
/// Grey levels of black and white: paper is not 255 and ink not 0, and a camera in bright light
/// should not clip. Wider, the tracker's reference has more contrast than the print; narrower, the
/// print has less than it could.
const LEVELS: [f32; 2] = [20.0, 235.0];
/// Width of an edge in the file, pixels: two keep slanted edges smooth. Raised, the finest marks,
/// three pixels, fade; lowered, edges are staircases.
const EDGE_PX: f32 = 2.0;
/// Rotation from one lattice to the next as (cosine, sine): the golden angle, so that no two
/// lattices are parallel.
const TURN: [f64; 2] = [-0.737_368_878_078_32, 0.675_490_294_261_524];

/// Paints the poster of `seed`, `width` x `height` pixels: identical on every machine. The marks
/// scale with the shorter side.
pub fn paint(width: u32, height: u32, seed: u64) -> GrayImage {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let layers = layers(width, height, &mut random);
    let columns = width as usize;
    let mut field = vec![0.0_f32; columns * height as usize];
    field.par_chunks_mut(columns.max(1)).enumerate().for_each(|(y, row)| layers.iter().for_each(|layer| layer.add(y, row)));
    let median = median(&field);
    let mut picture = GrayImage::new(width, height);
    picture.par_chunks_mut(columns.max(1)).enumerate().for_each(|(y, out)| {
        for (x, level) in out.iter_mut().enumerate() {
            let share = white_share(&field, columns, x, y, median);
            *level = (LEVELS[0] + (LEVELS[1] - LEVELS[0]) * share + 0.5) as u8;
        }
    });
    picture
}

/// Returns how white a pixel is, 0 to 1, from its distance to the nearest edge in edge widths.
fn white_share(field: &[f32], columns: usize, x: usize, y: usize, median: f32) -> f32 {
    let rows = field.len() / columns;
    let at = |x: usize, y: usize| field[y * columns + x];
    let slope_x = (at((x + 1).min(columns - 1), y) - at(x.saturating_sub(1), y)) * 0.5;
    let slope_y = (at(x, (y + 1).min(rows - 1)) - at(x, y.saturating_sub(1))) * 0.5;
    let slope = slope_x.hypot(slope_y).max(1e-6);
    (0.5 + (at(x, y) - median) / (slope * EDGE_PX)).clamp(0.0, 1.0)
}

fn median(field: &[f32]) -> f32 {
    let mut sorted = field.to_vec();
    let middle = sorted.len() / 2;
    *sorted.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// Smooth noise: random numbers on a rotated lattice, interpolated by cubic B-splines.
struct Layer {
    /// The random numbers, row-major, `side` x `side`.
    numbers: Vec<f32>,
    side: usize,
    /// Lattice cells per pixel, along the lattice's own axes: (cosine, sine) times the scale.
    step: [f64; 2],
    /// The picture's centre in lattice coordinates, and in pixels.
    middle: [f64; 2],
    picture_middle: [f64; 2],
}

fn layers(width: u32, height: u32, random: &mut Pcg64Mcg) -> Vec<Layer> {
    let (shorter, diagonal) = (f64::from(width.min(height).max(1)), f64::from(width).hypot(f64::from(height)));
    let mut turn = [1.0, 0.0];
    let (mut cells, mut strength) = (COARSEST_CELLS, 1.0);
    (0..LAYERS)
        .map(|_| {
            turn = [turn[0] * TURN[0] - turn[1] * TURN[1], turn[0] * TURN[1] + turn[1] * TURN[0]];
            // Room for the picture at any rotation, for the spline's support and for the random
            // shift.
            let side = (cells * diagonal / shorter).ceil() as usize + 6;
            let number = |random: &mut Pcg64Mcg| (strength * random.random_range(-1.0..1.0)) as f32;
            let numbers = (0..side * side).map(|_| number(random)).collect();
            let middle = [0, 1].map(|_| 0.5 * (side as f64 - 1.0) + random.random_range(-0.5..0.5));
            let step = turn.map(|part| part * cells / shorter);
            let picture_middle = [width, height].map(|side| 0.5 * (f64::from(side) - 1.0));
            (cells, strength) = (2.0 * cells, FINER_BY_COARSER * strength);
            Layer { numbers, side, step, middle, picture_middle }
        })
        .collect()
}

impl Layer {
    /// Adds the layer to row `y` of the field.
    fn add(&self, y: usize, row: &mut [f32]) {
        let [cosine, sine] = self.step;
        let dy = y as f64 - self.picture_middle[1];
        for (x, sum) in row.iter_mut().enumerate() {
            let dx = x as f64 - self.picture_middle[0];
            *sum += self.at(self.middle[0] + cosine * dx - sine * dy, self.middle[1] + sine * dx + cosine * dy);
        }
    }

    fn at(&self, u: f64, v: f64) -> f32 {
        // The lattice exceeds the picture by more than the spline's support, so the floors are from
        // 1 to side - 3.
        let (i, j) = (u.floor(), v.floor());
        let (across, down) = (spline(u - i), spline(v - j));
        let (i, j) = ((i as usize).clamp(1, self.side - 3), (j as usize).clamp(1, self.side - 3));
        let mut sum = 0.0;
        for (k, weight) in down.iter().enumerate() {
            let numbers = &self.numbers[(j + k - 1) * self.side + i - 1..][..4];
            sum += weight * numbers.iter().zip(&across).map(|(n, w)| n * w).sum::<f32>();
        }
        sum
    }
}

/// Returns the cubic B-spline's four weights at fraction `t` between two lattice points.
fn spline(t: f64) -> [f32; 4] {
    let (t, s) = (t as f32, 1.0 - t as f32);
    [s * s * s / 6.0, (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0, (3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0, t * t * t / 6.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_poster_seed_fixes_its_picture_with_a_mid_grey_mean() {
        let [a, again, other] = [3, 3, 4].map(|seed| paint(340, 480, seed));
        assert_eq!(a, again);
        let differing = a.as_raw().iter().zip(other.as_raw()).filter(|(x, y)| x.abs_diff(**y) > 100).count();
        assert!(differing > a.as_raw().len() / 3, "only {differing} pixels differ");
        for picture in [a, other] {
            let mean = picture.as_raw().iter().map(|&g| f64::from(g)).sum::<f64>() / picture.as_raw().len() as f64;
            assert!((mean - 127.5).abs() < 4.0, "{mean}");
        }
    }

    #[test]
    fn the_poster_keeps_its_contrast_at_a_distance() {
        let mut picture = paint(1700, 1200, 9);
        // RMS grey step between neighbouring pixels at every halving: natural pictures have 5 to
        // 15.
        while picture.width() > 30 {
            let rows = picture.as_raw().chunks_exact(picture.width() as usize);
            let steps: Vec<f64> = rows.flat_map(|row| row.windows(2).map(|p| f64::from(p[0].abs_diff(p[1])).powi(2))).collect();
            let rms = (steps.iter().sum::<f64>() / steps.len() as f64).sqrt();
            assert!(rms > 20.0, "{} pixels wide: {rms}", picture.width());
            picture = image::imageops::thumbnail(&picture, picture.width() / 2, picture.height() / 2);
        }
    }
}
