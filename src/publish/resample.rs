//! The pose of any instant, from the samples around it: interpolated between two, or carried on for a moment after the last.
//!
//! A fixed-rate output asks for the pose of its own ticks. Nothing is made up across a loss: the samples before it are forgotten.

use std::collections::VecDeque;

use nalgebra::UnitQuaternion;

use crate::geometry::{Body, Pose, Stage};

/// Samples kept: enough for a delay of half a second at 120 Hz.
const KEPT: usize = 64;
/// Samples further apart have nothing between them, nanoseconds.
const LONGEST_GAP_NS: i64 = 250_000_000;
/// The motion is carried on for at most this long after the last sample, nanoseconds.
const LONGEST_REACH_NS: i64 = 100_000_000;

/// The samples of one body since its last loss.
#[derive(Debug, Clone, Default)]
pub(super) struct Resampler {
    samples: VecDeque<(i64, Pose<Stage, Body>)>,
}

impl Resampler {
    /// Takes a sample; stamps that do not rise are passed over.
    pub fn push(&mut self, at_ns: i64, pose: Pose<Stage, Body>) {
        match self.samples.back() {
            Some((last_ns, _)) if *last_ns >= at_ns => return,
            Some((last_ns, _)) if at_ns - *last_ns > LONGEST_GAP_NS => self.samples.clear(),
            _ => {}
        }
        if self.samples.len() == KEPT {
            self.samples.pop_front();
        }
        self.samples.push_back((at_ns, pose));
    }

    /// A loss: what comes next is no continuation.
    pub fn reset(&mut self) {
        self.samples.clear();
    }

    /// The pose at an instant; none before the first sample and long after the last.
    pub fn at(&self, at_ns: i64) -> Option<Pose<Stage, Body>> {
        let after = self.samples.partition_point(|(ns, _)| *ns < at_ns);
        if let Some((ns, pose)) = self.samples.get(after) {
            if *ns == at_ns {
                return Some(*pose);
            }
            return Some(between(self.samples.get(after.checked_sub(1)?)?, &(*ns, *pose), at_ns));
        }
        let newest = self.samples.back()?;
        if at_ns - newest.0 > LONGEST_REACH_NS {
            return None;
        }
        match self.samples.len() {
            1 => Some(newest.1),
            n => Some(between(&self.samples[n - 2], newest, at_ns)),
        }
    }
}

/// On the screw-free line through two poses: positions linear, rotations at constant rate; beyond the second it goes on.
fn between(a: &(i64, Pose<Stage, Body>), b: &(i64, Pose<Stage, Body>), at_ns: i64) -> Pose<Stage, Body> {
    let share = (at_ns - a.0) as f64 / (b.0 - a.0) as f64;
    let turn = (b.1.rotation * a.1.rotation.inverse()).scaled_axis() * share;
    Pose::new(UnitQuaternion::from_scaled_axis(turn) * a.1.rotation, a.1.translation + (b.1.translation - a.1.translation) * share)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    const MS: i64 = 1_000_000;

    fn moving(ms: i64) -> Pose<Stage, Body> {
        let s = ms as f64 * 1e-3;
        Pose::new(UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.5 * s), Vector3::new(s, 0.0, 0.0))
    }

    #[test]
    fn uniform_motion_is_met_between_and_after_samples() {
        let mut r = Resampler::default();
        for ms in [0, 33, 67, 100] {
            r.push(ms * MS, moving(ms));
        }
        for ms in [0, 1, 33, 50, 99, 100, 120, 199] {
            let (found, wanted) = (r.at(ms * MS).unwrap(), moving(ms));
            assert!((found.translation - wanted.translation).norm() < 1e-9 && found.angle_to(&wanted) < 1e-9, "{ms}");
        }
        assert!(r.at(-1).is_none() && r.at(201 * MS).is_none());
    }

    #[test]
    fn nothing_is_made_up_across_a_loss_or_a_gap() {
        let mut r = Resampler::default();
        r.push(0, moving(0));
        r.push(33 * MS, moving(33));
        r.reset();
        assert!(r.at(40 * MS).is_none());
        r.push(66 * MS, moving(500));
        assert!(r.at(50 * MS).is_none());
        assert_eq!(r.at(80 * MS), Some(moving(500)));
        r.push(400 * MS, moving(400));
        assert!(r.at(200 * MS).is_none());
    }
}
