//! How far a body moved lately, and no prediction beyond it: a velocity is estimated, what was moved is measured.

use nalgebra::Vector3;

use super::recent::Recent;
use crate::geometry::Pose;

/// The poses that were measured lately.
#[derive(Debug, Clone)]
pub(super) struct Reach<To, From> {
    measured: Recent<Pose<To, From>>,
}

impl<To, From> Default for Reach<To, From> {
    fn default() -> Self {
        Self { measured: Recent::new() }
    }
}

impl<To, From> Reach<To, From> {
    pub fn push(&mut self, timestamp_ns: i64, measured: &Pose<To, From>) {
        self.measured.push(timestamp_ns, *measured);
    }

    pub fn clear(&mut self) {
        self.measured.clear();
    }

    /// How far the newest pose is from where the body was within the `seconds` before it, at most: metres and radians.
    pub fn moved(&self, seconds: f64) -> [f64; 2] {
        let mut recent = self.measured.within_last(seconds);
        let Some((_, now)) = recent.next() else { return [0.0; 2] };
        recent.fold([0.0; 2], |[way, turn], (_, then)| [way.max((now.translation - then.translation).norm()), turn.max(now.angle_to(then))])
    }
}

/// A vector, shortened to a length where it is longer.
pub(super) fn at_most(vector: Vector3<f64>, length: f64) -> Vector3<f64> {
    let norm = vector.norm();
    if norm > length { vector * (length / norm) } else { vector }
}
