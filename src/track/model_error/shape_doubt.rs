//! Pose covariance from uncertain shapes and places of the surfaces.
//!
//! A survey reports the ways in which its shapes may be off, each scaled to one sigma: fields of
//! heights and stretches over the pictures. Each moves the points that a pose rests on, and thus
//! the pose, as a wrong lens does ([`lens_doubt`](super::lens_doubt)). This is computed in every
//! frame, so the ways lie side by side in memory: a point depends on the same few coefficients of
//! all of them.

use nalgebra::{Matrix2x3, Matrix6, SMatrix};

use crate::camera::CameraModel;
use crate::geometry::covariance::covariance_of_inverse;
use crate::geometry::resection::{MovingCamera, residual_and_jacobian};
use crate::geometry::{Body, Camera, Pose};
use crate::simd::multiversion;
use crate::track::patches::fitted_anchor::FittedAnchor;
use crate::track::scene::reference::PreparedSurface;
use crate::track::scene::shape::{ShapeWay, SurfaceShape};

/// Ways that are processed at a time. Raised, surfaces with few ways cost more; lowered, the points
/// are visited more often.
const WAYS_AT_A_TIME: usize = 24;

/// The ways in which the surfaces of a body may be off.
#[derive(Debug, Default)]
pub struct ShapeDoubt {
    /// By the index of the surface.
    tables: Vec<Vec<WayTable>>,
    /// Maximum number of ways of any surface.
    ways: usize,
}

/// Ways of a surface whose splines have the same grids.
#[derive(Debug)]
struct WayTable {
    /// Index of the first way in the table; column k belongs to the way `first` + k.
    first: usize,
    /// Any way with these grids.
    grid: ShapeWay,
    /// For each coefficient its value in every way (0 in ways with other grids): height, and
    /// stretch along x and y.
    heights: Vec<[f64; WAYS_AT_A_TIME]>,
    stretches: [Vec<[f64; WAYS_AT_A_TIME]>; 2],
}

impl WayTable {
    fn new(first: usize, grid: &ShapeWay) -> Self {
        let rows = |coefficients: usize| vec![[0.0; WAYS_AT_A_TIME]; coefficients];
        let stretches = [0, 1].map(|_| rows(grid.stretch.coefficients().len()));
        Self { first, grid: grid.clone(), heights: rows(grid.height.coefficients().len()), stretches }
    }

    fn is_for(&self, first: usize, way: &ShapeWay) -> bool {
        let grids = |way: &ShapeWay| [way.height.intervals(), way.stretch.intervals()];
        self.first == first && grids(&self.grid) == grids(way)
    }

    fn put(&mut self, column: usize, way: &ShapeWay) {
        self.heights.iter_mut().zip(way.height.coefficients()).for_each(|(row, c)| row[column] = c.x);
        for (axis, rows) in self.stretches.iter_mut().enumerate() {
            rows.iter_mut().zip(way.stretch.coefficients()).for_each(|(row, c)| row[column] = c[axis]);
        }
    }

    /// Adds how each way moves a point of the picture, along x, y and the normal.
    fn add_shifts(&self, point: [f64; 2], [x, y, z]: &mut [[f64; WAYS_AT_A_TIME]; 3]) {
        let [height, stretch] = [self.grid.height.support(point), self.grid.stretch.support(point)].map(|support| support.weights());
        add_rows(&self.heights, &height, z);
        add_rows(&self.stretches[0], &stretch, x);
        add_rows(&self.stretches[1], &stretch, y);
    }
}

multiversion! {
    /// Adds rows, each times its weight.
    fn add_rows(rows: &[[f64; WAYS_AT_A_TIME]], weights: &[(usize, f64)], sums: &mut [f64; WAYS_AT_A_TIME]); ["avx2"] => add_rows_plain, else add_rows_plain
}

#[inline(always)]
fn add_rows_plain(rows: &[[f64; WAYS_AT_A_TIME]], weights: &[(usize, f64)], sums: &mut [f64; WAYS_AT_A_TIME]) {
    // A local copy stays in registers.
    let mut own = *sums;
    for (k, weight) in weights {
        own.iter_mut().zip(&rows[*k]).for_each(|(sum, value)| *sum += value * weight);
    }
    *sums = own;
}

