//! Prediction while coasting: extrapolates the last two measured poses at constant velocity, by at
//! most the recent motion.

use super::reach::Reach;
use super::state::Motion;
use crate::frame::Timestamp;
use crate::geometry::Pose;

/// The last measurement and the motion that led to it.
#[derive(Debug, Clone)]
pub struct MotionHistory<To, From> {
    last: Option<(Timestamp, Motion<To, From>)>,
    /// Whether there ever was a measurement.
    is_known: bool,
    reach: Reach<To, From>,
    /// The last time step, seconds.
    step_s: f64,
}

/// Maximum time between measurements for a velocity, seconds, unless they normally are farther
/// apart. Chosen: three frames at 30 per second. Raised, a body coasts with an outdated velocity;
/// lowered, a dropped frame makes it stand still.
const MAX_STEP_S: f64 = 0.1;
/// Absolute maximum of that time, seconds: the longest gap between frames that still counts as an
/// interval (`frame_interval`). Raised, pauses yield velocities.
const MAX_INTERVAL_S: f64 = 0.5;
/// Time constant with which the velocity fades without measurements, seconds: a camera that
/// vanished is more likely to stop than to go on. As long as bodies coast by default. Raised,
/// coasting overshoots stops more; lowered, it lags behind continued motion.
pub const FADE_S: f64 = 0.2;

impl<To, From> Default for MotionHistory<To, From> {
    fn default() -> Self {
        Self { last: None, is_known: false, reach: Reach::default(), step_s: 0.0 }
    }
}

impl<To, From> MotionHistory<To, From> {
    /// Adds a measured pose.
    pub fn measured(&mut self, timestamp: Timestamp, pose: &Pose<To, From>) {
        let mut motion = Motion::still(*pose);
        if let Some((then, before)) = &self.last {
            let dt = timestamp.seconds_since(*then);
            let longest = MAX_STEP_S.max(1.5 * self.step_s).min(MAX_INTERVAL_S);
            self.step_s = dt;
            if dt > 1e-4 && dt <= longest {
                motion = Motion::between(&before.pose, pose, dt);
            }
        }
        self.reach.push(timestamp, pose);
        self.last = Some((timestamp, motion));
        self.is_known = true;
    }

    /// Forgets the motion: the next measurement is not a continuation.
    pub fn reset(&mut self) {
        self.last = None;
        self.reach.clear();
    }

    /// Whether anything was ever measured, even before a reset.
    pub fn is_known(&self) -> bool {
        self.is_known
    }

    /// Predicts the pose at a stamp. Two poses alone would extrapolate a kick, or noise at a high
    /// frame rate, much too far. So the added motion is at most what the body moved within the last
    /// `FADE_S`.
    pub fn predicted(&self, timestamp: Timestamp) -> Option<Pose<To, From>> {
        let (then, last) = self.last.as_ref()?;
        let dt = timestamp.seconds_since(*then);
        let share = 1.0 - (-dt / FADE_S).exp();
        let [way, rotation] = self.reach.carries([last.velocity, last.angular_velocity], FADE_S);
        let pose = last.pose.moved(&(way * share), &(rotation * share));
        pose.is_finite().then_some(pose)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::geometry::{Camera, Stage};

    #[test]
    fn a_prediction_continues_at_first_then_comes_to_rest() {
        let mut history = MotionHistory::<Stage, Camera>::default();
        assert!(history.predicted(Timestamp::default()).is_none());
        let at = |x: f64| Pose::new(UnitQuaternion::from_euler_angles(0.0, 0.0, x), Vector3::new(x, 0.0, 0.0));
        for k in 0..11 {
            history.measured(Timestamp::from_ns(k * 20_000_000), &at(0.02 * k as f64));
        }
        let soon = history.predicted(Timestamp::from_seconds(0.21)).expect("a history");
        assert!((soon.translation.x - 0.21).abs() < 0.001 && (soon.rotation.angle() - 0.21).abs() < 0.001);
        let late = history.predicted(Timestamp::from_seconds(5.0)).expect("a history");
        assert!((late.translation.x - 0.4).abs() < 0.01);
    }

    #[test]
    fn a_jolt_just_before_a_blackout_does_not_run_away() {
        for interval_ns in [200_000_000, 33_333_333, 4_166_667] {
            let mut history = MotionHistory::<Stage, Camera>::default();
            let at = |x: f64| Pose::new(UnitQuaternion::from_euler_angles(0.0, 0.0, x), Vector3::new(x, 0.0, 0.0));
            for k in 0..100 {
                history.measured(Timestamp::from_ns(k * interval_ns), &at(0.005 * f64::from(k == 99)));
            }
            let late = history.predicted(Timestamp::from_ns(99 * interval_ns).after_s(5.0)).expect("a history");
            assert!(late.translation.x <= 0.01 + 1e-9 && late.rotation.angle() <= 0.01 + 1e-9, "{late:?}");
        }
    }

    #[test]
    fn a_slow_camera_has_a_velocity_too() {
        let mut history = MotionHistory::<Stage, Camera>::default();
        for k in 0..3 {
            history.measured(Timestamp::from_ns(k * 200_000_000), &Pose::new(UnitQuaternion::identity(), Vector3::x() * k as f64));
        }
        let next = history.predicted(Timestamp::from_seconds(0.45)).expect("a history");
        assert!(next.translation.x > 2.1, "{}", next.translation.x);
    }

    #[test]
    fn a_long_gap_gives_no_velocity() {
        let mut history = MotionHistory::<Stage, Camera>::default();
        history.measured(Timestamp::default(), &Pose::identity());
        history.measured(Timestamp::from_seconds(1.0), &Pose::new(UnitQuaternion::identity(), Vector3::x()));
        let next = history.predicted(Timestamp::from_seconds(1.05)).expect("a history");
        assert_eq!(next.translation, Vector3::x());
    }
}
