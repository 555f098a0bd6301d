//! A canvas to paint on: antialiased polygons and brush strokes in colour, and the noise functions
//! that textures are made from.

use image::{Rgb, RgbImage};

/// Red, green, blue from 0 to 1.
pub(super) type Colour = [f32; 3];

/// A picture being painted. Positions are in pixels, centres at integers.
#[derive(Debug)]
pub(super) struct Canvas {
    width: usize,
    height: usize,
    colours: Vec<Colour>,
}

impl Canvas {
    /// Makes a canvas with a colour for every pixel.
    pub(super) fn from_fn(width: u32, height: u32, colour: impl Fn(f32, f32) -> Colour) -> Self {
        let (width, height) = (width as usize, height as usize);
        let colours = (0..width * height).map(|i| colour((i % width) as f32, (i / width) as f32)).collect();
        Self { width, height, colours }
    }

    /// Blends a colour into the box around a shape; `coverage` is 0 to 1 at a pixel.
    fn lay(&mut self, from: [f32; 2], to: [f32; 2], colour: Colour, coverage: impl Fn(f32, f32) -> f32) {
        let range = |low: f32, high: f32, size: usize| (low - 1.0).max(0.0) as usize..((high + 2.0).max(0.0) as usize).min(size);
        for y in range(from[1], to[1], self.height) {
            for x in range(from[0], to[0], self.width) {
                let share = coverage(x as f32, y as f32);
                if share > 0.0 {
                    let under = &mut self.colours[y * self.width + x];
                    *under = mix(*under, colour, share);
                }
            }
        }
    }

    /// Fills a convex polygon, with its corners in either order.
    pub(super) fn polygon(&mut self, corners: &[[f32; 2]], colour: Colour, opacity: f32) {
        let fold = |axis: usize, pick: fn(f32, f32) -> f32, start: f32| corners.iter().map(|c| c[axis]).fold(start, pick);
        let from = [fold(0, f32::min, f32::INFINITY), fold(1, f32::min, f32::INFINITY)];
        let to = [fold(0, f32::max, f32::NEG_INFINITY), fold(1, f32::max, f32::NEG_INFINITY)];
        let edges: Vec<_> = corners.iter().zip(corners.iter().cycle().skip(1)).collect();
        let area: f32 = edges.iter().map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum();
        let sense = area.signum();
        self.lay(from, to, colour, |x, y| {
            // Signed distance to the nearest edge, positive inside.
            let inside = edges.iter().map(|(a, b)| {
                let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
                sense * (dx * (y - a[1]) - dy * (x - a[0])) / dx.hypot(dy).max(1e-6)
            });
            opacity * (inside.fold(f32::INFINITY, f32::min) + 0.5).clamp(0.0, 1.0)
        });
    }

    /// Paints a straight stroke with a round brush; one of zero length is a dot.
    pub(super) fn stroke(&mut self, a: [f32; 2], b: [f32; 2], half_width: f32, colour: Colour, opacity: f32) {
        let from = [a[0].min(b[0]) - half_width, a[1].min(b[1]) - half_width];
        let to = [a[0].max(b[0]) + half_width, a[1].max(b[1]) + half_width];
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let squared = (dx * dx + dy * dy).max(1e-6);
        self.lay(from, to, colour, |x, y| {
            let along = (((x - a[0]) * dx + (y - a[1]) * dy) / squared).clamp(0.0, 1.0);
            let distance = (x - a[0] - along * dx).hypot(y - a[1] - along * dy);
            opacity * (half_width - distance + 0.5).clamp(0.0, 1.0)
        });
    }

    /// Multiplies every pixel by a factor.
    pub(super) fn shade(&mut self, factor: impl Fn(f32, f32) -> f32) {
        for (i, colour) in self.colours.iter_mut().enumerate() {
            let by = factor((i % self.width) as f32, (i / self.width) as f32);
            *colour = colour.map(|c| c * by);
        }
    }

    /// Returns the finished picture.
    pub(super) fn finish(&self) -> RgbImage {
        RgbImage::from_fn(self.width as u32, self.height as u32, |x, y| {
            Rgb(self.colours[y as usize * self.width + x as usize].map(|c| (c * 255.0 + 0.5) as u8))
        })
    }
}

/// Blends `over` into `under`; `share` is the weight of `over`.
pub(super) fn mix(under: Colour, over: Colour, share: f32) -> Colour {
    std::array::from_fn(|k| under[k] + (over[k] - under[k]) * share)
}

