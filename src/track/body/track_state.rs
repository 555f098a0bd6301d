//! The state of a body from frame to frame: searching, awaiting confirmation, tracking, coasting, lost.
//!
//! Decided by frame stamps alone, never by a clock, so that a replay gives what the show gave.

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
    /// Was found before, is not now.
    Lost,
    /// Live only: the camera gives no pictures. Such a sample is a message to subscribers, never a line of contract C3.
    Stale,
}

impl State {
    /// All states, in the order of their numbers.
    pub const ALL: [State; 5] = [Self::Searching, Self::Tracking, Self::Coasting, Self::Lost, Self::Stale];

    /// The word for it in the records.
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

/// Why a verified pose is not given yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Doubt {
    /// It is the first of its kind.
    First,
    /// It is far from the one before, or from where the body can have come since its last pose was
    /// given.
    Disagrees,
}

/// A verified pose that waits for others to agree with it.
#[derive(Debug, Clone, Copy)]
struct Pending {
    pose: Pose<Body, Camera>,
    timestamp: Timestamp,
    agreeing: u32,
    /// When the first of these poses came, if the body cannot have come there since its last given
    /// pose.
    jumped: Option<Timestamp>,
}

/// The state machine of one body.
#[derive(Debug, Clone, Default)]
pub struct TrackStateMachine {
    state: State,
    found_before: bool,
    last_given: Option<Pending>,
    pending: Option<Pending>,
    doubt: Option<Doubt>,
    /// Velocity between the last two given poses, m/s: of the camera in the body, and of the body in
    /// the camera.
    velocities: Option<[Vector3<f64>; 2]>,
    /// See [`of_camera`](Self::of_camera).
    is_of_camera: bool,
}

/// How fast a body may plausibly move between two frames that confirm each other: metres per second relative to its distance, and radians
/// per second. At 4 m, 12 m/s and two turns a second: more than a whip pan. Chosen, not tuned. Raised, two wrong poses may confirm each
/// other; lowered, a camera that is found in fast motion is given later.
const FASTEST_SHIFT_PER_S: f64 = 3.0;
const FASTEST_TURN_PER_S: f64 = 12.0;
/// Slack for measurement noise and jitter of stamps: of the distance, and radians. Chosen: about twice the largest uncertainty of a pose
/// that is given (`verify`). Raised, two wrong poses may confirm each other.
const SLACK_SHIFT: f64 = 0.02;
const SLACK_TURN: f64 = 0.02;
/// Frames further apart than this do not confirm each other, seconds. Chosen, not tuned: within more, the camera could be anywhere. Raised,
/// two wrong poses have longer to agree; lowered, cameras of 2 frames a second are never tracked.
const MAX_GAP_S: f64 = 0.5;
/// Fastest motion since the last given pose, m/s, where that is more than `FASTEST_SHIFT_PER_S`: a
/// thrown prop. Raised, nearer copies pass for a motion.
const FASTEST_M_PER_S: f64 = 10.0;
/// Poses must agree for so long, seconds, where the body cannot have come there: a cut, or a wrong
/// pose before. Raised, a cut costs more; lowered, a pan to a copy is believed sooner.
const JUMP_CONFIRMED_S: f64 = 3.0;

impl TrackStateMachine {
    /// Of a stage: what moves is the camera, which is not thrown and does not bounce.
    pub fn of_camera() -> Self {
        Self { is_of_camera: true, ..Self::default() }
    }

    /// The state after the last frame.
    pub fn state(&self) -> State {
        self.state
    }

    /// Whether a pose of the body was given in any frame.
    pub fn was_given(&self) -> bool {
        self.found_before
    }

    /// Whether a pose in the next frame would continue a track.
    pub fn is_continued(&self) -> bool {
        matches!(self.state, State::Tracking | State::Coasting)
    }

    /// Why the last frame's verified pose was not given; `None` where it was, or where there was none.
    pub fn doubt(&self) -> Option<Doubt> {
        self.doubt
    }

    /// Whether the body can have come to a pose since its last given one; true where none was
    /// given.
    pub fn may_have_come(&self, pose: &Pose<Body, Camera>, timestamp: Timestamp) -> bool {
        let velocities = self.velocities.filter(|_| self.is_of_camera);
        self.last_given.is_none_or(|last| is_reachable(&last.pose, pose, timestamp.seconds_since(last.timestamp), velocities))
    }

    /// Whether a pose in this frame needs nothing but to be seen: it goes on with a track.
    pub fn continues_at(&self, pose: &Pose<Body, Camera>, timestamp: Timestamp) -> bool {
        self.is_continued() && self.may_have_come(pose, timestamp)
    }

    /// Gives the body up at once: its poses are withheld, and none may be predicted from them.
    pub fn withhold(&mut self) -> State {
        let found_before = self.found_before;
        let state = if found_before { State::Lost } else { State::Searching };
        *self = Self { state, found_before, is_of_camera: self.is_of_camera, ..Self::default() };
        self.state
    }

