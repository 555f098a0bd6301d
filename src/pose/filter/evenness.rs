//! Estimates how smoothly the measurements themselves run: their noise, and whether one is a jump.
//!
//! Both use only the measurements and never a filter's state, so a filter's output cannot feed
//! back. A measurement is a jump if it is farther from the straight line through the last two than
//! recent accelerations and noise explain: a kick, an end stop, a cut. A hand-held camera has
//! larger accelerations all the time, and those are not jumps.

use nalgebra::Vector3;

use super::place::Place;

/// Multiple of the squared distance expected from accelerations and noise above which a measurement
/// is a jump: four sigmas. Lowered, fast hand motion counts as jumps; raised, small kicks swing
/// through the slower filters.
const JUMP: f64 = 16.0;
/// Time constant of the mean squared acceleration, seconds: a few periods of hand tremor. Chosen,
/// not tuned. Raised, the start of a fast motion counts as a jump; lowered, the mean over few
/// frames is random.
const ACCELERATIONS_S: f64 = 0.2;
/// Time constant of the mean squared noise, seconds: ten frames at 30 per second. Chosen, not
/// tuned. Raised, it adapts later to a change of light or distance; lowered, it scatters.
const NOISE_S: f64 = 0.3;
/// Minimum noise as a fraction of the stated covariance, as a variance: a still picture repeats its
/// measurement exactly, the next one does not. Lowered, that next one counts as a jump.
const MIN_NOISE: f64 = 1e-4;
/// Maximum weight of one measurement, in mean noises, because a jump is not noise. Raised, a jump
/// makes the filter sluggish for a while; lowered, rising noise is learnt later.
const OUTLIER: f64 = 10.0;

/// A recent measurement.
#[derive(Debug, Clone, Copy)]
struct Measured<P> {
    /// Age relative to the newest, seconds.
    age_s: f64,
    place: P,
    variance: f64,
}

#[derive(Debug, Clone)]
pub(super) struct Evenness<P> {
    /// The last three, newest first.
    last: [Option<Measured<P>>; 3],
    /// Mean squared acceleration.
    acceleration_squared: f64,
    /// Measured noise as a fraction of the stated covariance, as a variance, at most 1.
    noise_share: f64,
    /// Whether the last measurement was a jump.
    has_jumped: bool,
}

impl<P: Place> Evenness<P> {
    pub fn of_first(place: P, variance: f64) -> Self {
        let first = Measured { age_s: 0.0, place, variance };
        Self { last: [Some(first), None, None], acceleration_squared: 0.0, noise_share: 1.0, has_jumped: false }
    }

    /// Returns the measured variance as a fraction of the stated one.
    pub fn noise_share(&self) -> f64 {
        self.noise_share
    }

    /// Takes a measurement; returns whether it is a jump. `speed` is the prior speed of a newly
    /// seen body, one sigma.
    pub fn jumps(&mut self, step_s: f64, place: &P, variance: f64, speed: f64) -> bool {
        for last in self.last.iter_mut().flatten() {
            last.age_s += step_s;
        }
        self.learn_noise(step_s, place, variance);
        let is_jump = match self.last {
            [Some(a), Some(b), _] => {
                let (beyond, by_noise) = off_line(place, variance, &[a, b]);
                // Deviation from the straight line per unit of constant acceleration.
                let reach = a.age_s * b.age_s / 2.0;
                let acceleration = (beyond - by_noise * self.noise_share).max(0.0) / reach.powi(2).max(f64::MIN_POSITIVE);
                let expected = self.acceleration_squared * reach.powi(2) + by_noise * self.noise_share;
                let share = 1.0 - (-step_s / ACCELERATIONS_S).exp();
                self.acceleration_squared += share * (acceleration - self.acceleration_squared);
                // Continuing in the direction of a jump means that the jump was the start of a
                // motion.
                let goes_on = self.has_jumped && place.way_from(&a.place).dot(&a.place.way_from(&b.place)) > 0.0;
                beyond > JUMP * expected && !goes_on
            }
            [Some(a), None, _] => {
                let by_noise = 3.0 * (variance + a.variance) * self.noise_share;
                place.way_from(&a.place).norm_squared() > JUMP * (by_noise + 3.0 * (speed * step_s).powi(2))
            }
            _ => false,
        };
        self.has_jumped = is_jump;
        self.last = [Some(Measured { age_s: 0.0, place: *place, variance }), self.last[0], self.last[1]];
        is_jump
    }

    /// Smooth motion follows a parabola. The remainder is noise, or unmodelled motion: an upper
    /// bound.
    fn learn_noise(&mut self, step_s: f64, place: &P, variance: f64) {
        let [Some(a), Some(b), Some(c)] = self.last else { return };
        let (beyond, by_noise) = off_line(place, variance, &[a, b, c]);
        let ratio = (beyond / by_noise).min(OUTLIER * self.noise_share);
        let share = 1.0 - (-step_s / NOISE_S).exp();
        self.noise_share = (self.noise_share + share * (ratio - self.noise_share)).clamp(MIN_NOISE, 1.0);
    }
}

/// Returns the squared distance of a place from the polynomial through earlier ones (their Lagrange
/// weights), and the value expected from noise alone.
fn off_line<P: Place>(place: &P, variance: f64, earlier: &[Measured<P>]) -> (f64, f64) {
    let (mut beyond, mut expected): (Vector3<f64>, f64) = (Vector3::zeros(), 3.0 * variance);
    for (i, one) in earlier.iter().enumerate() {
        let others = earlier.iter().enumerate().filter(|(j, _)| *j != i);
        let weight: f64 = others.map(|(_, other)| other.age_s / (other.age_s - one.age_s)).product();
        beyond += place.way_from(&one.place) * weight;
        expected += 3.0 * weight.powi(2) * one.variance;
    }
    (beyond.norm_squared(), expected)
}
