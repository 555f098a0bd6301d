//! A screen that shows the code, filmed by a camera, for tests.

use image::{GrayImage, Luma};
use nalgebra::{Matrix3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::layout::{SIZE, is_white};

/// Samples per pixel and side: cells have soft edges.
const SAMPLES: usize = 2;

/// A screen during an exposure: two codes, and the share of the exposure in which it shows the
/// second.
pub struct Screen {
    codes: [u32; 2],
    share: f64,
}

/// How the screen is seen: cells from pixels, its light, the room's, and noise.
pub struct View {
    size: [u32; 2],
    pixel_from_cell: Matrix3<f64>,
    light: [f64; 2],
    noise: f64,
}

impl View {
    pub fn frontal() -> Self {
        Self::new([640, 360], 24.0, [60.0, 40.0], 0.0, [0.0; 2])
    }

    fn new(size: [u32; 2], cell_px: f64, at: [f64; 2], turn: f64, tilt: [f64; 2]) -> Self {
        let (sin, cos) = (cell_px * turn.sin(), cell_px * turn.cos());
        let pixel_from_cell = Matrix3::new(cos, -sin, at[0], sin, cos, at[1], tilt[0], tilt[1], 1.0);
        Self { size, pixel_from_cell, light: [0.9, 0.02], noise: 2.0 }
    }

    pub fn various() -> Vec<Self> {
        let view = Self::new;
        vec![
            Self::frontal(),
            view([640, 360], 5.0, [300.0, 200.0], 0.0, [0.0; 2]),
            view([1280, 720], 40.0, [200.0, 150.0], 0.2, [0.003, 0.002]),
            view([1280, 720], 30.0, [300.0, 400.0], -0.3, [-0.008, 0.004]),
            // Upside down, and on its side.
            view([640, 360], 20.0, [550.0, 300.0], std::f64::consts::PI, [0.0; 2]),
            view([640, 480], 20.0, [400.0, 60.0], 0.5 * std::f64::consts::PI, [0.0; 2]),
            // Dim, beside a bright wall, and in bright light.
            Self { light: [0.08, 0.004], ..Self::frontal() },
            Self { light: [0.5, 0.15], noise: 4.0, ..Self::frontal() },
        ]
    }
}

impl Screen {
    pub fn showing(shown_ms: u32) -> Self {
        Self::changing(shown_ms, shown_ms, 0.5)
    }

    pub fn changing(first_ms: u32, second_ms: u32, share: f64) -> Self {
        Self { codes: [first_ms, second_ms], share }
    }

    /// Returns the share of white that a place shows, in cells from the code's top left corner;
    /// `None` beside the screen.
    fn white(&self, x: f64, y: f64) -> Option<f64> {
        let [width, height] = SIZE.map(|size| size as f64);
        if !(-1.0..width + 1.0).contains(&x) || !(-1.0..height + 1.0).contains(&y) {
            return None;
        }
        if !(0.0..width).contains(&x) || !(0.0..height).contains(&y) {
            return Some(1.0);
        }
        let shows = |code: u32| f64::from(u8::from(is_white([x as usize, y as usize], code).unwrap_or(true)));
        Some((1.0 - self.share) * shows(self.codes[0]) + self.share * shows(self.codes[1]))
    }

    pub fn filmed(&self, view: &View) -> GrayImage {
        let cell_from_pixel = view.pixel_from_cell.try_inverse().expect("a regular view");
        let mut random = Pcg64Mcg::seed_from_u64(u64::from(self.codes[0]));
        let [white, black] = view.light;
        GrayImage::from_fn(view.size[0], view.size[1], |x, y| {
            let mut light = 0.0;
            for k in 0..SAMPLES * SAMPLES {
                let within = |k: usize| (k as f64 + 0.5) / SAMPLES as f64 - 0.5;
                let at = cell_from_pixel * Vector3::new(f64::from(x) + within(k % SAMPLES), f64::from(y) + within(k / SAMPLES), 1.0);
                light += self.white(at.x / at.z, at.y / at.z).map_or(0.3 * black, |share| black + (white - black) * share);
            }
            let noise: f64 = (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            let grey = 255.0 * (light / (SAMPLES * SAMPLES) as f64).powf(1.0 / 2.2) + view.noise * noise;
            Luma([grey.round().clamp(0.0, 255.0) as u8])
        })
    }
}
