//! The state of a body from frame to frame: searching, tracking, coasting, lost.
//!
//! A new pose must be confirmed by further frames that agree with it; a tracked body that
//! disappears coasts for a while, then is lost. Decisions depend on frame timestamps alone, never
//! on a clock, so a replay reproduces the live result.

use crate::track::body::tuning::TUNING;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::frame::Timestamp;
use crate::geometry::{Body, Camera, Pose};
use crate::motion::MAX_ACCELERATION;

/// What is known of a body in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum State {
    /// Never found yet.
    #[default]
    Searching,
    /// Measured in this frame, verified against the picture, and confirmed.
    Tracking,
    /// Predicted from earlier frames, for at most `coast_s`.
    Coasting,
    /// Found before, but not now.
    Lost,
    /// Live only: the camera delivers no pictures. Such a sample is a message to subscribers, never
    /// a line of contract C3.
    Stale,
}

impl State {
    /// All states, in the order of their numbers.
    pub const ALL: [State; 5] = [Self::Searching, Self::Tracking, Self::Coasting, Self::Lost, Self::Stale];

    /// Returns the word used in records.
    pub fn word(self) -> &'static str {
        match self {
            Self::Searching => "searching",
            Self::Tracking => "tracking",
            Self::Coasting => "coasting",
            Self::Lost => "lost",
            Self::Stale => "stale",
        }
    }
}

/// Why a verified pose is not reported yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Doubt {
    /// It is the first one and needs confirmation.
    First,
    /// It is far from the previous one, or from anywhere that the body can have reached since its
    /// last reported pose.
    Disagrees,
}

/// A verified pose that waits for others to agree with it.
#[derive(Debug, Clone, Copy)]
struct Pending {
    pose: Pose<Body, Camera>,
    timestamp: Timestamp,
    agreeing: u32,
    /// When the first of these poses came, if the body cannot have moved there since its last
    /// reported pose.
    jumped: Option<Timestamp>,
}

/// The state machine of one body.
#[derive(Debug, Clone, Default)]
pub struct TrackStateMachine {
    state: State,
    was_reported: bool,
    last_reported: Option<Pending>,
    pending: Option<Pending>,
    doubt: Option<Doubt>,
    /// Velocity between the last two reported poses, m/s: of the camera in the body's frame, and of
    /// the body in the camera's.
    velocities: Option<[Vector3<f64>; 2]>,
    /// See [`of_camera`](Self::of_camera).
    is_of_camera: bool,
}

impl TrackStateMachine {
    /// Creates the machine of a stage: what moves is the camera, whose acceleration is limited,
    /// unlike a thrown or bouncing prop.
    pub fn of_camera() -> Self {
        Self { is_of_camera: true, ..Self::default() }
    }

    /// Returns the state after the last frame.
    pub fn state(&self) -> State {
        self.state
    }

    /// Whether a pose of the body was reported in any frame.
    pub fn was_reported(&self) -> bool {
        self.was_reported
    }

    /// Whether a pose in the next frame would continue a track.
    pub fn is_continued(&self) -> bool {
        matches!(self.state, State::Tracking | State::Coasting)
    }

    /// Returns why the last frame's verified pose was not reported; `None` if it was, or if there
    /// was none.
    pub fn doubt(&self) -> Option<Doubt> {
        self.doubt
    }

    /// Whether the body can have reached a pose since its last reported one; true if none was
    /// reported.
    pub fn may_have_come(&self, pose: &Pose<Body, Camera>, timestamp: Timestamp) -> bool {
        let velocities = self.velocities.filter(|_| self.is_of_camera);
        self.last_reported.is_none_or(|last| is_reachable(&last.pose, pose, timestamp.seconds_since(last.timestamp), velocities))
    }

    /// Whether a pose in this frame would continue a track without further confirmation.
    pub fn continues_at(&self, pose: &Pose<Body, Camera>, timestamp: Timestamp) -> bool {
        self.is_continued() && self.may_have_come(pose, timestamp)
    }

    /// Ends the track at once: poses are withheld, and none may be predicted from them. Returns the
    /// state.
    pub fn withhold(&mut self) -> State {
        let was_reported = self.was_reported;
        let state = if was_reported { State::Lost } else { State::Searching };
        *self = Self { state, was_reported, is_of_camera: self.is_of_camera, ..Self::default() };
        self.state
    }

