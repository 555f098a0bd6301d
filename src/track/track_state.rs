//! The state of a body from frame to frame: searching, awaiting confirmation, tracking, coasting, lost.
//!
//! Decided by frame stamps alone, never by a clock, so that a replay gives what the show gave.

use serde::{Deserialize, Serialize};

use crate::frame::Timestamp;
use crate::geometry::{Body, Camera, Pose};

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
    /// It is far from the one before.
    Disagrees,
}

/// A verified pose that waits for others to agree with it.
#[derive(Debug, Clone, Copy)]
struct Pending {
    pose: Pose<Body, Camera>,
    timestamp: Timestamp,
    agreeing: u32,
}

/// The state machine of one body.
#[derive(Debug, Clone, Default)]
pub struct TrackStateMachine {
    state: State,
    found_before: bool,
    last_tracked: Timestamp,
    pending: Option<Pending>,
    doubt: Option<Doubt>,
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
const LONGEST_GAP_S: f64 = 0.5;

impl TrackStateMachine {
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

    /// Gives the body up at once: its poses are withheld, and none may be predicted from them.
    pub fn withhold(&mut self) -> State {
        let found_before = self.found_before;
        *self = Self { state: if found_before { State::Lost } else { State::Searching }, found_before, ..Self::default() };
        self.state
    }

    /// Takes the outcome of a frame. `coast_s` and `confirm_frames` are the tracker's settings.
    pub fn update(&mut self, timestamp: Timestamp, verified: Option<&Pose<Body, Camera>>, coast_s: f64, confirm_frames: u32) -> State {
        let continued = self.is_continued();
        self.doubt = None;
        match verified {
            Some(pose) => {
                let is_near = |p: &Pending| timestamp.seconds_since(p.timestamp) <= LONGEST_GAP_S;
                let disagrees = self.pending.as_ref().is_some_and(|p| is_near(p) && !agree(p, pose, timestamp));
                let agreeing = match &self.pending {
                    Some(p) if agree(p, pose, timestamp) => p.agreeing + 1,
                    _ => 1,
                };
                self.pending = Some(Pending { pose: *pose, timestamp, agreeing });
                // While coasting, the last tracked pose is the pending one, so one agreeing frame is enough.
                if agreeing >= confirm_frames {
                    self.found_before = true;
                    self.last_tracked = timestamp;
                    self.state = State::Tracking;
                    return self.state;
                }
                self.doubt = Some(if disagrees { Doubt::Disagrees } else { Doubt::First });
            }
            None => {
                let stale = |p: &Pending| timestamp.seconds_since(p.timestamp) > LONGEST_GAP_S;
                // A single verified frame must be followed by another at once; a track may skip frames while it coasts.
                if self.pending.as_ref().is_some_and(|p| stale(p) || (!continued && p.agreeing < confirm_frames)) {
                    self.pending = None;
                }
            }
        }
        let may_coast = continued && timestamp.seconds_since(self.last_tracked) <= coast_s;
        self.state = match (may_coast, self.found_before) {
            (true, _) => State::Coasting,
            (false, true) => State::Lost,
            (false, false) => State::Searching,
        };
        if self.state == State::Lost && verified.is_none() {
            self.pending = None;
        }
        self.state
    }
}

/// Whether the body could have moved from the pending pose to this one in the time between.
fn agree(pending: &Pending, pose: &Pose<Body, Camera>, timestamp: Timestamp) -> bool {
    let dt = timestamp.seconds_since(pending.timestamp);
    if !(0.0..=LONGEST_GAP_S).contains(&dt) {
        return false;
    }
    let distance = pose.translation.norm().min(pending.pose.translation.norm());
    // Of the camera's centre: turning it on the spot is no shift.
    let shift = (pose.translation - pending.pose.translation).norm();
    let turn = pose.angle_to(&pending.pose);
    shift < (SLACK_SHIFT + FASTEST_SHIFT_PER_S * dt) * distance && turn < SLACK_TURN + FASTEST_TURN_PER_S * dt
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
        assert_eq!(run(&[Some(0.0), Some(0.0), Some(3.0), Some(0.0)])[..3], [Searching, Tracking, Coasting]);
    }
}
