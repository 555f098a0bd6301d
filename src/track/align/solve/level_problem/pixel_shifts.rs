//! What single pixels of a solved frame say about where its detail lies, for surveys: a patch
//! averages over its tile, and with it whatever is narrower.

use nalgebra::{Matrix2, Vector2};

use super::Corrected;
use super::patches::patch_shift;
use super::solution::LevelSolution;
use crate::track::align::kernel::evidence::evidence;
use crate::track::align::kernel::normal::{RobustWeighting, RunView};
use crate::track::align::lanes::LANES;
use crate::track::align::pixels::level_spec::LevelSpec;
use crate::track::align::pixels::runs::Run;

/// Factor on the robust scale of the residuals for single pixels. One step with weights by the
/// residual shortens displacements: by a fifth to a third at 1, by a fiftieth at 3. Raised,
/// outliers count for more.
const OUTLIER_SIGMAS: f64 = 3.0;

/// What a single pixel says about where the frame shows its detail, for surveys.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelShift {
    /// Index of the surface in the body.
    pub surface: u32,
    /// Its detail on the surface, metres from the centre (x right, y up).
    pub on_surface_m: Vector2<f64>,
    /// Information of the displacement, pixels^-2: along the pixel's gradient only.
    pub information: Matrix2<f64>,
    /// That information times the displacement, pixels^-1.
    pub weighted: Vector2<f64>,
    /// When its row was exposed, seconds after the frame's stamp.
    pub delay_s: f64,
}

impl LevelSolution<'_> {
    /// Appends the pixels of the tiles that fit, to first order: a tile averages away whatever is
    /// narrower than it. Requires [`conclude`](Self::conclude).
    pub fn pixel_shifts(self, spec: &LevelSpec, out: &mut Vec<PixelShift>) {
        let Self { found: Corrected { motion, residual_sigma, .. }, problem } = self;
        let weighting = RobustWeighting { residual_sigma: OUTLIER_SIGMAS * residual_sigma, is_first_pass: false, stride: 1 };
        let scale = spec.frame_px();
        let counts = std::mem::take(&mut problem.picture.pixels.counts);
        let mut alone = vec![0.0; counts.len()];
        for r in problem.runs.iter().filter(|r| r.gate.is_open && patch_shift(&r.evidence).is_some()) {
            for k in r.run.range().filter(|k| counts[*k] > 0.0) {
                // The evidence of a run in which only this pixel counts.
                let start = k - k % LANES;
                let run = Run { start: start as u32, end: (start + LANES) as u32, ..r.run };
                alone[k] = counts[k];
                std::mem::swap(&mut problem.picture.pixels.counts, &mut alone);
                let e = evidence(&RunView { run: &run, ..problem.picture.view(r) }, &r.step.columns, &weighting);
                std::mem::swap(&mut problem.picture.pixels.counts, &mut alone);
                alone[k] = 0.0;
                let [aa, ab, bb, ra, rb] = e.shift;
                let Some(on_surface_m) = problem.on_surface(k, &spec.surfaces[r.run.surface as usize], &motion) else { continue };
                out.push(PixelShift {
                    surface: r.run.surface,
                    on_surface_m,
                    information: Matrix2::new(aa, ab, ab, bb) / (scale * scale),
                    weighted: Vector2::new(ra, rb) / -scale,
                    delay_s: f64::from(problem.picture.pixels.delay_s[k]),
                });
            }
        }
        problem.picture.pixels.counts = counts;
    }
}
