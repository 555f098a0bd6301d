//! Predicts where a body is: in the frame that finds it, and in frames that do not find it.

use crate::track::acquire::tuning::TUNING as ACQUIRE_TUNING;
use crate::track::body::tuning::TUNING;
use nalgebra::Vector2;

use super::TrackedBody;
use crate::camera::CameraModel;
use crate::frame::Timestamp;
use crate::geometry::resection::{Twist, perturbed};
use crate::geometry::{Body, Camera, Pose};
use crate::motion::MotionEstimate;
use crate::track::acquire::search_windows::Extent;

impl TrackedBody {
    /// Returns its motion in the frame at `timestamp`, if it was aligned there.
    pub fn motion_at(&self, timestamp: Timestamp) -> Option<&MotionEstimate> {
        self.motion.as_ref().filter(|(_, then)| *then == timestamp).map(|(motion, _)| motion)
    }

    /// Returns the prior of a newly found body's motion; `off`: one sigma of its pose, metres and
    /// radians. `camera`: the camera's motion relative to the stage, if the body is an object and
    /// that is known.
    ///
    /// `camera` is not used under a rolling shutter: there a tilt and a motion ahead look alike,
    /// and the wider prior of objects would leave every tilt undetermined.
    pub fn unseen(&self, pose: Pose<Body, Camera>, off: [f64; 2], camera: Option<&MotionEstimate>) -> MotionEstimate {
        let distance_m = self.aligner.distance_m(&pose);
        match camera.filter(|_| self.aligner.is_global()) {
            Some(camera) => MotionEstimate::unseen_object(pose, distance_m, off, camera),
            None => MotionEstimate::unseen(pose, distance_m, off[0], off[1]),
        }
    }

    /// Remembers a verified pose for the motion of the next frame.
    pub fn remember(&mut self, timestamp: Timestamp, t_body_camera: &Pose<Body, Camera>) {
        let pose = t_body_camera.inverse();
        let twist = self.before_at(timestamp).map(|(before, dt_s, _)| Twist::between(&before, &pose, dt_s));
        self.before = Some((pose, timestamp, twist));
    }

    /// Whether its motion is known: it was verified in two consecutive frames before it was lost.
    pub fn has_motion(&self) -> bool {
        self.before.is_some_and(|(_, _, twist)| twist.is_some())
    }

    /// Returns the pose extrapolated to a timestamp from the last verified poses.
    pub fn predicted(&self, timestamp: Timestamp) -> Option<Pose<Camera, Body>> {
        let (before, dt_s, twist) = self.before_at(timestamp)?;
        Some(twist.map_or(before, |twist| perturbed(&before, &(twist.0 * dt_s))))
    }

    /// Returns where it was last seen, if recently, and then its extrapolated pose, if known.
    pub fn expected_poses(&self, timestamp: Timestamp) -> impl Iterator<Item = Pose<Camera, Body>> {
        let recent = self.before.map(|(last, then, twist)| (last, timestamp.seconds_since(then), twist));
        recent.filter(|(_, dt_s, _)| *dt_s <= TUNING.last_seen_search_s).into_iter().flat_map(|(last, dt_s, twist)| {
            let by_now = twist.map(|twist| perturbed(&last, &(twist.0 * dt_s)));
            std::iter::once(last).chain(by_now)
        })
    }

    /// Returns the bounding box in the frame of where it was last seen, if recently, and where it
    /// is predicted, with a margin; `None` if that lies outside the frame.
    pub fn expected_place(&self, timestamp: Timestamp, camera: &CameraModel) -> Option<Extent> {
        let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        for pose in self.expected_poses(timestamp) {
            for rectangle in self.body.surfaces.iter().map(|s| &s.rectangle) {
                for (x, y) in [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)] {
                    let corner = [x * rectangle.size_m[0], y * rectangle.size_m[1]];
                    // Includes surfaces seen from behind: a box shows its other side there.
                    let Some(seen) = rectangle.see(&pose.inverse(), camera, corner, f64::NEG_INFINITY) else { continue };
                    (low, high) = (low.inf(&seen.pixel), high.sup(&seen.pixel));
                }
            }
        }
        let size = [camera.width(), camera.height()];
        let from = [0, 1].map(|k| (low[k] - f64::from(ACQUIRE_TUNING.region_margin_px)).clamp(0.0, f64::from(size[k])) as u32);
        let to = [0, 1].map(|k| (high[k] + f64::from(ACQUIRE_TUNING.region_margin_px)).clamp(0.0, f64::from(size[k])) as u32);
        (0..2).all(|k| from[k] < to[k]).then_some([from, to])
    }

    /// Returns the last verified pose, the seconds since then, and the twist that led to it, if it
    /// is recent enough to imply motion at `timestamp`.
    pub fn before_at(&self, timestamp: Timestamp) -> Option<(Pose<Camera, Body>, f64, Option<Twist>)> {
        let (pose, then, twist) = self.before?;
        let dt_s = timestamp.seconds_since(then);
        (dt_s > 1e-4 && dt_s <= TUNING.max_motion_gap_s.max(self.attempt.to_next_s)).then_some((pose, dt_s, twist))
    }
}