    /// Updates the state with the outcome of a frame. `coast_s` and `confirm_frames` are the
    /// tracker's settings; `confirm_frames` is 1 for a conclusive frame.
    pub fn update(&mut self, timestamp: Timestamp, verified: Option<&Pose<Body, Camera>>, coast_s: f64, confirm_frames: u32) -> State {
        let continued = self.is_continued();
        self.doubt = None;
        if let Some(pose) = verified {
            let pending = self.merged_with_pending(pose, timestamp);
            let disagrees = pending.agreeing == 1
                && self.pending.as_ref().is_some_and(|before| timestamp.seconds_since(before.timestamp) <= TUNING.max_confirming_gap_s);
            self.pending = Some(pending);
            let is_confirmed = match pending.jumped {
                None => pending.agreeing >= confirm_frames,
                Some(since) => timestamp.seconds_since(since) >= TUNING.jump_confirmation_s,
            };
            if is_confirmed {
                self.was_reported = true;
                self.velocities = self.last_reported.filter(|_| pending.jumped.is_none()).and_then(|last| velocities(&last, &pending));
                self.last_reported = Some(Pending { jumped: None, ..pending });
                self.pending = self.last_reported;
                self.state = State::Tracking;
                return self.state;
            }
            self.doubt = Some(if disagrees || pending.jumped.is_some() { Doubt::Disagrees } else { Doubt::First });
        }
        let may_coast = continued && self.last_reported.is_some_and(|last| timestamp.seconds_since(last.timestamp) <= coast_s);
        self.state = match (may_coast, self.was_reported) {
            (true, _) => State::Coasting,
            (false, true) => State::Lost,
            (false, false) => State::Searching,
        };
        if verified.is_none() {
            let is_stale = |p: &Pending| timestamp.seconds_since(p.timestamp) > TUNING.max_confirming_gap_s;
            // A single verified frame must be confirmed by the next one; a track may skip frames
            // while it coasts, and so may a jump.
            self.pending = self.pending.filter(|p| !is_stale(p) && (self.is_continued() || p.jumped.is_some()));
        }
        self.state
    }

    /// Returns a verified pose merged with those that wait.
    fn merged_with_pending(&self, pose: &Pose<Body, Camera>, timestamp: Timestamp) -> Pending {
        let fresh = |jumped| Pending { pose: *pose, timestamp, agreeing: 1, jumped };
        // While coasting, agreement with the last reported pose is enough, whatever was seen
        // meanwhile.
        let reported = self.last_reported.filter(|_| self.is_continued());
        let jumped = || (!self.may_have_come(pose, timestamp)).then_some(timestamp);
        match [self.pending, reported].into_iter().flatten().find(|before| agree(before, pose, timestamp)) {
            // Plausible motion from a copy of the picture to the same copy is no plausible motion
            // from the last reported pose.
            Some(before) if before.jumped.is_some() => Pending { agreeing: before.agreeing.saturating_add(1), ..fresh(before.jumped) },
            Some(before) => match jumped() {
                None => Pending { agreeing: before.agreeing.saturating_add(1), ..fresh(None) },
                jumped => fresh(jumped),
            },
            None => fresh(jumped()),
        }
    }
}

/// Whether the body could have moved from the pending pose to this one in the time between.
fn agree(pending: &Pending, pose: &Pose<Body, Camera>, timestamp: Timestamp) -> bool {
    let dt = timestamp.seconds_since(pending.timestamp);
    if !(0.0..=TUNING.max_confirming_gap_s).contains(&dt) {
        return false;
    }
    let distance = nearest_m(&pending.pose, pose);
    // Uses the camera's centre: rotation on the spot is no shift.
    let shift = (pose.translation - pending.pose.translation).norm();
    let rotation = pose.angle_to(&pending.pose);
    shift < (TUNING.confirming_shift_tolerance + TUNING.max_confirming_shift_per_s * dt) * distance
        && rotation < TUNING.confirming_rotation_tolerance + TUNING.max_confirming_rotation_per_s * dt
}

/// Whether a body can have moved between two poses within `dt_s` seconds, given the speeds possible
/// on a stage. Rotation is ignored: a copy is elsewhere, and whatever only rotates is the same
/// picture, tilted.
fn is_reachable(from: &Pose<Body, Camera>, to: &Pose<Body, Camera>, dt_s: f64, velocities: Option<[Vector3<f64>; 2]>) -> bool {
    let (distance, dt_s) = (nearest_m(from, to), dt_s.max(0.0));
    let slack = TUNING.confirming_shift_tolerance * distance;
    let reach = slack + (TUNING.max_confirming_shift_per_s * distance).max(TUNING.max_body_speed_m_per_s) * dt_s;
    let of_way = slack + 0.5 * MAX_ACCELERATION * dt_s * dt_s;
    // A camera rotating on the spot stays in place relative to the body; a prop rotating on the
    // spot stays in place relative to the camera. Either suffices.
    ways(from, to)
        .into_iter()
        .enumerate()
        .any(|(k, way)| way.norm() < reach && velocities.is_none_or(|velocities| (way - velocities[k] * dt_s).norm() < of_way))
}