    /// Takes the outcome of a frame. `coast_s` and `confirm_frames` are the tracker's settings; a
    /// frame that leaves no doubt needs one to confirm it.
    pub fn update(&mut self, timestamp: Timestamp, verified: Option<&Pose<Body, Camera>>, coast_s: f64, confirm_frames: u32) -> State {
        let continued = self.is_continued();
        self.doubt = None;
        if let Some(pose) = verified {
            let pending = self.taken_up(pose, timestamp);
            let disagrees =
                pending.agreeing == 1 && self.pending.as_ref().is_some_and(|before| timestamp.seconds_since(before.timestamp) <= MAX_GAP_S);
            self.pending = Some(pending);
            let is_confirmed = match pending.jumped {
                None => pending.agreeing >= confirm_frames,
                Some(since) => timestamp.seconds_since(since) >= JUMP_CONFIRMED_S,
            };
            if is_confirmed {
                self.found_before = true;
                self.velocities = self.last_given.filter(|_| pending.jumped.is_none()).and_then(|last| velocities(&last, &pending));
                self.last_given = Some(Pending { jumped: None, ..pending });
                self.pending = self.last_given;
                self.state = State::Tracking;
                return self.state;
            }
            self.doubt = Some(if disagrees || pending.jumped.is_some() { Doubt::Disagrees } else { Doubt::First });
        }
        let may_coast = continued && self.last_given.is_some_and(|last| timestamp.seconds_since(last.timestamp) <= coast_s);
        self.state = match (may_coast, self.found_before) {
            (true, _) => State::Coasting,
            (false, true) => State::Lost,
            (false, false) => State::Searching,
        };
        if verified.is_none() {
            let is_stale = |p: &Pending| timestamp.seconds_since(p.timestamp) > MAX_GAP_S;
            // A single verified frame must be followed by another at once; a track may skip frames
            // while it coasts, and so may what jumped.
            self.pending = self.pending.filter(|p| !is_stale(p) && (self.is_continued() || p.jumped.is_some()));
        }
        self.state
    }

