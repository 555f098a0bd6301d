//! Paints the cloth: a different picture for every seed, with marks of every size.
//!
//! A tracker must find features on a backdrop from any distance, so it has features of all scales
//! and no repetition. It shows a clouded sky, a hillside of cracked stones and a town of crooked
//! houses. On top are some thousand patches, brush strokes and lines of made-up writing, whose
//! sizes follow a power law, as in real pictures.

use std::f32::consts::TAU;

use image::{GrayImage, Luma, RgbImage};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::canvas::{Canvas, Colour, cell, hsv, lattice, layered_noise, mix};

/// Paints a backdrop of `width` x `height` pixels; the same seed gives the same picture.
pub fn paint(width: u32, height: u32, seed: u64) -> RgbImage {
    if width == 0 || height == 0 {
        return RgbImage::new(width, height);
    }
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let noise_seed: u32 = random.random();
    let hue: f32 = random.random();
    let mut canvas = ground(width, height, hue, noise_seed);
    let mut painter = Painter { random, hue, size: [width as f32, height as f32] };
    painter.houses(&mut canvas);
    for _ in 0..1400 {
        painter.mark(&mut canvas);
    }
    let unit = height as f32;
    // Cloth is never evenly lit or painted: add broad stains and the weave.
    canvas.shade(|x, y| {
        let stain = 0.8 + 0.4 * layered_noise(x / unit * 3.0, y / unit * 3.0, 3, 0.5, noise_seed ^ 0x57a1);
        stain * (0.98 + 0.04 * lattice(x as i32, y as i32, noise_seed ^ 0xc107))
    });
    canvas.finish()
}

/// Paints dark floor boards that run across the picture.
pub fn paint_boards(width: u32, height: u32, seed: u64) -> RgbImage {
    let seed = Pcg64Mcg::seed_from_u64(seed).random::<u32>();
    let board = height as f32 / 24.0;
    let canvas = Canvas::from_fn(width, height, |x, y| {
        let row = (y / board).floor();
        let start = x / (board * 14.0) + lattice(row as i32, 7, seed);
        let tone = lattice(start.floor() as i32, row as i32, seed);
        let seam = (y / board).fract() < 0.06 || start.fract() < 0.006;
        let grain = layered_noise(x / board * 0.4, y / board * 6.0, 4, 0.6, seed ^ row as u32);
        let value = if seam { 0.05 } else { 0.16 + 0.12 * tone + 0.16 * (grain - 0.5) };
        hsv(0.07, 0.45, value)
    });
    canvas.finish()
}

/// Converts a colour picture to grey by a camera's luma (ITU-R BT.601).
pub fn grey(picture: &RgbImage) -> GrayImage {
    GrayImage::from_fn(picture.width(), picture.height(), |x, y| {
        let [r, g, b] = picture.get_pixel(x, y).0.map(u32::from);
        Luma([((299 * r + 587 * g + 114 * b + 500) / 1000) as u8])
    })
}

/// Paints sky above, stones below and an uneven horizon between them.
fn ground(width: u32, height: u32, hue: f32, seed: u32) -> Canvas {
    let unit = height as f32;
    Canvas::from_fn(width, height, |x, y| {
        let (x, y) = (x / unit, y / unit);
        let bend = layered_noise(x * 2.0, y * 2.0, 4, 0.5, seed);
        let horizon = 0.45 + 0.35 * (layered_noise(x * 1.3, 0.0, 4, 0.5, seed ^ 0x11) - 0.5);
        if y < horizon {
            let cloud = layered_noise(x * 3.0 + bend, y * 6.0 - bend, 6, 0.6, seed ^ 0x22);
            let sky = hsv(hue + 0.1 * bend, 0.55, 0.35 + 0.45 * y / horizon);
            mix(sky, [0.95, 0.92, 0.85], ((cloud - 0.45) * 4.0).clamp(0.0, 0.9))
        } else {
            // The warp makes the stones crooked; they are larger nearer to the viewer.
            let size = if y < horizon + 0.22 + 0.2 * (bend - 0.5) { 30.0 } else { 13.0 };
            let (joint, number) = cell((x + 0.05 * bend) * size, (y + 0.05 * bend) * size, seed ^ 0x33);
            let rough = layered_noise(x * 40.0, y * 40.0, 4, 0.7, seed ^ 0x44) - 0.5;
            let stone = hsv(hue + 0.45 + 0.2 * number, 0.4, (0.15 + 0.65 * number + 0.35 * rough).clamp(0.02, 1.0));
            mix([0.05, 0.04, 0.05], stone, (joint * 9.0).clamp(0.0, 1.0))
        }
    })
}

