//! Where a body is expected: in the frame that finds it, and in the ones that do not.

use nalgebra::Vector2;

use super::TrackedBody;
use crate::camera::CameraModel;
use crate::frame::Timestamp;
use crate::geometry::resection::{Twist, perturbed};
use crate::geometry::{Body, Camera, Pose};
use crate::motion::MotionEstimate;
use crate::track::acquire::search_windows::Extent;
use crate::track::acquire::unexplained_cells::MARGIN_PX;

/// Verified poses further apart tell nothing of the motion within a frame, seconds; those of two frames in a row do, however slow the
/// camera. Chosen: two frames at 30 a second. Raised, a motion that has changed is taken for this frame's; lowered, a dropped frame leaves
/// it unknown.
const MAX_MOTION_GAP_S: f64 = 0.07;
/// For so long after a body was last seen, seconds, that place is searched first. Chosen: what was covered for a moment, or found just now, is still there. Raised,
/// bodies that went away keep others waiting; lowered, one that was found in one frame may not be found in the next, which has to confirm it.
const LAST_SEEN_FOR_S: f64 = 0.5;

impl TrackedBody {
    /// Its motion in the frame, if it was aligned there.
    pub fn motion_at(&self, timestamp: Timestamp) -> Option<&MotionEstimate> {
        self.motion.as_ref().filter(|(_, then)| *then == timestamp).map(|(motion, _)| motion)
    }

    /// The motion of a body that was just found, with its pose known to so much (one sigma, metres and radians). `camera`: the camera's motion in the stage, where the body is an object
    /// and that is known.
    ///
    /// A rolling shutter does not use `camera`: there a tilt and a motion ahead look alike, and the wider prior of objects would leave every tilt open.
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

    /// Whether its motion is known: it was verified in two frames in a row before it was lost.
    pub fn has_motion(&self) -> bool {
        self.before.is_some_and(|(_, _, twist)| twist.is_some())
    }

    /// Where the body should be at a stamp, carried on from the last verified poses.
    pub fn predicted(&self, timestamp: Timestamp) -> Option<Pose<Camera, Body>> {
        let (before, dt_s, twist) = self.before_at(timestamp)?;
        Some(twist.map_or(before, |twist| perturbed(&before, &(twist.0 * dt_s))))
    }

    /// Where it was last seen, if that is not long ago, and where it should be by now.
    pub fn expected_poses(&self, timestamp: Timestamp) -> impl Iterator<Item = Pose<Camera, Body>> {
        let recent = self.before.map(|(last, then, twist)| (last, timestamp.seconds_since(then), twist));
        recent.filter(|(_, dt_s, _)| *dt_s <= LAST_SEEN_FOR_S).into_iter().flat_map(|(last, dt_s, twist)| {
            let by_now = twist.map(|twist| perturbed(&last, &(twist.0 * dt_s)));
            std::iter::once(last).chain(by_now)
        })
    }

    /// The part of the frame that has it in it where it was last seen, if that is not long ago, and where it should be by now; `None` if that lies beyond the frame.
    pub fn expected_place(&self, timestamp: Timestamp, camera: &CameraModel) -> Option<Extent> {
        let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        for pose in self.expected_poses(timestamp) {
            for rectangle in self.body.surfaces.iter().map(|s| &s.rectangle) {
                for (x, y) in [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)] {
                    let corner = [x * rectangle.size_m[0], y * rectangle.size_m[1]];
                    // From behind its face as well: a box has it on its other side.
                    let Some(seen) = rectangle.see(&pose.inverse(), camera, corner, f64::NEG_INFINITY) else { continue };
                    (low, high) = (low.inf(&seen.pixel), high.sup(&seen.pixel));
                }
            }
        }
        let size = [camera.width(), camera.height()];
        let from = [0, 1].map(|k| (low[k] - f64::from(MARGIN_PX)).clamp(0.0, f64::from(size[k])) as u32);
        let to = [0, 1].map(|k| (high[k] + f64::from(MARGIN_PX)).clamp(0.0, f64::from(size[k])) as u32);
        (0..2).all(|k| from[k] < to[k]).then_some([from, to])
    }

    /// The last verified pose as seen from a stamp, if it is recent enough to tell of motion.
    pub fn before_at(&self, timestamp: Timestamp) -> Option<(Pose<Camera, Body>, f64, Option<Twist>)> {
        let (pose, then, twist) = self.before?;
        let dt_s = timestamp.seconds_since(then);
        (dt_s > 1e-4 && dt_s <= MAX_MOTION_GAP_S.max(self.to_next_s)).then_some((pose, dt_s, twist))
    }
}
