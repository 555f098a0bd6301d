//! Prediction while coasting: the last two measured poses, carried on at constant velocity, by no more than was moved lately.

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
    /// The step before the last, seconds.
    step_s: f64,
}

/// Measurements further apart than this say nothing about velocity, seconds, unless they come no faster. Chosen: three frames at 30 a
/// second. Raised, a body coasts with a velocity that is out of date; lowered, a dropped frame leaves it standing.
const LONGEST_STEP_S: f64 = 0.1;
/// And further apart than this never, seconds: as long as a gap between frames that is still an interval (`frame_interval`). Raised, pauses
/// give velocities.
const LONGEST_INTERVAL_S: f64 = 0.5;
/// Without measurements the velocity fades with this time constant, seconds: a camera that vanished is more likely to stop than to go on.
/// As long as bodies coast by default. Raised, coasting overshoots stops by more; lowered, it lags behind what goes on.
pub const FADE_S: f64 = 0.2;

impl<To, From> Default for MotionHistory<To, From> {
    fn default() -> Self {
        Self { last: None, is_known: false, reach: Reach::default(), step_s: 0.0 }
    }
}

impl<To, From> MotionHistory<To, From> {
    /// Takes a measured pose.
    pub fn measured(&mut self, timestamp: Timestamp, pose: &Pose<To, From>) {
        let mut motion = Motion::still(*pose);
        if let Some((then, before)) = &self.last {
            let dt = timestamp.seconds_since(*then);
            let longest = LONGEST_STEP_S.max(1.5 * self.step_s).min(LONGEST_INTERVAL_S);
            self.step_s = dt;
            if dt > 1e-4 && dt <= longest {
                motion = Motion::between(&before.pose, pose, dt);
            }
        }
        self.reach.push(timestamp, pose);
        self.last = Some((timestamp, motion));
        self.is_known = true;
    }

    /// Forgets the motion: what comes next is no continuation.
    pub fn reset(&mut self) {
        self.last = None;
        self.reach.clear();
    }

    /// Whether anything was ever measured, before a reset or after.
    pub fn is_known(&self) -> bool {
        self.is_known
    }

    /// The pose expected at a stamp. Two poses alone would make of a kick, or of noise at a high rate, a long way: what is added is no
    /// more than the body moved within the last `FADE_S`.
    pub fn predicted(&self, timestamp: Timestamp) -> Option<Pose<To, From>> {
        let (then, last) = self.last.as_ref()?;
        let dt = timestamp.seconds_since(*then);
        let share = 1.0 - (-dt / FADE_S).exp();
        let [way, turn] = self.reach.carries([last.velocity, last.turn_rate], FADE_S);
        let pose = last.pose.moved(&(way * share), &(turn * share));
        pose.is_finite().then_some(pose)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::geometry::{Camera, Stage};

    #[test]
    fn carries_on_at_first_and_comes_to_rest() {
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
    fn a_kick_just_before_the_light_fails_does_not_run_away() {
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
