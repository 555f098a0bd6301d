//! Follows a position or a rotation: the memory that the measurements allow, a new start at rest after a jump, and how far ahead the
//! acceleration counts.

use nalgebra::Vector3;

use super::evenness::Evenness;
use super::fading::Unknown;
use super::memories::Memories;
use super::place::Place;
use crate::frame::Timestamp;
use crate::motion::Recent;

/// One sigma of what may be when nothing is known of the motion, m/s and m/s², or rad/s and rad/s². Chosen, not tuned.
/// Raised, the first frames follow the noise; lowered, they lag behind a camera that is found in motion.
const UNKNOWN: Unknown = Unknown { velocity: 0.5, acceleration: 30.0 };
/// Standard deviations of measurements are taken to lie within these, metres or radians: no camera is better than a tenth of a
/// micron, and of one worse than ten metres nothing can be learnt. Wider, the filter's matrices lose digits.
const SIGMAS: [f64; 2] = [1e-7, 10.0];
/// Time constant of the means that decide how far ahead the acceleration counts, seconds: many times what predictions reach
/// ahead. Chosen, not tuned. Raised, a change from rails to hands shows later; lowered, the share scatters.
const LEAD_S: f64 = 0.5;

#[derive(Debug, Clone)]
pub(super) struct Follower<P> {
    /// Accelerations while moving, one sigma.
    acceleration: f64,
    /// How far ahead predictions are, seconds.
    ahead_s: f64,
    memories: Memories<P>,
    evenness: Evenness<P>,
    /// What was estimated a while ago.
    estimates: Recent<Estimate<P>>,
    /// Means of the product of what the acceleration added to a prediction with what it should have added, and of its square.
    lead: [f64; 2],
}

/// Place and motion at a stamp.
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
        // A shorter memory would follow noise: within this time the acceleration moves the body by one sigma.
        let shortest_s = (variance.sqrt() / self.acceleration).sqrt();
        self.memories.update(step_s, shortest_s, measured, variance);
        if self.ahead_s > 0.0 {
            self.learn_lead(timestamp, step_s, measured);
        }
    }

    /// Place and velocity now, and the acceleration as far as it counts for a prediction.
    pub fn estimate(&self) -> Estimate<P> {
        let best = self.memories.best();
        let [product, square] = self.lead;
        let counts = if square > 0.0 { (product / square).clamp(0.0, 1.0) } else { 0.0 };
        Estimate { place: best.place, velocity: best.velocity, acceleration: best.acceleration * counts }
    }

    /// Holds what would have been predicted for now against the measurement: where accelerations last shorter than a prediction
    /// reaches ahead, as in the hand, adding them makes it worse; on rails it makes it better.
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

/// A variance to work with, whatever is given: what is none says nothing, so a millimetre or milliradian is assumed.
fn usable(variance: f64) -> f64 {
    if variance >= 0.0 { variance.clamp(SIGMAS[0].powi(2), SIGMAS[1].powi(2)) } else { 1e-6 }
}