    /// A verified pose beside those that wait.
    fn taken_up(&self, pose: &Pose<Body, Camera>, timestamp: Timestamp) -> Pending {
        let fresh = |jumped| Pending { pose: *pose, timestamp, agreeing: 1, jumped };
        // While coasting, one frame that agrees with the last given one is enough, whatever was
        // seen meanwhile.
        let given = self.last_given.filter(|_| self.is_continued());
        let jumped = || (!self.may_have_come(pose, timestamp)).then_some(timestamp);
        match [self.pending, given].into_iter().flatten().find(|before| agree(before, pose, timestamp)) {
            // The way from a copy of the picture to itself is no way from the last given pose.
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
    if !(0.0..=MAX_GAP_S).contains(&dt) {
        return false;
    }
    let distance = nearest_m(&pending.pose, pose);
    // Of the camera's centre: turning it on the spot is no shift.
    let shift = (pose.translation - pending.pose.translation).norm();
    let turn = pose.angle_to(&pending.pose);
    shift < (SLACK_SHIFT + FASTEST_SHIFT_PER_S * dt) * distance && turn < SLACK_TURN + FASTEST_TURN_PER_S * dt
}

/// Whether a body can have moved from one pose to another within some seconds, as nothing on a
/// stage moves faster. Turns do not count: a copy lies elsewhere, and what only turns is the same
/// picture, tilted.
fn is_reachable(from: &Pose<Body, Camera>, to: &Pose<Body, Camera>, dt_s: f64, velocities: Option<[Vector3<f64>; 2]>) -> bool {
    let (distance, dt_s) = (nearest_m(from, to), dt_s.max(0.0));
    let slack = SLACK_SHIFT * distance;
    let reach = slack + (FASTEST_SHIFT_PER_S * distance).max(FASTEST_M_PER_S) * dt_s;
    let of_way = slack + 0.5 * MAX_ACCELERATION * dt_s * dt_s;
    // A camera that turns on the spot stays where it is in the body, and a prop that does stays
    // where it is before the camera.
    ways(from, to)
        .into_iter()
        .enumerate()
        .any(|(k, way)| way.norm() < reach && velocities.is_none_or(|velocities| (way - velocities[k] * dt_s).norm() < of_way))
}

/// Of the camera in the body, and of the body in the camera.
fn ways(from: &Pose<Body, Camera>, to: &Pose<Body, Camera>) -> [Vector3<f64>; 2] {
    [to.translation - from.translation, to.inverse().translation - from.inverse().translation]
}

fn velocities(from: &Pending, to: &Pending) -> Option<[Vector3<f64>; 2]> {
    let dt_s = to.timestamp.seconds_since(from.timestamp);
    (dt_s > 0.0 && dt_s <= MAX_GAP_S).then(|| ways(&from.pose, &to.pose).map(|way| way / dt_s))
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
    fn a_pose_that_is_not_given_has_its_doubt() {
        let mut lock = TrackStateMachine::default();
        let mut doubt = |k: usize, x: Option<f64>| {
            lock.update(stamp(k), x.map(at).as_ref(), 0.1, 2);
            lock.doubt()
        };
        assert_eq!([doubt(0, Some(0.0)), doubt(1, Some(0.0)), doubt(2, None)], [Some(Doubt::First), None, None]);
        assert_eq!(doubt(3, Some(3.0)), Some(Doubt::Disagrees));
    }

    #[test]
    fn a_body_that_is_withheld_does_not_coast_and_needs_confirmation() {
        let mut lock = TrackStateMachine::default();
        assert_eq!(lock.withhold(), State::Searching);
        let states: Vec<State> = (0..2).map(|k| lock.update(stamp(k), Some(&at(0.0)), 0.1, 2)).collect();
        assert_eq!(states[1], State::Tracking);
        assert_eq!(lock.withhold(), State::Lost);
        assert_eq!([3, 4].map(|k| lock.update(stamp(k), Some(&at(0.0)), 0.1, 2)), [State::Lost, State::Tracking]);
    }

    #[test]
    fn a_jump_while_tracking_is_not_given() {
        use State::{Coasting, Searching, Tracking};
        assert_eq!(run(&[Some(0.0), Some(0.0), Some(3.0), Some(0.0)]), [Searching, Tracking, Coasting, Tracking]);
    }

    /// Frames that leave no doubt, at a rate; the states, and whether each was doubted as a jump.
    fn sure(per_s: f64, seen: impl IntoIterator<Item = Option<f64>>) -> Vec<(State, bool)> {
        let mut lock = TrackStateMachine::default();
        let states = seen.into_iter().enumerate().map(|(k, x)| {
            let state = lock.update(Timestamp::from_ns((k as f64 * 1e9 / per_s) as i64), x.map(at).as_ref(), 0.2, 1);
            (state, lock.doubt() == Some(Doubt::Disagrees))
        });
        states.collect()
    }

    #[test]
    fn a_copy_is_not_the_body_however_long_it_is_seen_without_the_body() {
        let given = |states: &[(State, bool)]| states.iter().filter(|(state, _)| *state == State::Tracking).count();
        // A pan to a copy 4 m aside, for two seconds, with gaps, and back.
        let mut seen = vec![Some(0.0); 10];
        seen.extend((0..60).map(|k| (k % 7 != 3).then_some(4.0)));
        let states = sure(30.0, seen.clone().into_iter().chain([Some(0.1); 3]));
        assert_eq!((given(&states[10..70]), given(&states[70..])), (0, 3));
        assert!(states[10].1 && states[68].1);
        // A cut is believed in the end.
        let states = sure(30.0, [Some(0.0); 10].into_iter().chain([Some(4.0); 120]));
        assert_eq!(states.iter().skip(10).position(|(state, _)| *state == State::Tracking), Some(90));
        assert!(states[100..].iter().all(|(state, _)| *state == State::Tracking));
    }

    #[test]
    fn quick_motion_is_no_jump_at_any_rate() {
        for per_s in [5.0, 30.0, 240.0] {
            // 8 m/s at 4 m.
            let states = sure(per_s, (0..20).map(|k| Some(8.0 / per_s * f64::from(k))));
            assert!(states.iter().all(|(state, _)| *state == State::Tracking), "{per_s}: {states:?}");
        }
        // Hidden for a second, and carried 3 m meanwhile.
        let hidden = [Some(0.0); 5].into_iter().chain([None; 30]).chain([Some(3.0); 2]);
        assert_eq!(sure(30.0, hidden)[35..], [(State::Tracking, false); 2]);
    }

    /// A copy that hides the stage stands before it, 0.9 m nearer: found a tenth of a second after
    /// the stage was last seen, at a speed that a camera may well have, but not that soon.
    #[test]
    fn a_copy_is_no_motion_that_a_camera_cannot_begin() {
        let seen = || [Some(0.0), Some(0.01), Some(0.02), None, None].into_iter().chain([Some(0.92); 20]);
        let run = |mut lock: TrackStateMachine| {
            let states = seen().enumerate().map(|(k, x)| lock.update(stamp(k), x.map(at).as_ref(), 0.2, 1));
            states.skip(5).filter(|state| *state == State::Tracking).count()
        };
        assert_eq!([run(TrackStateMachine::of_camera()), run(TrackStateMachine::default())], [0, 20]);
    }

    /// At any rate: from rest to 5 m/s within a fifth of a second, and a stop within a tenth.
    #[test]
    fn a_camera_that_starts_and_stops_is_no_jump() {
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

    /// A prop that spins on the spot: the camera flies about it, and it stays where it is.
    #[test]
    fn a_spun_prop_is_no_jump() {
        let mut lock = TrackStateMachine::default();
        for k in 0..30 {
            let camera_body = Pose::new(UnitQuaternion::from_euler_angles(0.0, 0.6 * k as f64, 0.0), Vector3::new(0.0, 0.0, 2.0));
            assert_eq!(lock.update(stamp(k), Some(&camera_body.inverse()), 0.2, 1), State::Tracking, "{k}");
        }
    }
}
