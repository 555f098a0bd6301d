//! Another tracker beside ours while both run: the last minute of both, compared as
//! `compare-poses` compares two logs.

use std::collections::VecDeque;

use super::align::{Alignment, Unalignable, aligned};
use super::differences::{Differences, judged};
use super::pairs::pairs;
use crate::calibrate::judge::Verdict;
use crate::delay::log::LoggedPose;
use crate::delay::{Turns, measure_delay};

/// How long poses are kept, seconds. Chosen: long enough for a motion that determines the
/// alignment. Raised, a change of the rig is noticed later.
const WINDOW_S: f64 = 60.0;
/// Minimum time between two kept poses, seconds. Chosen: 100 per second show every motion of a
/// camera. Lowered, comparing takes longer.
const MIN_STEP_S: f64 = 0.009;
/// Largest delay that is looked for, seconds. Chosen: beyond what networks and trackers add.
/// Raised, comparing takes longer, and repeated motions are confused.
const MAX_DELAY_S: f64 = 1.0;

/// The last poses of both trackers.
#[derive(Debug, Clone, Default)]
pub struct Beside {
    ours: VecDeque<LoggedPose>,
    others: VecDeque<LoggedPose>,
}

/// How the two differ over the last minute.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// How much later the other's packets arrive than our stamps, seconds, and its sigma; `None` if
    /// the cameras hardly turned, and then it is taken as 0.
    pub delay_s: Option<[f64; 2]>,
    /// What leads from the other's poses to ours.
    pub alignment: Alignment,
    /// What remains.
    pub differences: Differences,
    /// How far they agree.
    pub verdict: Verdict,
    /// Why.
    pub reasons: Vec<String>,
}

impl Beside {
    /// Adds a pose of ours.
    pub fn add_ours(&mut self, row: LoggedPose) {
        add(&mut self.ours, row);
    }

    /// Adds a pose of the other tracker, on the same clock.
    pub fn add_others(&mut self, row: LoggedPose) {
        add(&mut self.others, row);
    }

    /// Compares them.
    ///
    /// # Errors
    /// When there are too few poses of one time, or too little motion.
    pub fn compare(&self) -> Result<Comparison, Unalignable> {
        let [ours, others] = [&self.ours, &self.others].map(|rows| rows.iter().copied().collect::<Vec<_>>());
        let Some(first) = ours.first() else { return Err(Unalignable::Few(0)) };
        let turns = |rows: &[LoggedPose]| Turns::of_orientations(first.at, rows.iter().map(|row| (row.at, row.rotation)));
        let delay = measure_delay(&turns(&ours), &turns(&others), MAX_DELAY_S).ok().map(|delay| [delay.delay_s, delay.sigma_s]);
        let pairs = pairs(&ours, &others, delay.map_or(0.0, |[delay_s, _]| delay_s));
        let alignment = aligned(&pairs)?;
        let differences = Differences::of(&pairs, &alignment);
        let (verdict, reasons) = judged(&differences);
        Ok(Comparison { delay_s: delay, alignment, differences, verdict, reasons })
    }
}

/// Adds a row, and removes those that are too old. A stamp that jumped back begins anew.
fn add(rows: &mut VecDeque<LoggedPose>, row: LoggedPose) {
    if let Some(step_s) = rows.back().map(|last| row.at.seconds_since(last.at)) {
        if step_s < 0.0 {
            rows.clear();
        } else if step_s < MIN_STEP_S {
            return;
        }
    }
    rows.push_back(row);
    while rows.front().is_some_and(|first| row.at.seconds_since(first.at) > WINDOW_S) {
        rows.pop_front();
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::super::synthetic::moving;
    use super::*;
    use crate::frame::Timestamp;
    use crate::geometry::{Body, Pose, Stage};

    const LATE_S: f64 = 0.06;

    /// The rig for a time: ours at 30 poses a second, the other at 50, in other axes, late.
    fn beside(seconds: f64, scale: f64) -> Beside {
        let mut beside = Beside::default();
        let world: Pose<Stage, Stage> = Pose::new(UnitQuaternion::from_euler_angles(0.1, -0.4, 2.0), Vector3::new(3.0, -1.0, 0.5));
        let sensor: Pose<Body, Body> = Pose::new(UnitQuaternion::from_euler_angles(1.5, 0.2, -0.3), Vector3::new(0.1, 0.05, -0.2));
        let row = |t: f64, pose: Pose<Stage, Body>| LoggedPose {
            at: Timestamp::from_seconds(50.0 + t),
            rotation: pose.rotation,
            position: pose.translation,
        };
        for k in 0..(seconds * 30.0) as i32 {
            let t = f64::from(k) / 30.0;
            beside.add_ours(row(t, moving(t)));
        }
        for k in 0..(seconds * 50.0) as i32 {
            let t = f64::from(k) / 50.0;
            let ours = moving(t);
            let scaled = Pose::new(ours.rotation, ours.translation * scale);
            beside.add_others(row(t + LATE_S, world * scaled * sensor));
        }
        beside
    }

    #[test]
    fn the_delay_and_both_rigid_transforms_are_no_difference() {
        let found = beside(90.0, 1.0).compare().unwrap();
        let [delay_s, _] = found.delay_s.unwrap();
        assert!((delay_s - LATE_S).abs() < 2e-3, "{delay_s}");
        assert!(found.verdict == Verdict::Good && found.differences.distance_m.rms < 2e-3, "{:?}", found.differences);
        // A minute at 30 per second, less the end.
        assert!((1700..=1801).contains(&found.differences.pairs), "{}", found.differences.pairs);
    }

    #[test]
    fn another_metre_is_a_difference() {
        let found = beside(30.0, 1.03).compare().unwrap();
        assert!(found.verdict == Verdict::DoNotUse && found.reasons[0].contains("metre"), "{:?}", found.reasons);
    }

    #[test]
    fn one_tracker_alone_and_a_still_rig_are_refused() {
        assert_eq!(Beside::default().compare(), Err(Unalignable::Few(0)));
        let mut alone = beside(10.0, 1.0);
        alone.others.clear();
        assert_eq!(alone.compare(), Err(Unalignable::Few(0)));
        let mut still = beside(10.0, 1.0);
        let first = still.ours[0];
        still.ours.iter_mut().for_each(|row| (row.rotation, row.position) = (first.rotation, first.position));
        assert!(matches!(still.compare(), Err(Unalignable::Still(..))));
    }

    #[test]
    fn a_clock_that_jumps_back_begins_anew() {
        let mut beside = beside(10.0, 1.0);
        let first = beside.ours[0];
        beside.add_ours(first);
        assert_eq!(beside.ours.len(), 1);
    }
}
