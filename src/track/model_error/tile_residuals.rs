//! Residual tile displacements of a solved pose: how far from its predicted place the frame shows
//! each tile.
//!
//! If the stage matches the config and the lens matches its calibration, these are noise. A pattern
//! in them is a model error: of the lens, of a surface's shape or of the layout. `field_error`
//! turns them into pose covariance; `focal_clue` decides whether another focal length explains
//! them.
//!
//! Everything is linear about the pose: shift = J x + c δ + noise, where x = [δt, δθ] is the change
//! of the pose in camera axes and δ the change of the logarithm of the focal length. Tiles are
//! weighted by Tukey's biweight of their residuals with x and δ both free, so that a wrong lens
//! does not turn tiles into outliers.

use crate::track::model_error::tuning::TUNING;
use nalgebra::{Matrix2, Matrix6, SMatrix, SVector, Vector2, Vector6};

use crate::camera::{CameraModel, Normalized};
use crate::geometry::resection::{MovingCamera, Observation, residual_and_jacobian};
use crate::geometry::robust_kernel::tukey_weight;
use crate::geometry::{Body, Camera, Pose};
use crate::track::patches::fitted_anchor::FittedAnchor;

/// Median length of a plane vector with unit normal noise: sqrt(2 ln 2).
pub const MEDIAN_LENGTH: f64 = 1.177_410_022_515_474_6;

/// The residual of one tile.
#[derive(Debug, Clone, Copy)]
pub struct TileResidual {
    /// Index of its anchor.
    pub anchor: usize,
    /// Where the frame shows it, pixels, corrected as if all rows were exposed at once.
    pub place_px: Vector2<f64>,
    /// Its displacement from where the pose predicts it, pixels.
    pub shift_px: Vector2<f64>,
    /// Derivative by [δt, δθ] of `T_camera_body`, camera axes.
    pub by_pose: SMatrix<f64, 2, 6>,
    /// Derivative by the logarithm of the focal length: all rays move outwards in proportion to
    /// their length.
    pub by_focal: Vector2<f64>,
    /// Derivative by the first radial coefficient: all rays move outwards with the cube of their
    /// length.
    pub by_radial: Vector2<f64>,
    /// Inverse covariance of the shift's noise, times the tile's robust weight, pixels⁻².
    pub information: Matrix2<f64>,
    /// The same without the weight.
    pub noise_information: Matrix2<f64>,
    weight: f64,
}

impl TileResidual {
    /// Returns the derivatives by pose and focal length.
    fn row(&self) -> SMatrix<f64, 2, 7> {
        let mut row = SMatrix::<f64, 2, 7>::zeros();
        row.fixed_columns_mut::<6>(0).copy_from(&self.by_pose);
        row.set_column(6, &self.by_focal);
        row
    }

    /// Returns the squared residual after a change of pose and focal length, in variances of noise.
    fn squared_left(&self, change: &SVector<f64, 7>) -> f64 {
        let left = self.shift_px - self.row() * change;
        left.dot(&(self.noise_information * left))
    }

    /// Returns the residual after a change of the pose, pixels.
    pub fn left_by_pose(&self, change: &Vector6<f64>) -> Vector2<f64> {
        self.shift_px - self.by_pose * change
    }

    /// Returns the squared residual after a change of the pose, in variances of noise, weighted.
    pub fn squared_left_by_pose(&self, change: &Vector6<f64>) -> f64 {
        let left = self.left_by_pose(change);
        left.dot(&(self.information * left))
    }

    /// Returns the squared shift, in variances of noise, weighted.
    pub fn squared(&self) -> f64 {
        self.shift_px.dot(&(self.information * self.shift_px))
    }
}

/// The residuals of one body in one frame; keeps its buffers.
#[derive(Debug, Default)]
pub struct TileResiduals {
    tiles: Vec<TileResidual>,
    squares: Vec<f64>,
    normal: Matrix6<f64>,
    weight: f64,
    /// Change of pose and focal length that best explains the shifts.
    change: SVector<f64, 7>,
}

