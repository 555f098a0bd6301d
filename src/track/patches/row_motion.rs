//! The motion of the body while a rolling shutter reads the rows of a frame.
//!
//! It is computed from the difference to the last verified pose and used as a nuisance only: the
//! pose itself is always measured against the reference picture.

use nalgebra::Vector6;

use crate::camera::Shutter;
use crate::geometry::resection::Twist;
use crate::geometry::{Body, Camera, Pose};

/// What is known about the motion during the readout of a frame.
#[derive(Debug, Clone, Copy)]
pub struct RowMotion {
    /// When the rows are exposed.
    pub shutter: Shutter,
    /// Sigma of its readout time, seconds; 0 if it is configured.
    pub readout_sigma_s: f64,
    /// The last verified pose (`T_camera_body`), its age in seconds, and its motion if known.
    pub before: Option<(Pose<Camera, Body>, f64, Option<Twist>)>,
}

impl RowMotion {
    /// Returns the body's motion at the middle row of this frame if its pose is now `pose`
    /// (`T_camera_body`); zero without a rolling shutter or an earlier pose.
    pub(in crate::track) fn twist(&self, pose: &Pose<Camera, Body>) -> Twist {
        match &self.before {
            Some((before, dt_s, then)) if self.shutter.readout_s > 0.0 => {
                // The difference is the motion half a frame ago; half its change leads to now.
                let between = Twist::between(before, pose, *dt_s);
                then.map_or(between, |then| Twist(between.0 + (between.0 - then.0) * 0.5))
            }
            _ => Twist::still(),
        }
    }

    /// Returns the motion since the last pose if the pose is now `pose` (`T_camera_body`), and its
    /// change, or half the motion if the change is unknown; both per second. `None` without an
    /// earlier pose.
    pub(in crate::track) fn twist_and_change(&self, pose: &Pose<Camera, Body>) -> Option<(Vector6<f64>, Vector6<f64>)> {
        let (before, dt_s, then) = self.before.as_ref()?;
        let now = Twist::between(before, pose, *dt_s).0;
        Some((now, then.map_or(now * 0.5, |then| now - then.0)))
    }

    /// Returns the standard deviations of [`RowMotion::twist`], per second: the change of the
    /// motion since the last frame, or a typical hand-held motion if nothing is known. `None`
    /// without a rolling shutter.
    pub(in crate::track) fn twist_deviation(&self, pose: &Pose<Camera, Body>) -> Option<Vector6<f64>> {
        if self.shutter.readout_s <= 0.0 {
            return None;
        }
        let relative = pose.translation.norm();
        let usual = Vector6::new(relative, relative, relative, 1.0, 1.0, 1.0);
        Some(match &self.before {
            Some((before, dt_s, Some(then))) => (Twist::between(before, pose, *dt_s).0 - then.0).abs() + usual * 0.01,
            Some((before, dt_s, None)) => Twist::between(before, pose, *dt_s).0.abs() * 0.5 + usual * 0.1,
            None => usual * 0.3,
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::geometry::resection::perturbed;
    use crate::track::synthetic::facing;

    #[test]
    fn the_twist_is_the_motion_since_the_last_pose() {
        let step = Vector6::new(0.03, 0.0, -0.02, 0.01, 0.0, 0.02);
        let now = facing(0.2, -0.3, Vector3::new(0.1, 0.05, 3.4));
        let before = perturbed(&now, &-step);
        let still =
            RowMotion { shutter: Shutter { exposure_s: 0.0, readout_s: 0.0 }, readout_sigma_s: 0.0, before: Some((before, 0.05, None)) };
        assert_eq!(still.twist(&now), Twist::still());
        assert!(still.twist_deviation(&now).is_none());
        let rolling =
            RowMotion { shutter: Shutter { exposure_s: 0.0, readout_s: 0.02 }, readout_sigma_s: 0.0, before: Some((before, 0.05, None)) };
        assert!((rolling.twist(&now).0 - step / 0.05).norm() < 0.02);
        // Speeding up: half of the change leads from between the frames to now.
        let then = Twist(step / 0.1);
        let faster = RowMotion {
            shutter: Shutter { exposure_s: 0.0, readout_s: 0.02 },
            readout_sigma_s: 0.0,
            before: Some((before, 0.05, Some(then))),
        };
        assert!((faster.twist(&now).0 - step * 25.0).norm() < 0.03);
        let (twist, change) = still.twist_and_change(&now).expect("a pose before");
        assert!((twist - step * 20.0).norm() < 0.02 && (change - twist * 0.5).norm() < 1e-9);
        assert!(rolling.twist_deviation(&now).is_some_and(|d| d.iter().all(|v| *v > 0.0)));
    }
}
