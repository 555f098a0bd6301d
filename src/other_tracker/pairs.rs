//! Poses that two logs have of one instant.

use nalgebra::{UnitQuaternion, Vector3};

use crate::delay::log::LoggedPose;
use crate::frame::Timestamp;
use crate::geometry::{Body, Pose, Stage};

/// Maximum time between two rows of the second log that are interpolated, seconds. Chosen: six
/// frames at 60 per second. Raised, poses are made up across gaps.
const LONGEST_STEP_S: f64 = 0.1;

/// One instant in both logs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// The instant, on the first log's clock.
    pub at: Timestamp,
    /// The first log's pose.
    pub ours: Pose<Stage, Body>,
    /// The second log's, interpolated between its rows.
    pub others: Pose<Stage, Body>,
}

/// Pairs every row of the first log with the second log's pose `delay_s` later, where its rows are
/// near enough. Rows whose stamps do not follow are left out.
pub fn pairs(ours: &[LoggedPose], others: &[LoggedPose], delay_s: f64) -> Vec<Pair> {
    let others = rising(others);
    let pair = |row: &LoggedPose| {
        let at = row.at.after_s(delay_s);
        let after = others.partition_point(|other| other.at < at);
        let (before, next) = (others.get(after.checked_sub(1)?)?, others.get(after)?);
        let step_s = next.at.seconds_since(before.at);
        (step_s <= LONGEST_STEP_S).then(|| {
            let share = at.seconds_since(before.at) / step_s;
            Pair { at: row.at, ours: pose(row.rotation, row.position), others: between(before, next, share) }
        })
    };
    rising(ours).iter().filter_map(pair).collect()
}

fn pose(rotation: UnitQuaternion<f64>, position: Vector3<f64>) -> Pose<Stage, Body> {
    Pose::new(rotation, position)
}

fn between(a: &LoggedPose, b: &LoggedPose, share: f64) -> Pose<Stage, Body> {
    let rotation = a.rotation * UnitQuaternion::from_scaled_axis((a.rotation.inverse() * b.rotation).scaled_axis() * share);
    pose(rotation, a.position + (b.position - a.position) * share)
}

fn rising(rows: &[LoggedPose]) -> Vec<LoggedPose> {
    let mut last = None;
    let follows = |row: &&LoggedPose| last.replace(row.at).is_none_or(|last| row.at > last);
    rows.iter().filter(follows).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::moving;
    use super::*;

    #[test]
    fn poses_are_those_of_one_instant() {
        let at = |k: i32, hz: f64, late_s: f64| {
            let t = f64::from(k) / hz;
            let pose = moving(t);
            LoggedPose { at: Timestamp::from_seconds(t + late_s), rotation: pose.rotation, position: pose.translation }
        };
        let ours: Vec<LoggedPose> = (0..60).map(|k| at(k, 30.0, 0.0)).collect();
        let mut others: Vec<LoggedPose> = (0..100).map(|k| at(k, 50.0, 0.04)).collect();
        // A gap, and a row from before.
        others.drain(50..60);
        others.insert(20, others[3]);
        let pairs = pairs(&ours, &others, 0.04);
        assert!(pairs.len() > 45 && pairs.len() < 60, "{}", pairs.len());
        assert!(pairs.iter().all(|pair| (pair.ours.translation - pair.others.translation).norm() < 2e-4));
        assert!(pairs.iter().all(|pair| !(0.99..1.19).contains(&pair.at.seconds())), "nothing is made up in the gap");
    }
}
