//! Detects a pose that jumps towards the stage or away from it: either the camera moved, or the
//! lens was zoomed.
//!
//! Seen head-on, a zoom leaves no tile displaced: the pose absorbs it and jumps. A jump that the
//! motion of the last frames does not predict, but a step of the focal length would explain, may
//! therefore be a zoom.

use super::tile_residuals::TileResiduals;
use crate::geometry::resection::{Twist, perturbed};
use crate::geometry::{Body, Camera, Pose};
use crate::motion::MAX_ACCELERATION;
use crate::track::model_error::tuning::TUNING;
use crate::track::patches::row_motion::RowMotion;

/// Remembers how well poses are predicted.
#[derive(Debug, Default)]
pub struct Jump {
    /// Usual prediction error, as a fraction of the distance.
    usual: f64,
}

impl Jump {
    /// Returns the step of the log focal length that would explain how `pose` (`T_camera_body`)
    /// jumped, if no camera moves that way; updates the usual prediction error.
    pub fn step(&mut self, pose: &Pose<Camera, Body>, rows: &RowMotion, residuals: &TileResiduals) -> Option<f64> {
        let (before, dt_s, twist) = rows.before?;
        let predicted = perturbed(&before, &(twist?.0 * dt_s));
        let mut off = Twist::between(&predicted, pose, 1.0).0;
        let mut by_focal = residuals.pose_by_focal()?;
        let distance_m = pose.translation.norm();
        for vector in [&mut off, &mut by_focal] {
            vector.fixed_rows_mut::<3>(0).scale_mut(1.0 / distance_m);
        }
        let (usual, size) = (self.usual, off.norm());
        let step = off.dot(&by_focal) / by_focal.norm_squared();
        let share = (step * by_focal.norm() / size.max(f64::MIN_POSITIVE)).abs();
        // A camera that starts or stops deviates from its prediction by at most this.
        let reach_m = 0.5 * MAX_ACCELERATION * dt_s * dt_s;
        let is_step = step.abs() > TUNING.min_focal_step
            && step.abs() * distance_m > reach_m
            && size > TUNING.min_focal_jump_ratio * usual
            && share > TUNING.min_focal_step_explained_ratio;
        self.usual = TUNING.prediction_error_memory * usual + (1.0 - TUNING.prediction_error_memory) * if is_step { usual } else { size };
        is_step.then_some(step)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Vector2, Vector3, Vector6};

    use super::*;
    use crate::camera::{CameraModel, Intrinsics, Shutter};
    use crate::geometry::resection::{MovingCamera, Observation, resect};
    use crate::track::synthetic::{cloth, facing, lens, prepared, seen_anchors};

    /// The step in a frame that `camera` took from `stand` when the previous pose was `before` and
    /// nothing moved.
    fn step(camera: &CameraModel, stand: &Pose<Camera, Body>, before: &Pose<Camera, Body>, dt_s: f64) -> Option<f64> {
        let (body, configured) = (prepared(vec![cloth(1)]), lens(640, 480));
        let mut anchors = seen_anchors(&body, stand, camera, 10, &mut |_, _| Vector2::zeros());
        anchors.iter_mut().for_each(|a| a.observation.information /= 0.01_f64.powi(2));
        let observations: Vec<Observation> = anchors.iter().map(|a| a.observation).collect();
        let pose = resect(before, &MovingCamera::still(&configured), &observations, 30).expect("a pose").pose;
        let mut residuals = TileResiduals::default();
        residuals.take(&pose, &configured, &anchors).expect("tiles enough");
        let rows =
            RowMotion { shutter: Shutter::default(), readout_sigma_s: 0.0, before: Some((*before, dt_s, Some(Twist(Vector6::zeros())))) };
        Jump::default().step(&pose, &rows, &residuals)
    }

    #[test]
    fn a_zoom_seen_from_ahead_is_a_focal_step() {
        let stand = facing(0.02, 0.03, Vector3::new(0.2, 0.05, 5.0));
        let i = *lens(640, 480).intrinsics();
        for by in [1.15, 1.03, 0.9] {
            let zoomed = CameraModel::new(Intrinsics { fx: by * i.fx, fy: by * i.fy, ..i }).unwrap();
            let found = step(&zoomed, &stand, &stand, 0.03).expect("a step").abs();
            assert!((found - f64::ln(by).abs()).abs() < 0.2 * f64::ln(by).abs(), "{by}: {found}");
        }
    }

    #[test]
    fn a_sideways_jolt_is_not_a_focal_step() {
        let stand = facing(0.02, 0.03, Vector3::new(0.2, 0.05, 5.0));
        for (rotation, shift) in [([0.03, 0.0], 0.0), ([0.0, -0.05], 0.1), ([0.01, 0.03], -0.2)] {
            let jolted = facing(0.02 + rotation[0], 0.03 + rotation[1], Vector3::new(0.2 + shift, 0.05, 5.0));
            assert_eq!(step(&lens(640, 480), &jolted, &stand, 0.03), None, "{rotation:?}, {shift} m");
        }
    }

    #[test]
    fn a_dolly_start_between_slow_frames_is_not_a_focal_step() {
        let stand = facing(0.02, 0.03, Vector3::new(0.2, 0.05, 5.0));
        let nearer = facing(0.02, 0.03, Vector3::new(0.2, 0.05, 4.8));
        // 1 m/s at 5 frames a second; no camera reaches that within a thirtieth of a second.
        assert_eq!(step(&lens(640, 480), &nearer, &stand, 0.2), None);
        assert!(step(&lens(640, 480), &nearer, &stand, 1.0 / 30.0).is_some());
    }
}