/// Converts hue (in turns), saturation and value, all 0 to 1, to a colour.
pub(super) fn hsv(hue: f32, saturation: f32, value: f32) -> Colour {
    [5.0_f32, 3.0, 1.0].map(|n| {
        let k = (n + hue.rem_euclid(1.0) * 6.0) % 6.0;
        value * (1.0 - saturation * k.min(4.0 - k).clamp(0.0, 1.0))
    })
}

/// Returns a pseudo-random number from 0 to 1 for a lattice point.
pub(super) fn lattice(x: i32, y: i32, seed: u32) -> f32 {
    let mut h = seed.wrapping_mul(0x27d4_eb2f) ^ (x as u32).wrapping_mul(0x9e37_79b1) ^ (y as u32).wrapping_mul(0x85eb_ca77);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    (h ^ (h >> 15)) as f32 / u32::MAX as f32
}

/// Returns smooth noise from 0 to 1 with features of about one unit.
fn value_noise(x: f32, y: f32, seed: u32) -> f32 {
    let (i, j) = (x.floor(), y.floor());
    let ease = |t: f32| t * t * (3.0 - 2.0 * t);
    let (a, b) = (ease(x - i), ease(y - j));
    let (i, j) = (i as i32, j as i32);
    let row = |j: i32| lattice(i, j, seed) * (1.0 - a) + lattice(i + 1, j, seed) * a;
    row(j) * (1.0 - b) + row(j + 1) * b
}

/// Returns layered noise from 0 to 1: each octave has half the size and `roughness` times the
/// amplitude of the one before.
pub(super) fn layered_noise(x: f32, y: f32, octaves: u32, roughness: f32, seed: u32) -> f32 {
    let (mut sum, mut weight, mut total, mut scale) = (0.0, 1.0, 0.0, 1.0);
    for octave in 0..octaves {
        sum += weight * value_noise(x * scale, y * scale, seed.wrapping_add(octave * 131));
        total += weight;
        weight *= roughness;
        scale *= 2.0;
    }
    sum / total
}

/// Computes Worley cells: returns the distance to the cell's border (in units of cells) and the
/// cell's random number.
pub(super) fn cell(x: f32, y: f32, seed: u32) -> (f32, f32) {
    let (i, j) = (x.floor() as i32, y.floor() as i32);
    let (mut first, mut second, mut number) = (f32::INFINITY, f32::INFINITY, 0.0);
    for (i, j) in (-1..=1).flat_map(|dj| (-1..=1).map(move |di| (i + di, j + dj))) {
        let (px, py) = (i as f32 + lattice(i, j, seed), j as f32 + lattice(i, j, seed ^ 0x51ab));
        let distance = (px - x).hypot(py - y);
        if distance < first {
            (second, first, number) = (first, distance, lattice(i, j, seed ^ 0x77e1));
        } else if distance < second {
            second = distance;
        }
    }
    (second - first, number)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn white_on_black(draw: impl Fn(&mut Canvas)) -> f32 {
        let mut canvas = Canvas::from_fn(60, 60, |_, _| [0.0; 3]);
        draw(&mut canvas);
        canvas.colours.iter().map(|c| c[0]).sum()
    }

    #[test]
    fn shapes_cover_their_area() {
        let square = [[10.0, 10.0], [40.0, 10.0], [40.0, 30.0], [10.0, 30.0]];
        assert!((white_on_black(|c| c.polygon(&square, [1.0; 3], 1.0)) - 600.0).abs() < 6.0);
        let other_sense = [square[3], square[2], square[1], square[0]];
        assert!((white_on_black(|c| c.polygon(&other_sense, [1.0; 3], 0.5)) - 300.0).abs() < 3.0);
        let dot = std::f32::consts::PI * 100.0;
        assert!((white_on_black(|c| c.stroke([30.0, 30.0], [30.0, 30.0], 10.0, [1.0; 3], 1.0)) - dot).abs() < 5.0);
    }

    #[test]
    fn shapes_beyond_the_edge_are_clipped() {
        let outside = [[-40.0, -40.0], [-20.0, -40.0], [-20.0, -20.0]];
        assert_eq!(white_on_black(|c| c.polygon(&outside, [1.0; 3], 1.0)), 0.0);
        assert!(white_on_black(|c| c.stroke([50.0, 50.0], [90.0, 90.0], 3.0, [1.0; 3], 1.0)) > 10.0);
    }

    #[test]
    fn hues_map_to_the_right_colours() {
        assert_eq!(hsv(0.0, 1.0, 1.0), [1.0, 0.0, 0.0]);
        assert_eq!(hsv(1.0 / 3.0, 1.0, 1.0).map(f32::round), [0.0, 1.0, 0.0]);
        assert_eq!(hsv(0.3, 0.0, 0.5), [0.5; 3]);
    }
}
