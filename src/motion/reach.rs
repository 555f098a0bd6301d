//! Limits predictions to how far a body moved recently: velocities are estimated, but past motion
//! is measured. Motion in a direction in which the body has not moved is not supported at all.

use nalgebra::Vector3;

use super::recent::Recent;
use crate::frame::Timestamp;
use crate::geometry::Pose;

/// Recently measured poses.
#[derive(Debug, Clone)]
pub struct Reach<To, From> {
    measured: Recent<Pose<To, From>>,
}

impl<To, From> Default for Reach<To, From> {
    fn default() -> Self {
        Self { measured: Recent::new() }
    }
}

impl<To, From> Reach<To, From> {
    /// Adds a measured pose.
    pub fn push(&mut self, timestamp: Timestamp, measured: &Pose<To, From>) {
        self.measured.push(timestamp, *measured);
    }

    /// Forgets everything: the next measurement is not a continuation.
    pub fn clear(&mut self) {
        self.measured.clear();
    }

    /// Limits the displacements that velocities, m/s and rad/s, cause within some seconds to what
    /// the body moved in their direction in the same time before. If it was observed for less time,
    /// it is assumed to have moved before as it did since.
    pub fn carries(&self, velocities: [Vector3<f64>; 2], seconds: f64) -> [Vector3<f64>; 2] {
        let mut stamps = self.measured.within_last(seconds).map(|(at, _)| *at);
        let (newest, oldest) = (stamps.next().unwrap_or_default(), stamps.last());
        let seen_s = oldest.map_or(seconds, |oldest| newest.seconds_since(oldest)).clamp(1e-3, seconds);
        self.supports(velocities.map(|velocity| velocity * seconds), seconds / seen_s, seconds)
    }

    /// Limits displacements ahead, metres and radians, to `times` what the body moved in their
    /// direction within the last `seconds`.
    pub fn supports(&self, ways: [Vector3<f64>; 2], times: f64, seconds: f64) -> [Vector3<f64>; 2] {
        let lengths = ways.map(|way| way.norm());
        let mut moved = [0.0f64; 2];
        let mut recent = self.measured.within_last(seconds);
        if let Some((_, now)) = recent.next() {
            for (_, then) in recent {
                let since = then.step_to(now);
                for part in 0..2 {
                    moved[part] = moved[part].max(since[part].dot(&ways[part]) / lengths[part]);
                }
            }
        }
        [0, 1].map(|part| if lengths[part] > times * moved[part] { ways[part] * (times * moved[part] / lengths[part]) } else { ways[part] })
    }
}