impl ShapeDoubt {
    /// Arranges the ways of a body's surfaces.
    pub fn of(surfaces: &[PreparedSurface]) -> Self {
        let mut doubt = Self::default();
        for surface in surfaces {
            let mut tables: Vec<WayTable> = Vec::new();
            if let SurfaceShape::Bent(shape) = &surface.spec.shape {
                doubt.ways = doubt.ways.max(shape.ways.len());
                for (k, way) in shape.ways.iter().enumerate() {
                    let first = k - k % WAYS_AT_A_TIME;
                    let own = tables.iter().position(|table| table.is_for(first, way)).unwrap_or_else(|| {
                        tables.push(WayTable::new(first, way));
                        tables.len() - 1
                    });
                    tables[own].put(k - first, way);
                }
            }
            doubt.tables.push(tables);
        }
        doubt
    }

    /// Returns the covariance of [δp, δθ] of `T_body_camera`, body axes, from uncertain shapes and
    /// places; `None` if nothing is uncertain. `surfaces`: those that this was built from.
    pub fn covariance(
        &self,
        t_body_camera: &Pose<Body, Camera>,
        camera: &CameraModel,
        surfaces: &[PreparedSurface],
        anchors: &[FittedAnchor],
    ) -> Option<Matrix6<f64>> {
        let pose = t_body_camera.inverse();
        let still = MovingCamera::still(camera);
        let rotation = pose.rotation_matrix();
        let mut covariance = None;
        for first in (0..self.ways).step_by(WAYS_AT_A_TIME) {
            let mut normal = Matrix6::zeros();
            let mut right = [[0.0; WAYS_AT_A_TIME]; 6];
            for anchor in anchors {
                let o = &anchor.observation;
                let Some((_, j)) = residual_and_jacobian(&pose, &still, o) else { continue };
                let weighted = j.transpose() * o.information;
                normal += weighted * j;
                let spec = &surfaces[anchor.surface as usize].spec;
                let on_picture: [f64; 2] = spec.to_metres(anchor.artwork).into();
                let mut shifts = [[0.0; WAYS_AT_A_TIME]; 3];
                let tables = self.tables[anchor.surface as usize].iter().filter(|table| table.first == first);
                tables.for_each(|table| table.add_shifts(on_picture, &mut shifts));
                // A moved point appears where a camera that moved with it would see it: the first
                // three columns.
                let by_shift: Matrix2x3<f64> = j.fixed_columns::<3>(0) * (rotation * spec.pose.rotation_matrix());
                let by_shift = weighted * by_shift;
                for (row, sums) in right.iter_mut().enumerate() {
                    add_rows(&shifts, &[0, 1, 2].map(|axis| (axis, by_shift[(row, axis)])), sums);
                }
            }
            let right = SMatrix::<f64, 6, WAYS_AT_A_TIME>::from_fn(|row, way| right[row][way]);
            let by_way = normal.cholesky()?.solve(&right);
            *covariance.get_or_insert_with(Matrix6::zeros) += covariance_of_inverse(&pose, &(by_way * by_way.transpose()));
        }
        covariance.filter(|covariance| covariance.iter().all(|v| v.is_finite()))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::{Matrix2, Vector2, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::bspline::BicubicSpline;
    use crate::geometry::resection::Observation;
    use crate::track::scene::shape::BentShape;
    use crate::track::scene::surface::SurfaceSpec;
    use crate::track::synthetic::{cloth, facing, lens, prepared};

    /// A spline on a grid with coefficients of tenths of a millimetre.
    fn random_field<const N: usize>(intervals: [usize; 2], size_m: [f64; 2], random: &mut Pcg64Mcg) -> BicubicSpline<N> {
        let mut field = BicubicSpline::zero(intervals, size_m);
        field.coefficients_mut().iter_mut().flatten().for_each(|c| *c = random.random_range(-2e-4..2e-4));
        field
    }

    /// A cloth with this number of ways in which its shape may be off. Every seventh way has
    /// splines with fewer knots than the others.
    fn doubted(seed: u32, ways: usize) -> SurfaceSpec {
        let mut random = Pcg64Mcg::seed_from_u64(seed.into());
        let size_m = cloth(seed).size_m;
        let mut way = |k: usize| {
            let [fine, coarse] = if k % 7 == 6 { [[9, 7], [4, 4]] } else { [[12, 9], [5, 3]] };
            ShapeWay { height: random_field(fine, size_m, &mut random), stretch: random_field(coarse, size_m, &mut random) }
        };
        let (ways, own) = ((0..ways).map(&mut way).collect(), way(0));
        SurfaceSpec { shape: SurfaceShape::Bent(Arc::new(BentShape { height: own.height, stretch: own.stretch, ways })), ..cloth(seed) }
    }

    /// Computes [`ShapeDoubt::covariance`] way by way.
    fn plain(pose: &Pose<Camera, Body>, camera: &CameraModel, surfaces: &[PreparedSurface], anchors: &[FittedAnchor]) -> Matrix6<f64> {
        let jacobian =
            |anchor: &FittedAnchor| residual_and_jacobian(pose, &MovingCamera::still(camera), &anchor.observation).expect("it is seen").1;
        let normal: Matrix6<f64> =
            anchors.iter().map(|anchor| jacobian(anchor).transpose() * anchor.observation.information * jacobian(anchor)).sum();
        let ways = |anchor: &FittedAnchor| match &surfaces[anchor.surface as usize].spec.shape {
            SurfaceShape::Bent(shape) => shape.ways.clone(),
            SurfaceShape::Flat => Vec::new(),
        };
        let most = anchors.iter().map(|anchor| ways(anchor).len()).max().expect("there are some");
        let mut covariance = Matrix6::zeros();
        for k in 0..most {
            let mut right = nalgebra::Vector6::zeros();
            for anchor in anchors {
                let Some(way) = ways(anchor).get(k).cloned() else { continue };
                let spec = &surfaces[anchor.surface as usize].spec;
                let at: [f64; 2] = spec.to_metres(anchor.artwork).into();
                let (stretch, height) = (way.stretch.at(at).value, way.height.at(at).value);
                let moved = pose.rotation_matrix() * spec.pose.rotation_matrix() * Vector3::new(stretch.x, stretch.y, height.x);
                let j = jacobian(anchor);
                right += j.transpose() * anchor.observation.information * (j.fixed_columns::<3>(0) * moved);
            }
            let shift = normal.cholesky().expect("the pose is known").solve(&right);
            covariance += shift * shift.transpose();
        }
        covariance_of_inverse(pose, &covariance)
    }

    #[test]
    fn batched_modes_give_the_same_covariance_as_single_ones() {
        let camera = lens(1280, 720);
        let rotated = facing(0.3, 0.1, Vector3::new(0.4, 0.2, 0.5));
        // One of them has more ways than fit side by side.
        let specs = vec![doubted(1, 5), SurfaceSpec { pose: Pose::new(rotated.rotation, rotated.translation), ..doubted(2, 31) }, cloth(3)];
        let body = prepared(specs);
        let pose = facing(0.2, -0.3, Vector3::new(0.1, 0.05, 4.4));
        let mut random = Pcg64Mcg::seed_from_u64(4);
        let anchors: Vec<FittedAnchor> = (0..90)
            .map(|k| {
                let surface = k % 3;
                let spec = &body.surfaces[surface as usize].spec;
                let [width, height] = [spec.artwork.width(), spec.artwork.height()].map(f64::from);
                let artwork = Vector2::new(random.random_range(0.0..width), random.random_range(0.0..height));
                let (pixel, information) = (Vector2::new(640.0, 360.0), Matrix2::new(120.0, 10.0, 10.0, 80.0));
                let observation = Observation { point: spec.body_point(artwork), pixel, information, delay_s: 0.0, group: 0 };
                FittedAnchor { surface, artwork, observation, corrected_px: pixel }
            })
            .collect();
        let found = ShapeDoubt::of(&body.surfaces).covariance(&pose.inverse(), &camera, &body.surfaces, &anchors).expect("there are ways");
        let right = plain(&pose, &camera, &body.surfaces, &anchors);
        assert!(right.trace().sqrt() > 1e-6 && (found - right).norm() < 1e-9 * right.norm(), "{found}{right}");
    }

    #[test]
    fn a_flat_shape_has_no_shape_uncertainty() {
        let body = prepared(vec![cloth(1)]);
        let pose = facing(0.2, -0.3, Vector3::new(0.1, 0.05, 3.4)).inverse();
        assert_eq!(ShapeDoubt::of(&body.surfaces).covariance(&pose, &lens(1280, 720), &body.surfaces, &[]), None);
    }
}