impl TileResiduals {
    /// Computes the residuals of a solved pose (`T_camera_body`) and their robust weights; `None`
    /// if there are too few tiles.
    pub fn take(&mut self, pose: &Pose<Camera, Body>, camera: &CameraModel, anchors: &[FittedAnchor]) -> Option<()> {
        let still = MovingCamera::still(camera);
        let tile = |(anchor, fitted): (usize, &FittedAnchor)| {
            let seen = Observation { pixel: fitted.corrected_px, ..fitted.observation };
            let (residual, by_pose) = residual_and_jacobian(pose, &still, &seen)?;
            let c = pose.transform(&seen.point).coords;
            let ray = Vector2::new(c.x / c.z, c.y / c.z);
            let (_, by_ray) = camera.project_with_jacobian(Normalized(ray));
            let noise_information = seen.information;
            Some(TileResidual {
                anchor,
                place_px: seen.pixel,
                shift_px: -residual,
                by_pose,
                by_focal: by_ray * ray,
                by_radial: by_ray * ray * ray.norm_squared(),
                information: noise_information,
                noise_information,
                weight: 1.0,
            })
        };
        self.tiles.clear();
        self.tiles.extend(anchors.iter().enumerate().filter_map(tile));
        let mut change = self.solved()?;
        for _ in 1..TUNING.reweighting_rounds {
            self.weigh(&change)?;
            change = self.solved()?;
        }
        self.change = change;
        Some(())
    }

    /// Returns the tiles.
    pub fn tiles(&self) -> &[TileResidual] {
        &self.tiles
    }

    /// Returns the normal matrix of the pose, weighted.
    pub fn normal(&self) -> &Matrix6<f64> {
        &self.normal
    }

