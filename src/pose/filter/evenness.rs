//! How even the measurements themselves run: their noise, and whether one is a jump.
//!
//! Both are read from the measurements and never from a filter's state, so what a filter tells cannot feed them. A measurement far
//! from the straight line through the last two is a jump if it is further from it than the recent accelerations and the noise explain:
//! a kick, an end stop, a cut. A camera in the hand has greater accelerations all the time, and they are none.

use nalgebra::Vector3;

use super::place::Place;

/// A measurement is a jump at this many times the squared distance that accelerations and noise let expect: four sigmas.
/// Lowered, quick hands are taken for jumps; raised, small kicks swing through the slower filters.
const JUMP: f64 = 16.0;
/// Time constant of the mean of the squared accelerations, seconds: a few swings of a hand's tremor. Chosen, not tuned.
/// Raised, the first moments of a quick motion count as jumps; lowered, the mean of few frames is chance.
const ACCELERATIONS_S: f64 = 0.2;
/// Time constant of the mean of the squared noise, seconds: ten frames at 30 a second. Chosen, not tuned.
/// Raised, it follows a change of light or distance later; lowered, it scatters.
const NOISE_S: f64 = 0.3;
/// The noise is no less than this share of what the covariance says, as a variance: a still picture repeats its
/// measurement exactly, the next one does not. Lowered, that next one counts as a jump.
const LEAST_NOISE: f64 = 1e-4;
/// Most that one measurement counts, in mean noises: a jump is no noise. Raised, a jump calms
/// the filter for a while; lowered, noise that rises is learnt later.
const OUTLIER: f64 = 10.0;

/// A measurement as long as it is needed.
#[derive(Debug, Clone, Copy)]
struct Measured<P> {
    /// Seconds before the newest.
    age_s: f64,
    place: P,
    variance: f64,
}

#[derive(Debug, Clone)]
pub(super) struct Evenness<P> {
    /// The last three, the newest first.
    last: [Option<Measured<P>>; 3],
    /// Mean squared acceleration.
    acceleration_squared: f64,
    /// The measured noise as a share of what the covariance says, as a variance, at most 1.
    noise_share: f64,
    /// Whether the last measurement was a jump.
    has_jumped: bool,
}

impl<P: Place> Evenness<P> {
    pub fn of_first(place: P, variance: f64) -> Self {
        let first = Measured { age_s: 0.0, place, variance };
        Self { last: [Some(first), None, None], acceleration_squared: 0.0, noise_share: 1.0, has_jumped: false }
    }

    /// What the measurements show of their variance, as a share of what is said of it.
    pub fn noise_share(&self) -> f64 {
        self.noise_share
    }

    /// Takes a measurement; whether it is a jump. `speed` is what a body that was just seen first may have, one sigma.
    pub fn jumps(&mut self, step_s: f64, place: &P, variance: f64, speed: f64) -> bool {
        for last in self.last.iter_mut().flatten() {
            last.age_s += step_s;
        }
        self.learn_noise(step_s, place, variance);
        let is_jump = match self.last {
            [Some(a), Some(b), _] => {
                let (beyond, by_noise) = off_line(place, variance, &[a, b]);
                // A constant acceleration leads so far from the straight line.
                let reach = a.age_s * b.age_s / 2.0;
                let acceleration = (beyond - by_noise * self.noise_share).max(0.0) / reach.powi(2).max(f64::MIN_POSITIVE);
                let expected = self.acceleration_squared * reach.powi(2) + by_noise * self.noise_share;
                let share = 1.0 - (-step_s / ACCELERATIONS_S).exp();
                self.acceleration_squared += share * (acceleration - self.acceleration_squared);
                // After a jump a way on in its direction was the beginning of a motion.
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

    /// Smooth motion runs along a parabola; what is beyond it is noise, or more motion than one thinks: an upper bound.
    fn learn_noise(&mut self, step_s: f64, place: &P, variance: f64) {
        let [Some(a), Some(b), Some(c)] = self.last else { return };
        let (beyond, by_noise) = off_line(place, variance, &[a, b, c]);
        let ratio = (beyond / by_noise).min(OUTLIER * self.noise_share);
        let share = 1.0 - (-step_s / NOISE_S).exp();
        self.noise_share = (self.noise_share + share * (ratio - self.noise_share)).clamp(LEAST_NOISE, 1.0);
    }
}

/// Squared distance of a place from the polynomial through earlier ones (their Lagrange weights), and what noise alone lets expect.
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
