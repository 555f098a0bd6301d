//! How far a body moved lately, and no prediction beyond it: a velocity is estimated, what was moved is measured.
//! A way in a direction that the body has not come in is not supported at all.

use nalgebra::Vector3;

use super::recent::Recent;
use crate::frame::Timestamp;
use crate::geometry::Pose;

/// The poses that were measured lately.
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
    /// Takes a measured pose.
    pub fn push(&mut self, timestamp: Timestamp, measured: &Pose<To, From>) {
        self.measured.push(timestamp, *measured);
    }

    /// Forgets all: what comes next is no continuation.
    pub fn clear(&mut self) {
        self.measured.clear();
    }

    /// Shortens the ways that velocities, m/s and rad/s, lead within some seconds to what the body moved in their direction in as long
    /// before. Where it was not seen for so long yet, it is taken to have gone on before as it does since.
    pub fn carries(&self, velocities: [Vector3<f64>; 2], seconds: f64) -> [Vector3<f64>; 2] {
        let mut stamps = self.measured.within_last(seconds).map(|(at, _)| *at);
        let (newest, oldest) = (stamps.next().unwrap_or_default(), stamps.last());
        let seen_s = oldest.map_or(seconds, |oldest| newest.seconds_since(oldest)).clamp(1e-3, seconds);
        self.supports(velocities.map(|velocity| velocity * seconds), seconds / seen_s, seconds)
    }

    /// Shortens ways ahead, metres and radians, to `times` as far as the body moved in their direction within the last `seconds`.
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
