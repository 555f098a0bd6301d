//! Follows a position or a rotation: adapts the memory to the measurements, restarts at rest after
//! a jump, and learns how far the acceleration counts in predictions.

use nalgebra::Vector3;

use super::evenness::Evenness;
use super::fading::Unknown;
use super::memories::Memories;
use super::place::Place;
use crate::frame::Timestamp;
use crate::motion::Recent;

/// Prior of an unknown motion, one sigma: m/s and m/s², or rad/s and rad/s². Chosen, not tuned.
/// Raised, the first frames follow the noise; lowered, they lag behind a camera found in motion.
const UNKNOWN: Unknown = Unknown { velocity: 0.5, acceleration: 30.0 };
/// Limits of the measurements' standard deviations, metres or radians: no camera is better than a
/// tenth of a micron, and one worse than ten metres teaches nothing. Wider, the filter's matrices
/// lose precision.
const SIGMAS: [f64; 2] = [1e-7, 10.0];
/// Time constant of the means that decide how far the acceleration counts, seconds: many times the
/// prediction span. Chosen, not tuned. Raised, a change from rails to hand-held shows later;
/// lowered, the weight scatters.
const LEAD_S: f64 = 0.5;

#[derive(Debug, Clone)]
pub(super) struct Follower<P> {
    /// Accelerations while moving, one sigma.
    acceleration: f64,
    /// How far ahead predictions are, seconds.
    ahead_s: f64,
    memories: Memories<P>,
    evenness: Evenness<P>,
    /// Recent estimates.
    estimates: Recent<Estimate<P>>,
    /// Means of two products: the acceleration's contribution to a prediction times its ideal
    /// contribution, and the contribution squared.
    lead: [f64; 2],
}

/// Position and motion at a stamp.
#[derive(Debug, Clone, Copy)]
pub(super) struct Estimate<P> {
    pub place: P,
    pub velocity: Vector3<f64>,
    pub acceleration: Vector3<f64>,
}

impl<P: Place> Follower<P> {
    pub fn start(acceleration: f64, ahead_s: f64, place: P, variance: f64) -> Self {
        let variance = usable(variance);
        Self {
            acceleration,
            ahead_s,
            memories: Memories::at_rest(place, variance, &UNKNOWN),
            evenness: Evenness::of_first(place, variance),
            estimates: Recent::new(),
            lead: [0.0; 2],
        }
    }

    pub fn update(&mut self, timestamp: Timestamp, step_s: f64, measured: &P, variance: f64) {
        let variance = usable(variance);
        let is_jump = self.evenness.jumps(step_s, measured, variance, UNKNOWN.velocity);
        let variance = usable(variance * self.evenness.noise_share());
        if is_jump {
            self.memories = Memories::at_rest(*measured, variance, &UNKNOWN);
            self.estimates.clear();
            return;
        }
        // A shorter memory would follow noise: within this time the acceleration moves the body by
        // one sigma.
        let shortest_s = (variance.sqrt() / self.acceleration).sqrt();
        self.memories.update(step_s, shortest_s, measured, variance);
        if self.ahead_s > 0.0 {
            self.learn_lead(timestamp, step_s, measured);
        }
    }

    /// Returns position and velocity now, and the acceleration weighted for predictions.
    pub fn estimate(&self) -> Estimate<P> {
        let best = self.memories.best();
        let [product, square] = self.lead;
        let counts = if square > 0.0 { (product / square).clamp(0.0, 1.0) } else { 0.0 };
        Estimate { place: best.place, velocity: best.velocity, acceleration: best.acceleration * counts }
    }

    /// Compares a past prediction for now with the measurement. If accelerations last shorter than
    /// the prediction span, as in hand-held use, adding them makes predictions worse; on rails it
    /// makes them better.
    fn learn_lead(&mut self, timestamp: Timestamp, step_s: f64, measured: &P) {
        if let Some((at, then)) = self.estimates.before(timestamp, self.ahead_s) {
            let seconds = timestamp.seconds_since(*at);
            let should = measured.way_from(&then.place.moved(then.velocity * seconds));
            let would = then.acceleration * (seconds * seconds / 2.0);
            let share = 1.0 - (-step_s / LEAD_S).exp();
            self.lead[0] += share * (would.dot(&should) - self.lead[0]);
            self.lead[1] += share * (would.norm_squared() - self.lead[1]);
        }
        let best = self.memories.best();
        let now = Estimate { place: best.place, velocity: best.velocity, acceleration: best.acceleration };
        self.estimates.push(timestamp, now);
    }
}

/// Clamps a variance to usable values; assumes a millimetre or milliradian for an invalid one.
fn usable(variance: f64) -> f64 {
    if variance >= 0.0 { variance.clamp(SIGMAS[0].powi(2), SIGMAS[1].powi(2)) } else { 1e-6 }
}