/// Paints random marks.
struct Painter {
    random: Pcg64Mcg,
    /// Dominant hue of the picture, in turns.
    hue: f32,
    /// Size of the cloth, pixels.
    size: [f32; 2],
}

impl Painter {
    fn place(&mut self) -> [f32; 2] {
        self.size.map(|side| self.random.random_range(0.0..side))
    }

    /// Returns a colour of the picture's palette. Light and dark are equally likely; mid-tones are
    /// left out.
    fn colour(&mut self) -> Colour {
        let hue = self.hue + [0.0, 0.45, 0.55, 0.12][self.random.random_range(0..4)] + self.random.random_range(-0.05..0.05);
        let dark = self.random.random::<bool>();
        let value = if dark { self.random.random_range(0.03..0.4) } else { self.random.random_range(0.6..1.0) };
        hsv(hue, self.random.random_range(0.1..0.75), value)
    }

    /// Returns a random length in pixels. Small ones are most frequent; each doubling is about half
    /// as frequent as the one before.
    fn length(&mut self, smallest: f32, largest: f32) -> f32 {
        let share: f32 = self.random.random();
        // The inverse of the distribution 1 - (smallest / s), truncated at the largest.
        (smallest / (1.0 - share * (1.0 - smallest / largest))) * self.size[1]
    }

    /// Paints a street of crooked houses along the middle of the cloth.
    fn houses(&mut self, canvas: &mut Canvas) {
        let [width, height] = self.size;
        let mut left = -0.02 * width;
        while left < width {
            let across = height * self.random.random_range(0.08..0.2);
            let foot = height * self.random.random_range(0.6..0.75);
            let top = foot - height * self.random.random_range(0.15..0.45);
            self.house(canvas, [left, top], [left + across, foot]);
            left += across * self.random.random_range(0.7..1.3);
        }
    }