/// Returns the displacement of the camera in the body's frame and of the body in the camera's.
fn ways(from: &Pose<Body, Camera>, to: &Pose<Body, Camera>) -> [Vector3<f64>; 2] {
    [to.translation - from.translation, to.inverse().translation - from.inverse().translation]
}

fn velocities(from: &Pending, to: &Pending) -> Option<[Vector3<f64>; 2]> {
    let dt_s = to.timestamp.seconds_since(from.timestamp);
    (dt_s > 0.0 && dt_s <= TUNING.max_confirming_gap_s).then(|| ways(&from.pose, &to.pose).map(|way| way / dt_s))
}

fn nearest_m(a: &Pose<Body, Camera>, b: &Pose<Body, Camera>) -> f64 {
    a.translation.norm().min(b.translation.norm())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    fn stamp(frame: usize) -> Timestamp {
        Timestamp::from_ns(frame as i64 * 33_333_333)
    }

    fn at(x: f64) -> Pose<Body, Camera> {
        Pose::new(UnitQuaternion::from_euler_angles(3.0, 0.0, 0.0), Vector3::new(x, 0.0, 4.0))
    }

    fn run(seen: &[Option<f64>]) -> Vec<State> {
        let mut lock = TrackStateMachine::default();
        seen.iter().enumerate().map(|(k, x)| lock.update(stamp(k), x.map(at).as_ref(), 0.1, 2)).collect()
    }

    #[test]
    fn the_second_agreeing_frame_confirms() {
        use State::{Searching, Tracking};
        assert_eq!(run(&[None, Some(0.0), Some(0.01), Some(0.02)]), [Searching, Searching, Tracking, Tracking]);
    }

    #[test]
    fn poses_that_disagree_never_confirm() {
        assert!(run(&[Some(0.0), Some(2.0), Some(-1.0), Some(1.5)]).iter().all(|s| *s == State::Searching));
    }

    #[test]
    fn an_isolated_find_is_forgotten() {
        assert!(run(&[Some(0.0), None, Some(0.0), None]).iter().all(|s| *s == State::Searching));
    }

    #[test]
    fn a_gap_coasts_then_is_lost_then_needs_confirmation() {
        use State::{Coasting, Lost, Searching, Tracking};
        let n = None;
        let s = Some(0.0);
        assert_eq!(run(&[s, s, n, n, n, n, s, s]), [Searching, Tracking, Coasting, Coasting, Coasting, Lost, Lost, Tracking]);
    }

    #[test]
    fn one_frame_resumes_a_coasting_track() {
        use State::{Coasting, Searching, Tracking};
        assert_eq!(run(&[Some(0.0), Some(0.0), None, Some(0.0)]), [Searching, Tracking, Coasting, Tracking]);
    }

    #[test]
    fn an_unreported_pose_has_a_stated_doubt() {
        let mut lock = TrackStateMachine::default();
        let mut doubt = |k: usize, x: Option<f64>| {
            lock.update(stamp(k), x.map(at).as_ref(), 0.1, 2);
            lock.doubt()
        };
        assert_eq!([doubt(0, Some(0.0)), doubt(1, Some(0.0)), doubt(2, None)], [Some(Doubt::First), None, None]);
        assert_eq!(doubt(3, Some(3.0)), Some(Doubt::Disagrees));
    }

    #[test]
    fn a_withheld_body_is_lost_and_needs_confirmation() {
        let mut lock = TrackStateMachine::default();
        assert_eq!(lock.withhold(), State::Searching);
        let states: Vec<State> = (0..2).map(|k| lock.update(stamp(k), Some(&at(0.0)), 0.1, 2)).collect();
        assert_eq!(states[1], State::Tracking);
        assert_eq!(lock.withhold(), State::Lost);
        assert_eq!([3, 4].map(|k| lock.update(stamp(k), Some(&at(0.0)), 0.1, 2)), [State::Lost, State::Tracking]);
    }

    #[test]
    fn a_jump_while_tracking_is_not_reported() {
        use State::{Coasting, Searching, Tracking};
        assert_eq!(run(&[Some(0.0), Some(0.0), Some(3.0), Some(0.0)]), [Searching, Tracking, Coasting, Tracking]);
    }

    /// Returns the states for conclusive frames at a rate, and whether each pose was doubted as a
    /// jump.
    fn sure(per_s: f64, seen: impl IntoIterator<Item = Option<f64>>) -> Vec<(State, bool)> {
        let mut lock = TrackStateMachine::default();
        let states = seen.into_iter().enumerate().map(|(k, x)| {
            let state = lock.update(Timestamp::from_ns((k as f64 * 1e9 / per_s) as i64), x.map(at).as_ref(), 0.2, 1);
            (state, lock.doubt() == Some(Doubt::Disagrees))
        });
        states.collect()
    }

    #[test]
    fn a_copy_is_not_adopted_but_a_lasting_cut_is() {
        let reported = |states: &[(State, bool)]| states.iter().filter(|(state, _)| *state == State::Tracking).count();
        // A pan to a copy 4 m aside for two seconds, with gaps, and back.
        let mut seen = vec![Some(0.0); 10];
        seen.extend((0..60).map(|k| (k % 7 != 3).then_some(4.0)));
        let states = sure(30.0, seen.clone().into_iter().chain([Some(0.1); 3]));
        assert_eq!((reported(&states[10..70]), reported(&states[70..])), (0, 3));
        assert!(states[10].1 && states[68].1);
        // A cut is accepted eventually.
        let states = sure(30.0, [Some(0.0); 10].into_iter().chain([Some(4.0); 120]));
        assert_eq!(states.iter().skip(10).position(|(state, _)| *state == State::Tracking), Some(90));
        assert!(states[100..].iter().all(|(state, _)| *state == State::Tracking));
    }

    #[test]
    fn quick_motion_is_not_a_jump_at_any_frame_rate() {
        for per_s in [5.0, 30.0, 240.0] {
            // 8 m/s at 4 m.
            let states = sure(per_s, (0..20).map(|k| Some(8.0 / per_s * f64::from(k))));
            assert!(states.iter().all(|(state, _)| *state == State::Tracking), "{per_s}: {states:?}");
        }
        // Hidden for a second, and carried 3 m meanwhile.
        let hidden = [Some(0.0); 5].into_iter().chain([None; 30]).chain([Some(3.0); 2]);
        assert_eq!(sure(30.0, hidden)[35..], [(State::Tracking, false); 2]);
    }

    /// A copy that hides the stage stands 0.9 m in front of it. It is found a tenth of a second
    /// after the stage was last seen: a speed that a camera may have, but cannot reach that soon.
    #[test]
    fn a_copy_needing_impossible_acceleration_is_rejected() {
        let seen = || [Some(0.0), Some(0.01), Some(0.02), None, None].into_iter().chain([Some(0.92); 20]);
        let run = |mut lock: TrackStateMachine| {
            let states = seen().enumerate().map(|(k, x)| lock.update(stamp(k), x.map(at).as_ref(), 0.2, 1));
            states.skip(5).filter(|state| *state == State::Tracking).count()
        };
        assert_eq!([run(TrackStateMachine::of_camera()), run(TrackStateMachine::default())], [0, 20]);
    }

    /// At any rate: from rest to 5 m/s within a fifth of a second, and a stop within a tenth.
    #[test]
    fn a_camera_that_starts_and_stops_is_not_a_jump() {
        for per_s in [12.0, 30.0, 120.0] {
            let mut lock = TrackStateMachine::of_camera();
            for k in 0..60 {
                let t = k as f64 / per_s;
                let stopping = (t - 0.4).clamp(0.0, 0.1);
                let x = if t < 0.2 { 12.5 * t * t } else { 0.5 + 5.0 * (t.min(0.4) - 0.2) + 5.0 * stopping - 25.0 * stopping.powi(2) };
                let state = lock.update(Timestamp::from_ns((t * 1e9) as i64), Some(&at(x)), 0.2, 1);
                assert_eq!(state, State::Tracking, "{per_s} a second, frame {k}");
            }
        }
    }

    /// A prop that spins on the spot: relative to it the camera flies around it, but it stays in
    /// place before the camera.
    #[test]
    fn a_spinning_prop_is_not_a_jump() {
        let mut lock = TrackStateMachine::default();
        for k in 0..30 {
            let camera_body = Pose::new(UnitQuaternion::from_euler_angles(0.0, 0.6 * k as f64, 0.0), Vector3::new(0.0, 0.0, 2.0));
            assert_eq!(lock.update(stamp(k), Some(&camera_body.inverse()), 0.2, 1), State::Tracking, "{k}");
        }
    }
}
