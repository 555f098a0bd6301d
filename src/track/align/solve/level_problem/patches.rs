//! Patches: for each tile, where its detail lies on its surface, and how far the frame shows it
//! from where the solution puts it. They are the correspondences that later checks of the model
//! use.

use crate::track::align::tuning::TUNING;
use nalgebra::{Matrix2, Vector2, Vector3};

use super::solution::LevelSolution;
use super::{Corrected, LevelProblem, LevelSpec, RunAtWork};
use crate::motion::Motion;
use crate::track::align::kernel::columns::COLUMNS;
use crate::track::align::kernel::evidence::{RunEvidence, evidence};
use crate::track::align::kernel::normal::RobustWeighting;
use crate::track::align::picture::surface::AlignSurface;
use crate::track::align::pixels::appearance::predict;

/// A patch of the reference and where the frame shows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// Index of the surface in the body.
    pub surface: u32,
    /// Its middle on the surface, metres from the centre (x right, y up).
    pub on_surface_m: Vector2<f64>,
    /// Its middle in the frame as the pose has it, pixels.
    pub centre_px: Vector2<f64>,
    /// Its displacement in the frame from there, pixels.
    pub shift_px: Vector2<f64>,
    /// Information of the shift, pixels^-2.
    pub information: Matrix2<f64>,
    /// Tile, for grouping.
    pub tile: u32,
    /// When its rows were exposed, seconds after the frame's stamp.
    pub delay_s: f64,
}

impl LevelSolution<'_> {
    /// Appends the patches that fit, at most one per tile. Consumes the solution, as sampling them
    /// changes the pixels' rays. `shifts`: a buffer.
    pub fn patches(self, spec: &LevelSpec, shifts: &mut Vec<Vector2<f64>>, patches: &mut Vec<Patch>) {
        // Not the reported motion: after a jump within the frame that is the motion of its last
        // rows.
        let Self { found: Corrected { motion, residual_sigma: mut sigmas, .. }, problem } = self;
        shifts.clear();
        shifts.extend(problem.runs.iter().map(|r| patch_shift(&r.evidence).map_or(Vector2::zeros(), |(shift, _)| shift)));
        // One linear step is right for small shifts. Where the calibration or the survey is off,
        // patches must be followed.
        let runs = problem.runs.len().max(1) as f64;
        let mut moved_px = shifts.iter().map(|s| s.norm()).sum::<f64>() / runs;
        let mut least_px = TUNING.resampling_shift_px;
        for _ in 0..TUNING.max_resampling_rounds {
            if moved_px < least_px {
                break;
            }
            sigmas = problem.sample_shifted(spec, &motion, shifts);
            moved_px = 0.0;
            for (shift, r) in shifts.iter_mut().zip(&problem.runs) {
                let more = patch_shift(&r.evidence).map_or(Vector2::zeros(), |(more, _)| more);
                let more = more * (1.0 / more.norm().max(1.0));
                *shift += more;
                moved_px += more.norm() / runs;
            }
            least_px = TUNING.resampling_converged_px;
        }
        let scale = spec.frame_px();
        // An error in the predicted blur scatters the pixels of a patch as noise does. The
        // residuals of a sharp frame come from the model.
        let is_blurred = spec.blur_px * scale > TUNING.max_sharp_blur_px;
        let scatter = if is_blurred { sigmas.max(1.0).powi(-2) } else { 1.0 };
        for (r, shift) in problem.runs.iter().zip(shifts) {
            let Some((_, structure)) = patch_shift(&r.evidence) else { continue };
            let Some(on_surface_m) = problem.middle_on_surface(r, &spec.surfaces[r.run.surface as usize], &motion) else { continue };
            let [weight, u, v] = r.evidence.place;
            patches.push(Patch {
                surface: r.run.surface,
                on_surface_m,
                // A pixel of the level covers `scale` by `scale` of the frame's, whose centres are
                // at whole numbers.
                centre_px: Vector2::new(u, v) * (scale / weight) + Vector2::repeat(0.5 * (scale - 1.0)),
                shift_px: *shift * scale,
                information: structure * (scatter / (scale * scale)),
                tile: r.run.tile,
                delay_s: problem.picture.time(spec, &r.run).delay_s,
            });
        }
    }
}

