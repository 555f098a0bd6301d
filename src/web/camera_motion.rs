//! The camera's motion while a frame's rows are read, for drawing over a rolling shutter's picture.
//! It is derived from the last measured poses; nothing else is stored.

use nalgebra::Vector3;
use serde::Serialize;

use crate::frame::Timestamp;
use crate::geometry::{Camera, Pose, Stage};
use crate::record::{PoseSample, State};

/// Maximum interval between two frames for their difference to be a motion, seconds. Chosen: ten
/// frames per second. Raised, a shake between two frames passes for a slow motion.
const MAX_GAP_S: f64 = 0.1;

/// The camera's motion in its own axes, at a frame's stamp.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct CameraMotion {
    /// Velocity, m/s.
    pub velocity: [f64; 3],
    /// Angular velocity, rad/s.
    #[serde(rename = "turn_rate")]
    pub angular_velocity: [f64; 3],
}

/// Follows the poses of one session.
#[derive(Debug, Default)]
pub(super) struct MotionFollower {
    before: Option<Before>,
}

#[derive(Debug)]
struct Before {
    pose: Pose<Stage, Camera>,
    timestamp: Timestamp,
    /// Rates from the previous pose to this one, per second, in the camera's axes.
    rates: Option<[Vector3<f64>; 2]>,
}

impl MotionFollower {
    /// Returns the motion at this sample's stamp; `None` if no pose was measured just before.
    pub fn after(&mut self, sample: &PoseSample) -> Option<CameraMotion> {
        let Some(pose) = sample.measurement.as_ref().filter(|_| sample.state == State::Tracking).map(|measured| measured.pose) else {
            self.before = None;
            return None;
        };
        let before = self.before.take();
        let since = before.and_then(|before| {
            let dt_s = sample.timestamp.seconds_since(before.timestamp);
            (dt_s > 0.0 && dt_s <= MAX_GAP_S).then_some((before, dt_s))
        });
        let rates = since.as_ref().map(|(before, dt_s)| {
            let shift = pose.rotation.inverse() * (pose.translation - before.pose.translation);
            let turn = (before.pose.rotation.inverse() * pose.rotation).scaled_axis();
            [shift / *dt_s, turn / *dt_s]
        });
        // The difference is the motion half a frame ago; adding half its change extrapolates to
        // now.
        let now = since.and_then(|(before, _)| {
            let between = rates?;
            Some(before.rates.map_or(between, |then| [0, 1].map(|k| between[k] + (between[k] - then[k]) * 0.5)))
        });
        self.before = Some(Before { pose, timestamp: sample.timestamp, rates });
        now.map(|[velocity, angular_velocity]| CameraMotion { velocity: velocity.into(), angular_velocity: angular_velocity.into() })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix6, UnitQuaternion};

    use super::*;
    use crate::record::{Measurement, TwoViewModel};

    fn sample(at_s: f64, pose: Pose<Stage, Camera>) -> PoseSample {
        let mut sample = PoseSample::new(0, Timestamp::from_ns((at_s * 1e9) as i64), State::Tracking);
        let (covariance, model) = (Matrix6::identity(), TwoViewModel::Homography);
        sample.measurement = Some(Measurement {
            pose,
            covariance,
            common: Matrix6::zeros(),
            model: Some(model),
            homography: None,
            essential: None,
            inliers: Some(0),
            rms_px: Some(0.0),
        });
        sample
    }

    /// A camera that accelerates along its own x and turns about its own y.
    fn pose(t: f64) -> Pose<Stage, Camera> {
        let first = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.9);
        let rotation = first * UnitQuaternion::from_scaled_axis(Vector3::y() * (0.5 * t + t * t));
        Pose::new(rotation, first * Vector3::x() * (0.2 * t + 0.5 * t * t))
    }

    #[test]
    fn camera_motion_is_at_the_stamp_in_the_cameras_axes() {
        let (mut follower, step) = (MotionFollower::default(), 0.01);
        let found: Vec<_> = (0..4).map(|k| follower.after(&sample(step * f64::from(k), pose(step * f64::from(k))))).collect();
        assert_eq!(found[0], None);
        let t = 3.0 * step;
        let motion = found[3].unwrap();
        let velocity = pose(t).rotation.inverse() * (pose(t).translation - pose(t - 1e-6).translation) / 1e-6;
        assert!((Vector3::from(motion.velocity) - velocity).norm() < 1e-3, "{motion:?} {velocity}");
        assert!((Vector3::from(motion.angular_velocity) - Vector3::y() * (0.5 + 2.0 * t)).norm() < 1e-3, "{motion:?}");
    }

    #[test]
    fn a_gap_or_a_lost_stage_ends_the_camera_motion() {
        let mut follower = MotionFollower::default();
        assert!(follower.after(&sample(0.0, pose(0.0))).is_none() && follower.after(&sample(0.05, pose(0.05))).is_some());
        assert_eq!(follower.after(&sample(0.25, pose(0.25))), None, "too long ago");
        assert_eq!(follower.after(&sample(0.25, pose(0.25))), None, "the same stamp again");
        assert!(follower.after(&sample(0.3, pose(0.3))).is_some());
        follower.after(&PoseSample::new(9, Timestamp::from_ns(310_000_000), State::Lost));
        assert_eq!(follower.after(&sample(0.32, pose(0.32))), None);
    }
}
