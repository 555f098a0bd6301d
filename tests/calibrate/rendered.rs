//! Renders chessboards with exact ground truth, to test the finder and the estimation.
//!
//! Each pixel averages a grid of rays through the lens onto the board's plane. Then come the light
//! falloff, the lens blur, the sensor noise and the rounding to 8 bits.

use image::GrayImage;
use nalgebra::{Matrix2, Matrix3, Vector2};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use stagepose::diagnostics::calibrate::{Board, BoardFrame};
use stagepose::{Camera, CameraModel, Normalized, Pixel, Pose};

/// How the board is lit and photographed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Photograph {
    /// Grey level of dark squares.
    pub dark: f32,
    /// Grey level of light squares and of the margin around the board.
    pub light: f32,
    /// Grey level of everything else.
    pub background: f32,
    /// Width of the light margin around the board, squares.
    pub margin: f64,
    /// Standard deviation of the lens blur, pixels.
    pub blur_px: f64,
    /// Standard deviation of the noise, grey levels.
    pub noise: f32,
    /// Fraction of the light lost from the left edge of the picture to the right edge.
    pub falloff: f32,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for Photograph {
    /// A sharp picture in good light.
    fn default() -> Self {
        Self { dark: 35.0, light: 210.0, background: 90.0, margin: 1.0, blur_px: 0.5, noise: 2.0, falloff: 0.2, seed: 1 }
    }
}

/// Rays per pixel along each axis.
const RAYS: usize = 8;

/// A camera with a precomputed ray for every pixel.
#[derive(Debug, Clone)]
pub struct BoardPhotographer {
    /// The camera.
    pub model: CameraModel,
    /// The ray through each pixel's centre and its derivative with respect to the pixel; `None`
    /// where the lens has no ray.
    rays: Vec<Option<(Vector2<f64>, Matrix2<f64>)>>,
}

impl BoardPhotographer {
    /// Precomputes the rays of a camera.
    pub fn new(model: CameraModel) -> Self {
        let (w, h) = (model.width() as usize, model.height() as usize);
        let ray = |k: usize| {
            let n = model.unproject(Pixel(Vector2::new((k % w) as f64, (k / w) as f64)))?;
            Some((n.0, model.project_with_jacobian(n).1.try_inverse()?))
        };
        Self { model, rays: (0..w * h).map(ray).collect() }
    }

    /// Returns the exact pixels of the board's corners.
    pub fn corners(&self, board: &Board, pose: &Pose<Camera, BoardFrame>) -> Vec<Vector2<f64>> {
        let seen = |k: usize| {
            let p = pose.rotation * board.corner(k).push(0.0) + pose.translation;
            self.model.project(Normalized(p.xy() / p.z)).0
        };
        (0..board.corner_count()).map(seen).collect()
    }

    /// Renders a board at the pose `T_camera_board`.
    pub fn photograph(&self, board: &Board, pose: &Pose<Camera, BoardFrame>, how: &Photograph) -> GrayImage {
        let (w, h) = (self.model.width() as usize, self.model.height() as usize);
        let r = pose.rotation_matrix();
        let from_board = Matrix3::from_columns(&[r.column(0).into_owned(), r.column(1).into_owned(), pose.translation]);
        let to_board = from_board.try_inverse().unwrap_or_else(Matrix3::zeros);
        let mut light: Vec<f32> = self.rays.iter().map(|ray| ray.map_or(how.background, |ray| pixel(ray, &to_board, board, how))).collect();
        for (k, level) in light.iter_mut().enumerate() {
            *level *= 1.0 - how.falloff * ((k % w) as f32 / w as f32);
        }
        blur(&mut light, w, h, how.blur_px);
        let mut random = Pcg64Mcg::seed_from_u64(how.seed);
        // The sum of twelve uniform numbers is close enough to normal for sensor noise.
        let mut noise = || (0..12).map(|_| random.random::<f32>()).sum::<f32>() - 6.0;
        let levels = light.iter().map(|level| (level + how.noise * noise() + 0.5) as u8).collect();
        // By construction, the buffer has one level per pixel.
        GrayImage::from_raw(w as u32, h as u32, levels).unwrap_or_default()
    }
}

/// Returns the mean light over the rays of one pixel.
fn pixel((centre, per_px): (Vector2<f64>, Matrix2<f64>), to_board: &Matrix3<f64>, board: &Board, how: &Photograph) -> f32 {
    let at = |offset: Vector2<f64>| {
        let p = to_board * (centre + per_px * offset).push(1.0);
        (p.z > 0.0).then(|| p.xy() / (p.z * board.square_m()))
    };
    // If all four corners of the pixel have the same level, so does the whole pixel.
    let corners = [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)].map(|(x, y)| at(Vector2::new(x, y)).map(|q| level(q, board, how)));
    if let [Some(a), Some(b), Some(c), Some(d)] = corners
        && a == b
        && b == c
        && c == d
    {
        return a;
    }
    let step = |k: usize| (k as f64 + 0.5) / RAYS as f64 - 0.5;
    let rays = (0..RAYS * RAYS).map(|k| at(Vector2::new(step(k % RAYS), step(k / RAYS))));
    rays.map(|q| q.map_or(how.background, |q| level(q, board, how))).sum::<f32>() / (RAYS * RAYS) as f32
}

/// Returns the grey level at a point of the board, in squares from the origin.
fn level(q: Vector2<f64>, board: &Board, how: &Photograph) -> f32 {
    let (columns, rows) = (f64::from(board.columns()), f64::from(board.rows()));
    let within = |m: f64| q.x >= -1.0 - m && q.y >= -1.0 - m && q.x < columns + m && q.y < rows + m;
    if within(0.0) {
        // The square just beyond the origin is dark.
        let dark = (q.x.floor() as i64 + q.y.floor() as i64).rem_euclid(2) == 0;
        if dark { how.dark } else { how.light }
    } else if within(how.margin) {
        how.light
    } else {
        how.background
    }
}

/// Applies a separable Gaussian blur with repeated edges.
fn blur(light: &mut Vec<f32>, w: usize, h: usize, sigma: f64) {
    if sigma < 0.05 {
        return;
    }
    let reach = (4.0 * sigma).ceil() as isize;
    // Each tap integrates the Gaussian over its pixel, which keeps narrow kernels accurate.
    let bell = |x: f64| (-0.5 * (x / sigma).powi(2)).exp();
    let taps: Vec<f32> =
        (-reach..=reach).map(|k| (0..9).map(|s| bell(k as f64 + (f64::from(s) - 4.0) / 9.0)).sum::<f64>() as f32).collect();
    let total: f32 = taps.iter().sum();
    let pass = |from: &[f32], step: usize, lines: usize, line_step: usize, length: usize| {
        let mut out = vec![0.0_f32; from.len()];
        for line in 0..lines {
            for k in 0..length {
                let at = |t: isize| line * line_step + (k as isize + t).clamp(0, length as isize - 1) as usize * step;
                let sum: f32 = taps.iter().zip(-reach..=reach).map(|(tap, t)| tap * from[at(t)]).sum();
                out[line * line_step + k * step] = sum / total;
            }
        }
        out
    };
    let rows = pass(light, 1, h, w, w);
    *light = pass(&rows, w, w, 1, h);
}