impl LevelProblem {
    /// Predicts every run as if the frame showed it shifted (pixels of the level), and updates its
    /// evidence. Returns the robust standard deviation of the residuals, in sigmas.
    fn sample_shifted(&mut self, spec: &LevelSpec, motion: &Motion, shifts: &[Vector2<f64>]) -> f64 {
        self.at = None;
        let pixels = &mut self.picture.pixels;
        for (r, shift) in self.runs.iter().zip(shifts) {
            let (su, sv) = (shift.x as f32, shift.y as f32);
            for k in r.run.range() {
                let [x, y] = spec.rays.table(spec.level).rays[pixels.index[k] as usize];
                pixels.x[k] = x - pixels.x_across[k] * su - pixels.x_down[k] * sv;
                pixels.y[k] = y - pixels.y_across[k] * su - pixels.y_down[k] * sv;
            }
        }
        self.predict_each(spec, motion, predict);
        self.residuals_all(&spec.noise);
        let residual_sigma = self.residual_sigma();
        let weighting = RobustWeighting { residual_sigma, is_first_pass: false, stride: 1 };
        for r in &mut self.runs {
            r.evidence = evidence(&self.picture.view(r), &[0.0; COLUMNS], &weighting);
        }
        residual_sigma
    }

    /// Returns where the middle of a run's detail lies on its surface, metres from the centre.
    /// `None` if its ray misses the surface.
    fn middle_on_surface(&self, r: &RunAtWork, surface: &AlignSurface, motion: &Motion) -> Option<Vector2<f64>> {
        // The pixel nearest to the middle represents it, as its ray is known exactly.
        let [weight, u, v] = r.evidence.place;
        let (u, v) = ((u / weight) as f32, (v / weight) as f32);
        let pixels = self.pixels();
        let [columns, rows] = &pixels.place;
        let off = |k: &usize| (columns[*k] - u).powi(2) + (rows[*k] - v).powi(2);
        self.on_surface(r.run.range().min_by(|a, b| off(a).total_cmp(&off(b)))?, surface, motion)
    }

    /// Returns where pixel `k` lies on its surface, metres from the centre. `None` if its ray
    /// misses the surface.
    pub(super) fn on_surface(&self, k: usize, surface: &AlignSurface, motion: &Motion) -> Option<Vector2<f64>> {
        let pixels = self.pixels();
        let ray = Vector3::new(f64::from(pixels.x[k]), f64::from(pixels.y[k]), 1.0);
        let pose = motion.after(f64::from(pixels.delay_s[k])).pose;
        let to_surface = surface.rectangle.rotation.transpose();
        let direction = to_surface * (pose.rotation * ray);
        let from = to_surface * (pose.translation - surface.rectangle.centre);
        surface.rectangle.shape.meet(&from, &direction).map(Vector2::from)
    }
}

/// Returns a tile's displacement in the frame (pixels of the level) and its information. `None`
/// where too little of the tile fits, or its detail runs in one direction only.
pub(super) fn patch_shift(e: &RunEvidence) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let [aa, ab, bb, ra, rb] = e.shift;
    if e.inliers < TUNING.min_patch_pixels || 2.0 * e.inliers < e.count || aa * bb - ab * ab < 0.02 * (aa + bb).powi(2) {
        return None;
    }
    let structure = Matrix2::new(aa, ab, ab, bb);
    // Predicted intensity at u shows what the frame has at u + shift: the residual is -gradient
    // times shift.
    Some((-(structure.try_inverse()? * Vector2::new(ra, rb)), structure))
}