    fn house(&mut self, canvas: &mut Canvas, [left, top]: [f32; 2], [right, foot]: [f32; 2]) {
        let (across, lean) = (right - left, (right - left) * self.random.random_range(-0.15..0.15));
        let wall = self.colour();
        canvas.polygon(&[[left, foot], [left + lean, top], [right + lean, top], [right, foot]], wall, 0.92);
        let eaves = across * self.random.random_range(0.05..0.2);
        let peak = [left + lean + across * self.random.random_range(0.25..0.75), top - across * self.random.random_range(0.3..0.9)];
        let roof = self.colour();
        canvas.polygon(&[[left + lean - eaves, top], peak, [right + lean + eaves, top]], roof, 0.95);
        let (columns, rows) = (self.random.random_range(2..5), self.random.random_range(2..6));
        for (column, row) in (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row))) {
            let pane = self.colour();
            let up = (row as f32 + self.random.random_range(0.2..0.35)) / rows as f32;
            let x = left + lean * (1.0 - up) + across * (column as f32 + self.random.random_range(0.15..0.4)) / columns as f32;
            let y = top + (foot - top) * up;
            let (w, h) = (across / columns as f32 * self.random.random_range(0.3..0.55), (foot - top) / rows as f32 * 0.55);
            canvas.polygon(&[[x, y], [x + w, y + 0.04 * h], [x + w, y + h], [x, y + h]], [0.03, 0.03, 0.04], 1.0);
            canvas.polygon(&[[x + 0.2 * w, y + 0.15 * h], [x + 0.8 * w, y + 0.15 * h], [x + 0.8 * w, y + 0.8 * h]], pane, 0.9);
        }
    }

    fn mark(&mut self, canvas: &mut Canvas) {
        match self.random.random_range(0..10) {
            0..5 => self.patch(canvas),
            5..8 => self.brush(canvas),
            _ => self.writing(canvas),
        }
    }

    /// Paints a convex patch of three to six corners, on a stretched circle.
    fn patch(&mut self, canvas: &mut Canvas) {
        let (middle, radius, rotation) = (self.place(), self.length(0.006, 0.09), self.random.random::<f32>() * TAU);
        let (stretch, corners) = (self.random.random_range(0.4..1.0), self.random.random_range(3..7));
        let points: Vec<[f32; 2]> = (0..corners)
            .map(|k| {
                let angle = (k as f32 + self.random.random_range(-0.35..0.35)) / corners as f32 * TAU;
                let (along, across) = (radius * angle.cos(), radius * stretch * angle.sin());
                [middle[0] + along * rotation.cos() - across * rotation.sin(), middle[1] + along * rotation.sin() + across * rotation.cos()]
            })
            .collect();
        let (colour, opacity) = (self.colour(), self.random.random_range(0.75..1.0));
        canvas.polygon(&points, colour, opacity);
    }

    /// Paints a curved brush stroke.
    fn brush(&mut self, canvas: &mut Canvas) {
        let (mut at, length, colour) = (self.place(), self.length(0.02, 0.3), self.colour());
        let mut direction = self.random.random::<f32>() * TAU;
        let (bend, half_width) = (self.random.random_range(-0.5..0.5), (length * self.random.random_range(0.02..0.08)).max(0.8));
        for _ in 0..6 {
            let next = [at[0] + length / 6.0 * direction.cos(), at[1] + length / 6.0 * direction.sin()];
            canvas.stroke(at, next, half_width, colour, 1.0);
            (at, direction) = (next, direction + bend);
        }
    }

    /// Paints a line of illegible letters.
    fn writing(&mut self, canvas: &mut Canvas) {
        let (start, letter, colour) = (self.place(), self.length(0.012, 0.06), self.colour());
        let slope = self.random.random_range(-0.3..0.3_f32);
        for k in 0..self.random.random_range(3..9) {
            let x = start[0] + 0.8 * letter * k as f32;
            let corner = [x, start[1] + slope * (x - start[0])];
            for _ in 0..self.random.random_range(2..5) {
                let mut end = || {
                    let [column, row] = [self.random.random_range(0..3), self.random.random_range(0..4)].map(|n: u8| f32::from(n));
                    [corner[0] + 0.28 * letter * column, corner[1] + 0.33 * letter * row]
                };
                let (a, b) = (end(), end());
                canvas.stroke(a, b, (0.07 * letter).max(0.8), colour, 1.0);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_determines_the_picture() {
        let [a, again, other] = [3, 3, 4].map(|seed| grey(&paint(160, 120, seed)));
        assert_eq!(a, again);
        let differing = a.as_raw().iter().zip(other.as_raw()).filter(|(x, y)| x.abs_diff(**y) > 20).count();
        assert!(differing > a.as_raw().len() / 3, "only {differing} pixels differ");
    }

    #[test]
    fn every_quarter_has_detail_at_every_scale() {
        let picture = grey(&paint(400, 300, 9));
        for scale in [1_u32, 4, 12] {
            for (x0, y0) in [(0, 0), (200, 0), (0, 150), (200, 150)] {
                let level = |x: u32, y: u32| i32::from(picture.get_pixel(x, y)[0]);
                let places = (0..150 - scale).step_by(3).flat_map(|y| (0..200 - scale).step_by(3).map(move |x| (x0 + x, y0 + y)));
                let steps: Vec<i32> = places.map(|(x, y)| (level(x, y) - level(x + scale, y + scale)).abs()).collect();
                let strong = steps.iter().filter(|&&s| s > 25).count() as f32 / steps.len() as f32;
                assert!(strong > 0.08, "scale {scale} at {x0}, {y0}: {strong}");
            }
        }
    }

    #[test]
    fn grey_is_bt601() {
        let picture = RgbImage::from_fn(3, 1, |x, _| image::Rgb([[255, 0, 0], [0, 255, 0], [0, 0, 255]][x as usize]));
        assert_eq!(grey(&picture).as_raw(), &[76, 150, 29]);
    }
}
