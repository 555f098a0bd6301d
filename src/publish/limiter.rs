//! The safety limits of one body on one output: which poses may be sent, and how the output returns
//! after a gap.
//!
//! A pose outside the permitted box is withheld. So is a pose that the receiver could only reach
//! faster than permitted. The speed is measured from the last pose SENT, so after a gap the
//! permitted distance grows with the elapsed time. With blending, an output that returns after a
//! gap starts from the last pose it sent and moves to the tracker's at no more than the blend
//! rates.

use std::time::Duration;

use nalgebra::UnitQuaternion;

use super::report::Withheld;
use super::settings::{BlendRates, SafetySettings};
use crate::frame::Timestamp;
use crate::geometry::{Body, Pose, Stage};

/// The decision about a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Verdict {
    /// Send this pose, which is the one given.
    Pass(Pose<Stage, Body>),
    /// Send this pose, which is on its way to the one given.
    Blend(Pose<Stage, Body>),
    /// Send nothing.
    Withhold(Withheld),
}

/// Maximum time between frames that is not a gap, even if none was reported (chosen: several frames
/// of the slowest cameras). Raised, a pose after such a pause is not blended; lowered below the
/// frame interval, the blended output stands still.
const MAX_STEP: Duration = Duration::from_millis(500);

/// Maximum coordinate of a plausible pose, metres. A round figure: it fits 32-bit floats in any
/// receiver's unit.
const FARTHEST_M: f64 = 1e9;

/// The limits of one body.
#[derive(Debug, Clone)]
pub(super) struct Limiter {
    limits: SafetySettings,
    sent: Option<(Timestamp, Pose<Stage, Body>)>,
    has_gap: bool,
    /// Whether it is on its way back to the tracker's pose.
    is_blending: bool,
}

impl Limiter {
    pub fn new(mut limits: SafetySettings) -> Self {
        // A return is no faster than any other motion.
        if let Some(rates) = &mut limits.blend {
            rates.speed_m_s = limits.max_speed_m_s.map_or(rates.speed_m_s, |most| rates.speed_m_s.min(most));
            rates.angular_speed_rad_s =
                limits.max_angular_speed_rad_s.map_or(rates.angular_speed_rad_s, |most| rates.angular_speed_rad_s.min(most));
        }
        Self { limits, sent: None, has_gap: false, is_blending: false }
    }

    /// Records that no pose was known: the next one comes after a gap.
    pub fn gap(&mut self) {
        self.has_gap = true;
    }

    /// Judges the pose of an instant; instants must increase.
    pub fn judge(&mut self, at: Timestamp, pose: &Pose<Stage, Body>) -> Verdict {
        let verdict = self.verdict(at, pose);
        match verdict {
            Verdict::Pass(pose) | Verdict::Blend(pose) => {
                self.sent = Some((at, pose));
                self.has_gap = false;
            }
            Verdict::Withhold(_) => self.gap(),
        }
        verdict
    }

    fn verdict(&mut self, at: Timestamp, pose: &Pose<Stage, Body>) -> Verdict {
        if !pose.is_finite() || pose.translation.amax() > FARTHEST_M {
            return Verdict::Withhold(Withheld::NotFinite);
        }
        if !self.is_inside(pose) {
            return Verdict::Withhold(Withheld::OutsideBox);
        }
        let Some((then, sent)) = self.sent else { return Verdict::Pass(*pose) };
        let elapsed_s = at.seconds_since(then).max(0.0);
        if let Some(rates) = self.limits.blend {
            let is_long = elapsed_s > MAX_STEP.as_secs_f64();
            // The first pose after a gap is the last one sent. A short gap during the return does
            // not restart it: with a pose only in every other frame the output would never move.
            if is_long || self.has_gap && !self.is_blending {
                self.is_blending = true;
                return self.blended(&sent, pose, 0.0, rates);
            }
            if self.is_blending {
                return self.blended(&sent, pose, elapsed_s, rates);
            }
        }
        match self.excess(&sent, pose, elapsed_s) {
            Some(reason) => Verdict::Withhold(reason),
            None => Verdict::Pass(*pose),
        }
    }

    fn is_inside(&self, pose: &Pose<Stage, Body>) -> bool {
        let Some([least, greatest]) = self.limits.permitted_box_m else { return true };
        pose.translation.iter().zip(least.iter().zip(greatest)).all(|(v, (least, greatest))| (*least..=greatest).contains(v))
    }

    fn excess(&self, from: &Pose<Stage, Body>, to: &Pose<Stage, Body>, elapsed_s: f64) -> Option<Withheld> {
        let (way, rotation) = ((to.translation - from.translation).norm(), from.angle_to(to));
        if self.limits.max_speed_m_s.is_some_and(|limit| way > limit * elapsed_s + 1e-9) {
            return Some(Withheld::TooFast);
        }
        self.limits.max_angular_speed_rad_s.is_some_and(|limit| rotation > limit * elapsed_s + 1e-9).then_some(Withheld::RotatesTooFast)
    }

    /// Moves from `from` towards `to` for `elapsed_s` at the blend rates; arrives once distance and
    /// angle are both within reach.
    fn blended(&mut self, from: &Pose<Stage, Body>, to: &Pose<Stage, Body>, elapsed_s: f64, rates: BlendRates) -> Verdict {
        let (way, rotation) = (to.translation - from.translation, to.rotation * from.rotation.inverse());
        let (distance, angle) = (way.norm(), rotation.angle());
        let (reach, sweep) = (rates.speed_m_s * elapsed_s, rates.angular_speed_rad_s * elapsed_s);
        if distance <= reach && angle <= sweep {
            self.is_blending = false;
            return Verdict::Pass(*to);
        }
        let share = |limit: f64, whole: f64| if whole > limit { limit / whole } else { 1.0 };
        let rotation = UnitQuaternion::from_scaled_axis(rotation.scaled_axis() * share(sweep, angle)) * from.rotation;
        Verdict::Blend(Pose::new(rotation, from.translation + way * share(reach, distance)))
    }
}

#[cfg(test)]
#[path = "limiter_tests.rs"]
mod tests;
