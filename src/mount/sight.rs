//! What a camera sees of its stage from a given pose: how accurate its pose would be there, and how
//! much its lens may distort it.
//!
//! A grid of points on every surface stands for the picture; the information per point is scaled to
//! match the measured covariances.

use nalgebra::{Matrix2, Matrix6, Point3, Vector2};

use super::views::View;
use crate::camera::{CameraModel, Normalized};
use crate::geometry::covariance::covariance_of_inverse;
use crate::geometry::resection::{MovingCamera, Observation, residual_and_jacobian};
use crate::geometry::robust_kernel::median;
use crate::geometry::{Body, Camera, Pose, Stage};
use crate::track::{BodySpec, covariance_by_lens};

/// Points across and down a surface: enough that one more row changes little. Raised, advice takes
/// longer.
const GRID: [u32; 2] = [11, 9];
/// Minimum number of visible points for a view to be advised: a third of a surface. Raised, views
/// from near and from the side are not advised; lowered, views are advised that the tracker may not
/// find.
const MIN_POINTS: usize = 30;
/// Minimum depth of a visible point, metres: no stage is nearer, and the projection degenerates.
/// Any small length would do.
const NEAREST_M: f64 = 0.05;

/// A camera and the stage in which it measures.
#[derive(Debug, Clone, Copy)]
pub struct ObservationModel<'a> {
    /// Its lens.
    pub camera: &'a CameraModel,
    /// The stage.
    pub stage: &'a BodySpec,
}

impl ObservationModel<'_> {
    /// Returns the covariance of a pose if every point were measured to a pixel; `None` if too few
    /// points are visible.
    pub(super) fn covariance(&self, pose: &Pose<Stage, Camera>) -> Option<Matrix6<f64>> {
        // The stage's body frame is the stage frame.
        let seen: Pose<Camera, Body> = pose.inverse().renamed();
        let observations = self.observations(&seen);
        if observations.len() < MIN_POINTS {
            return None;
        }
        let still = MovingCamera::still(self.camera);
        let jacobians = observations.iter().filter_map(|o| residual_and_jacobian(&seen, &still, o));
        let normal: Matrix6<f64> = jacobians.map(|(_, j)| j.transpose() * j).sum();
        Some(covariance_of_inverse(&seen, &normal.cholesky()?.inverse()))
    }

    /// Returns the covariance of a pose caused by the lens's uncertainty; zero if there is none.
    pub fn doubt(&self, pose: &Pose<Stage, Camera>) -> Matrix6<f64> {
        let seen: Pose<Camera, Body> = pose.inverse().renamed();
        let by_lens = covariance_by_lens(&pose.renamed(), self.camera, self.observations(&seen).iter());
        by_lens.unwrap_or_else(Matrix6::zeros)
    }

    /// Returns the median ratio of the measured covariances to those of the grid.
    pub(super) fn scale<'v>(&self, views: impl Iterator<Item = &'v View>) -> Option<f64> {
        let ratio = |view: &View| Some(view.covariance.trace() / self.covariance(&view.pose)?.trace());
        let mut ratios: Vec<f64> = views.filter_map(ratio).filter(|ratio| ratio.is_finite()).collect();
        median(&mut ratios)
    }

    /// Returns the visible points.
    fn observations(&self, seen: &Pose<Camera, Body>) -> Vec<Observation> {
        let from = seen.inverse().translation;
        let mut observations = Vec::new();
        for surface in &self.stage.surfaces {
            let at = |k: u32, n: u32, side: f64| ((f64::from(k) + 0.5) / f64::from(n) - 0.5) * side;
            let towards = surface.pose.rotation.inverse() * (from - surface.pose.translation);
            if towards.z <= 0.0 {
                continue;
            }
            for (column, row) in (0..GRID[0]).flat_map(|column| (0..GRID[1]).map(move |row| (column, row))) {
                let on_surface = Point3::new(at(column, GRID[0], surface.size_m[0]), at(row, GRID[1], surface.size_m[1]), 0.0);
                let point = surface.pose.transform(&on_surface);
                observations.extend(self.pixel(&seen.transform(&point)).map(|pixel| Observation {
                    point,
                    pixel,
                    information: Matrix2::identity(),
                    delay_s: 0.0,
                    group: 0,
                }));
            }
        }
        observations
    }

    /// Returns the pixel of a point in camera axes, if it is in the picture.
    fn pixel(&self, at: &Point3<f64>) -> Option<Vector2<f64>> {
        if at.z < NEAREST_M {
            return None;
        }
        let pixel = self.camera.project(Normalized(Vector2::new(at.x / at.z, at.y / at.z))).0;
        let is_inside = |v: f64, side: u32| v >= 0.0 && v <= f64::from(side) - 1.0;
        (is_inside(pixel.x, self.camera.width()) && is_inside(pixel.y, self.camera.height())).then_some(pixel)
    }
}
