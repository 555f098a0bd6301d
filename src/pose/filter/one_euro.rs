//! The One-Euro filter (Casiez, Roussel and Vogel, CHI 2012) on SE(3): smooth at rest, fast in
//! motion.
//!
//! A first-order low-pass filter with cutoff f = min_cutoff + beta |velocity|. At rest it delays by
//! 1 / (2 pi min_cutoff), 159 ms at 1 Hz; in motion by less. Position and rotation have separate
//! filters; rotations are filtered along the rotation from the last one.

use crate::geometry::{Pose, Stage};
use crate::motion::Motion;

/// Settings of the One-Euro filter.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct OneEuroSettings {
    /// Cutoff at rest, Hz.
    pub min_cutoff_hz: f64,
    /// Increase of the cutoff: Hz per m/s, and per rad/s for the rotation.
    pub beta: f64,
}

impl Default for OneEuroSettings {
    fn default() -> Self {
        Self { min_cutoff_hz: 1.0, beta: 40.0 }
    }
}

/// Cutoff of the velocities' own low-pass filter, Hz, as in the paper (Casiez, Roussel and Vogel
/// 2012). Raised, noise raises the pose's cutoff; lowered, the pose lags when a motion starts.
const VELOCITY_CUTOFF_HZ: f64 = 1.0;

#[derive(Debug, Clone)]
pub(super) struct OneEuro<From> {
    settings: OneEuroSettings,
    pub motion: Motion<Stage, From>,
}

impl<From> OneEuro<From> {
    pub fn start(settings: OneEuroSettings, pose: &Pose<Stage, From>) -> Self {
        Self { settings, motion: Motion::still(*pose) }
    }

    pub fn update(&mut self, step_s: f64, pose: &Pose<Stage, From>) {
        let Motion { pose: last, velocity, angular_velocity, .. } = &mut self.motion;
        let [way, rotation] = last.step_to(pose);
        let share = share_of(VELOCITY_CUTOFF_HZ, step_s);
        *velocity += share * (way / step_s - *velocity);
        *angular_velocity += share * (rotation / step_s - *angular_velocity);
        let cutoff = |speed: f64| self.settings.min_cutoff_hz + self.settings.beta * speed;
        *last =
            last.moved(&(share_of(cutoff(velocity.norm()), step_s) * way), &(share_of(cutoff(angular_velocity.norm()), step_s) * rotation));
        last.rotation.renormalize();
    }
}

/// Weight of a new value in a low-pass filter: 1 / (1 + tau / dt) with tau = 1 / (2 pi cutoff).
fn share_of(cutoff_hz: f64, step_s: f64) -> f64 {
    let ratio = std::f64::consts::TAU * cutoff_hz * step_s;
    ratio / (ratio + 1.0)
}
