//! The kernels of alignment, one by one, on one frame of one surface. Benches use this, because
//! they cannot reach the kernels otherwise. Call the methods in the order in which they appear
//! here.

use image::GrayImage;

use super::kernel::columns::COLUMNS;
use super::kernel::evidence::evidence;
use super::kernel::noise_sums::noise_sums;
use super::kernel::normal::{Residuals, RobustWeighting, RunView, residuals};
use super::kernel::tile_products::{ProductBuffer, tile_equations};
use super::learned::light::RememberedLight;
use super::learned::online_calibration::OnlineCalibration;
use super::picture::surface::AlignSurface;
use super::pixels::appearance::{Appearance, Predicted, predict};
use super::pixels::level_spec::LevelSpec;
use super::pixels::runs::{Pixels, Run};
use super::pixels::selection::Selector;
use crate::camera::{CameraModel, Shutter};
use crate::geometry::{Body, Camera, Pose};
use crate::motion::Motion;
use crate::track::frame::frame_levels::{FINEST, FrameLevels};
use crate::track::frame::rays::CameraRays;
use crate::track::scene::surface::SurfaceSpec;

/// Exposure of a blurred frame in benches, seconds. No effect on the time: that depends on the
/// number of places.
const EXPOSURE_S: f64 = 0.01;

/// A frame, a surface and all that alignment computes from them, step by step.
#[derive(Debug)]
pub struct AlignKernels {
    frame: GrayImage,
    surfaces: [AlignSurface; 1],
    rays: CameraRays,
    motion: Motion,
    slow: OnlineCalibration,
    levels: FrameLevels,
    selector: Selector,
    pixels: Pixels,
    appearance: Appearance,
    residuals: Residuals,
    products: Box<ProductBuffer>,
}

impl AlignKernels {
    /// Prepares a frame that shows the surface from a pose. Nothing is chosen or predicted yet.
    pub fn new(frame: GrayImage, camera: CameraModel, surface: &SurfaceSpec, t_camera_body: &Pose<Camera, Body>) -> Self {
        let mut levels = FrameLevels::default();
        levels.update(&frame);
        Self {
            frame,
            surfaces: [AlignSurface::new(surface)],
            rays: CameraRays::new(camera, None),
            motion: Motion::still(t_camera_body.inverse()),
            slow: OnlineCalibration::new(Shutter { readout_s: 0.01, exposure_s: EXPOSURE_S }),
            levels,
            selector: Selector::default(),
            pixels: Pixels::default(),
            appearance: Appearance::default(),
            residuals: Residuals::default(),
            products: Box::default(),
        }
    }

    /// Halves the frame.
    pub fn halve(&mut self) {
        self.levels.update(&self.frame);
    }

    /// Chooses about `count` pixels at most; returns their number.
    pub fn choose(&mut self, count: usize) -> usize {
        let Self { surfaces, slow, rays, motion, selector, .. } = self;
        selector.choose(&LevelSpec { count, ..LevelSpec::new(surfaces, slow, rays, true, FINEST, motion) }, motion).len()
    }

    /// Lays out the chosen pixels in runs; returns the number of runs.
    pub fn lay_out(&mut self) -> usize {
        let spec = LevelSpec::new(&self.surfaces, &self.slow, &self.rays, true, FINEST, &self.motion);
        self.pixels.arrange(self.selector.chosen(), &spec, self.levels.light(FINEST), &RememberedLight::default());
        self.appearance.resize(self.pixels.len());
        self.residuals.resize(self.pixels.len());
        self.pixels.runs().len()
    }

    /// Predicts all pixels: with `side` samples across a sharp one, or at `places` along a blur (if
    /// more than one).
    pub fn predict(&mut self, side: usize, places: usize) {
        let Self { surfaces, slow, rays, motion, pixels, .. } = self;
        let spec = &LevelSpec { side, places, ..LevelSpec::new(surfaces, slow, rays, true, FINEST, motion) };
        let what = Predicted { surface: &surfaces[0], motion, spec, pixels, range: [0, pixels.len()] };
        predict(&what, &mut self.appearance);
    }

    /// Computes the residuals of all runs.
    pub fn residuals(&mut self) {
        let noise = self.slow.noise.at(FINEST);
        for run in self.pixels.runs() {
            let light = self.pixels.light_of(run);
            residuals(&self.pixels, run, &self.appearance, &light, &noise, &mut self.residuals);
        }
    }

    /// Computes the normal equations of all runs, with or without the times of their rows; returns
    /// the sum of their weighted squared residuals.
    pub fn tile_equations(&mut self, has_rows: bool) -> f64 {
        let mut products = std::mem::take(&mut self.products);
        let delay_s = has_rows.then_some(0.0);
        let sum = self.each(|view, weighting| {
            tile_equations(view, delay_s, &[0.0; COLUMNS], weighting, &mut products).sums.product(COLUMNS, COLUMNS)
        });
        self.products = products;
        sum
    }

    /// Computes the evidence of all runs; returns the number of inliers.
    pub fn evidence(&self) -> f64 {
        self.each(|view, weighting| evidence(view, &[0.0; COLUMNS], weighting).inliers)
    }

    /// Computes the noise sums of all runs; returns the sum of the first of them.
    pub fn noise_sums(&self) -> f64 {
        self.each(|view, weighting| f64::from(noise_sums(view, &[0.0; COLUMNS], weighting)[0]))
    }

    fn each(&self, mut kernel: impl FnMut(&RunView, &RobustWeighting) -> f64) -> f64 {
        let Self { pixels, appearance, residuals, .. } = self;
        let weighting = RobustWeighting { residual_sigma: 1.0, is_first_pass: false, stride: 1 };
        let of_run = |run: &Run| {
            let light = pixels.light_of(run);
            kernel(&RunView { pixels, run, appearance, light: &light, residuals }, &weighting)
        };
        pixels.runs().iter().map(of_run).sum()
    }
}
