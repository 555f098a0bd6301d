//! The scene with a backdrop of folded cloth. The folds are configured as a survey would measure
//! them.

use std::sync::Arc;

use nalgebra::Vector1;
use stagepose::diagnostics::geometry::BicubicSpline;
use stagepose::diagnostics::track::{BentShape, SurfaceShape};

use super::{backdrop, path, staged, wide};
use crate::film::Film;

/// Distance between the knots of the folds' height, metres. Raised, the folds are cut.
const KNOT_M: f64 = 0.15;
/// Frames: those of a bent surface take several times as long to render.
const FRAMES: u64 = 30;

/// Cloth in still folds of up to 18 mm, seen aslant.
pub fn cloth() -> Film {
    let path = path(&[
        (0.0, [1.2, -4.1, 0.2], [-0.2, 0.0, 0.0]),
        (0.5, [0.5, -3.8, 0.3], [0.0, 0.0, 0.1]),
        (1.0, [-0.3, -3.5, 0.1], [0.1, 0.0, 0.0]),
    ]);
    let mut stage = staged(wide(), path, backdrop(303, [4.0, 2.7]));
    for surface in &mut stage.stage.surfaces {
        surface.shape = folds(surface.size_m);
    }
    stage.shutter.exposure_s = 0.006;
    Film { stage, fps: 30.0, frames: FRAMES, jpeg: Some(90) }
}

fn folds(size_m: [f64; 2]) -> SurfaceShape {
    let mut height = BicubicSpline::zero(size_m.map(|side| (side / KNOT_M).ceil() as usize), size_m);
    let middle = height.middles();
    for (k, coefficient) in height.coefficients_mut().iter_mut().enumerate() {
        let [x, y] = middle(k);
        *coefficient = Vector1::new(0.012 * (4.2 * x - 0.4 * y + 0.9).sin() + 0.006 * (9.0 * x + 0.8 * y + 2.1).sin());
    }
    let stretch = BicubicSpline::zero([2, 2], size_m);
    SurfaceShape::Bent(Arc::new(BentShape { height, stretch, ways: Vec::new() }))
}