    /// Returns the longer side of the tiles' bounding rectangle, pixels.
    pub fn extent_px(&self) -> f64 {
        let places = self.tiles.iter().map(|tile| tile.place_px);
        let (low, high) = places.fold((Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY)), |(low, high), place| {
            (low.inf(&place), high.sup(&place))
        });
        (high - low).max()
    }

    /// Returns the sum of the tiles' robust weights.
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// Returns a tile's squared residual after the best change of pose and focal length, in
    /// variances of noise.
    pub fn squared_left(&self, tile: &TileResidual) -> f64 {
        tile.squared_left(&self.change)
    }

    /// Whether the residuals clearly exceed the noise, each tile capped at
    /// `max_squared_tile_residual`.
    pub fn is_misfit(&self) -> bool {
        let left: f64 = self.tiles.iter().map(|t| self.squared_left(t).min(TUNING.max_squared_tile_residual)).sum();
        left > TUNING.min_model_misfit * 2.0 * self.tiles.len() as f64
    }

    /// Returns the root mean square shift, weighted by information, pixels.
    pub fn rms_px(&self) -> f64 {
        let squared: f64 = self.tiles.iter().map(TileResidual::squared).sum();
        let information: f64 = self.tiles.iter().map(|t| t.information.trace()).sum();
        (2.0 * squared / information.max(f64::MIN_POSITIVE)).sqrt()
    }

    /// Returns the right side of the pose's normal equations: [`normal`](Self::normal) times the
    /// best change of the pose alone.
    pub fn right_side(&self) -> Vector6<f64> {
        self.tiles.iter().map(|t| t.by_pose.transpose() * (t.information * t.shift_px)).sum()
    }

    /// Returns the error of the pose per unit of the logarithm of the focal length: [δt, δθ] of
    /// `T_camera_body`, camera axes.
    pub fn pose_by_focal(&self) -> Option<Vector6<f64>> {
        let right: Vector6<f64> = self.tiles.iter().map(|t| t.by_pose.transpose() * (t.information * t.by_focal)).sum();
        Some(self.normal.cholesky()?.solve(&right))
    }

    /// Computes the robust weights from the residuals after a change of pose and focal length.
    fn weigh(&mut self, change: &SVector<f64, 7>) -> Option<()> {
        let Self { tiles, squares, .. } = self;
        squares.clear();
        squares.extend(tiles.iter().map(|t| t.squared_left(change)));
        let middle = squares.len() / 2;
        if squares.is_empty() {
            return None;
        }
        let median = *squares.select_nth_unstable_by(middle, f64::total_cmp).1;
        let scale = (median.sqrt() / MEDIAN_LENGTH).max(TUNING.min_residual_scale);
        for tile in tiles {
            tile.weight = tukey_weight(tile.squared_left(change), scale);
            tile.information = tile.noise_information * tile.weight;
        }
        Some(())
    }

    /// Solves for the change of pose and focal length that best explains the shifts; `None` if too
    /// few tiles have weight.
    fn solved(&mut self) -> Option<SVector<f64, 7>> {
        self.weight = self.tiles.iter().map(|t| t.weight).sum();
        if self.weight < TUNING.min_tile_weight_sum {
            return None;
        }
        let mut normal = SMatrix::<f64, 7, 7>::zeros();
        let mut right = SVector::<f64, 7>::zeros();
        for tile in &self.tiles {
            let row = tile.row();
            let weighted = row.transpose() * tile.information;
            normal += weighted * row;
            right += weighted * tile.shift_px;
        }
        self.normal = normal.fixed_view::<6, 6>(0, 0).into_owned();
        normal[(6, 6)] *= 1.0 + TUNING.focal_ridge;
        normal.cholesky().map(|factor| factor.solve(&right))
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::camera::Intrinsics;
    use crate::geometry::resection::{perturbed, resect};
    use crate::track::synthetic::{cloth, facing, lens, prepared, seen_anchors};

    fn oblique() -> Pose<Camera, Body> {
        facing(0.1, -0.3, Vector3::new(0.4, 0.05, 5.0))
    }

    #[test]
    fn tile_derivatives_match_the_pixel_derivatives() {
        let (body, camera, pose) = (prepared(vec![cloth(1)]), lens(640, 480), oblique());
        let mut residuals = TileResiduals::default();
        residuals.take(&pose, &camera, &seen_anchors(&body, &pose, &camera, 6, |_, _| Vector2::zeros())).expect("tiles enough");
        let i = *camera.intrinsics();
        let h = 1e-6;
        for tile in residuals.tiles() {
            let seen = |pose: &Pose<Camera, Body>, ray: &dyn Fn(Vector2<f64>) -> Vector2<f64>| {
                let artwork = Vector2::new(f64::from(tile.anchor as u32 % 6) + 0.5, f64::from(tile.anchor as u32 / 6) + 0.5);
                let point = body.surfaces[0].spec.body_point(artwork.component_mul(&Vector2::new(640.0 / 6.0, 80.0)));
                let c = pose.transform(&point);
                CameraModel::new(Intrinsics { ..i }).unwrap().project(Normalized(ray(Vector2::new(c.x / c.z, c.y / c.z)))).0
            };
            for k in 0..6 {
                let step = Vector6::ith(k, h);
                let by = (seen(&perturbed(&pose, &step), &|n| n) - seen(&perturbed(&pose, &-step), &|n| n)) / (2.0 * h);
                assert!((by - tile.by_pose.column(k)).norm() < 1e-3, "{k}: {by} {}", tile.by_pose.column(k));
            }
            let by_focal = (seen(&pose, &|n| n * (1.0 + h)) - seen(&pose, &|n| n * (1.0 - h))) / (2.0 * h);
            let by_radial =
                (seen(&pose, &|n| n * (1.0 + h * n.norm_squared())) - seen(&pose, &|n| n * (1.0 - h * n.norm_squared()))) / (2.0 * h);
            assert!((by_focal - tile.by_focal).norm() < 1e-3 && (by_radial - tile.by_radial).norm() < 1e-3);
        }
    }

    #[test]
    fn a_wrong_focal_length_shifts_the_pose_as_predicted() {
        let (body, camera, pose) = (prepared(vec![cloth(1)]), lens(640, 480), oblique());
        let i = *camera.intrinsics();
        let by = 0.002_f64;
        let zoomed = CameraModel::new(Intrinsics { fx: by.exp() * i.fx, fy: by.exp() * i.fy, ..i }).unwrap();
        let anchors = seen_anchors(&body, &pose, &zoomed, 10, &mut |_, _| Vector2::zeros());
        let observations: Vec<Observation> = anchors.iter().map(|a| a.observation).collect();
        let found = resect(&pose, &MovingCamera::still(&camera), &observations, 30).expect("a pose").pose;
        let mut residuals = TileResiduals::default();
        residuals.take(&found, &camera, &anchors).expect("tiles enough");
        let predicted = perturbed(&found, &(residuals.pose_by_focal().expect("it is solved") * -by));
        let off = |p: &Pose<Camera, Body>| (p.translation - pose.translation).norm();
        assert!(off(&found) > 0.004 && off(&predicted) < 0.1 * off(&found), "{} {}", off(&found), off(&predicted));
    }

    #[test]
    fn tiles_showing_something_else_have_no_weight() {
        let (body, camera, pose) = (prepared(vec![cloth(1)]), lens(640, 480), oblique());
        let shift = |k: u32, _| if k.is_multiple_of(7) { Vector2::new(9.0, -4.0) } else { Vector2::new(0.03, 0.04) };
        let mut residuals = TileResiduals::default();
        residuals.take(&pose, &camera, &seen_anchors(&body, &pose, &camera, 10, shift)).expect("tiles enough");
        assert!((residuals.rms_px() - 0.05).abs() < 0.02, "{}", residuals.rms_px());
        assert!(residuals.take(&pose, &camera, &seen_anchors(&body, &pose, &camera, 3, |_, _| Vector2::zeros())).is_none());
    }
}
