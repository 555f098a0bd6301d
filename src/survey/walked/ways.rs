//! The modes of uncertainty ("ways") of a surveyed stage, few enough to be stored with its shapes.
//!
//! The covariance of a thousand unknowns is too large to process in every frame, and most of it
//! never affects a pose. What matters is its effect on the poses of the walk's own frames: with A
//! the derivative of those poses by the model's unknowns and C the covariance of the unknowns, the
//! ways are the columns of C Aᵀ U D^(-1/2), where U D Uᵀ = A C Aᵀ. Together they give these poses
//! the same covariance as C. Those with the largest effect are kept.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector, Vector1, Vector2, Vector3};

use super::normal_equations::NormalEquations;
use super::stage_model::{StageModel, bent};
use crate::track::{BentShape, ShapeWay, SurfaceShape, SurfaceSpec};

/// Maximum number of ways kept. Raised, frames cost more; lowered, covariances are incomplete.
const MAX_WAYS: usize = 24;
/// Maximum number of frames whose poses are used, evenly spaced: six numbers each.
const MAX_FRAMES: usize = 40;
/// Minimum effect of a way on any pose, metres and radians, for it to be kept.
const MIN_WAY: f64 = 1e-6;

/// Returns the surfaces of a model, each with its ways.
pub fn with_ways(model: &StageModel, covariance: &DMatrix<f64>, equations: &NormalEquations) -> Vec<SurfaceSpec> {
    let ways = ways(model, covariance, equations);
    let with = |(k, surface): (usize, &SurfaceSpec)| {
        let mut surface = surface.clone();
        if let Some(shape) = bent(&surface) {
            let ways = ways.iter().map(|way| way_of(model, k, shape, way)).collect();
            surface.shape = SurfaceShape::Bent(Arc::new(BentShape { ways, ..shape.clone() }));
        }
        surface
    };
    model.surfaces.iter().enumerate().map(with).collect()
}

fn ways(model: &StageModel, covariance: &DMatrix<f64>, equations: &NormalEquations) -> Vec<DVector<f64>> {
    let frames = equations.frame_count();
    let step = frames.div_ceil(MAX_FRAMES).max(1);
    let n = model.places().readout.unwrap_or(model.places().count);
    let mut by_model = DMatrix::zeros(6 * frames.div_ceil(step), n);
    for (row, k) in (0..frames).step_by(step).enumerate() {
        by_model.rows_mut(6 * row, 6).copy_from(&equations.pose_by_model(k).columns(0, n));
    }
    // The lens's own uncertainty is stored with the lens, in its calibration, and the shutter's
    // with the shutter.
    let spread = covariance.view((0, 0), (n, n)) * by_model.transpose();
    let eigen = (&by_model * &spread).symmetric_eigen();
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).filter(|k| eigen.eigenvalues[*k] > MIN_WAY * MIN_WAY).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    order.truncate(MAX_WAYS);
    order.into_iter().map(|k| &spread * eigen.eigenvectors.column(k) / eigen.eigenvalues[k].sqrt()).collect()
}

/// Returns the effect of a way on surface `k`: on its shape and, to first order, on its pose.
fn way_of(model: &StageModel, k: usize, shape: &BentShape, way: &DVector<f64>) -> ShapeWay {
    let (places, surface) = (model.places(), &model.surfaces[k]);
    let to_surface = surface.pose.rotation_matrix().transpose();
    let moved = |[x, y]: [f64; 2]| {
        let Some(at) = places.poses[k] else { return Vector3::zeros() };
        let [shift, rotation] = [0, 3].map(|first| Vector3::new(way[at + first], way[at + first + 1], way[at + first + 2]));
        to_surface * (shift + rotation.cross(&(surface.pose.rotation * Vector3::new(x, y, 0.0))))
    };
    let growth = places.size.map_or(0.0, |at| way[at]);
    let mut out = ShapeWay { height: shape.height.clone(), stretch: shape.stretch.clone() };
    let at = out.height.middles();
    for (n, c) in out.height.coefficients_mut().iter_mut().enumerate() {
        *c = Vector1::new(way[places.heights[k] + n] + moved(at(n)).z);
    }
    let at = out.stretch.middles();
    for (n, c) in out.stretch.coefficients_mut().iter_mut().enumerate() {
        let place = places.stretches[k] + 2 * n;
        *c = Vector2::new(way[place], way[place + 1]) + Vector2::from(at(n)) * growth + moved(at(n)).xy();
    }
    out
}
