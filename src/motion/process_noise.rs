//! How jerky a motion is: the white jerk that carries a motion estimate from frame to frame, learnt from the frames.
//!
//! A dolly, a hand and a whip pan differ by factors of hundreds. Too little jerk ties velocity and acceleration to what they were,
//! and through the shutter that pulls the pose; too much lets them take up what is the pose's own. So its density
//! follows how far poses were found from where they were expected, in sigmas of what was expected (Mehra 1970:
//! innovations tell of the process noise), within some ten frames.

/// Spectral density of a motion not seen yet: m²/s⁵ at `DISTANCE_M` (growing with the square of the distance), and rad²/s⁵. From a
/// prototype, in which they served dolly, hand and whip pan alike; frames teach better. Raised, the first frames' motion is less sure, and
/// the pose with it.
const USUAL_SHIFT: f64 = 100.0;
const USUAL_TURN: f64 = 3000.0;
const DISTANCE_M: f64 = 4.0;
/// The densities stay within these factors of the usual ones. At the lower end earlier frames hardly smooth the pose: that of a still
/// camera correlates by 0.16 from frame to frame. `LEAST` lowered, they smooth it more; `MOST` raised, frames that mislead can leave the
/// motion as good as unknown.
const LEAST: f64 = 0.01;
const MOST: f64 = 1000.0;
/// The logarithm of a density follows one frame by this share of the logarithm of its squared innovation (in sigmas, a degree of freedom),
/// less the mean of that. Innovations that are a tenth of what was expected so narrow the expectation by half within two frames; their squares
/// themselves would take seven. Raised, densities follow chance: with 0.4, the covariances of steady cameras are too small by a tenth.
const SHARE: f64 = 0.3;
/// Mean logarithm of the mean of three squared normal variables: the digamma function of 1.5, plus ln(2/3). Any other and densities drift.
const MEAN_LOG: f64 = -0.369;
/// One frame counts as no less and no more than these logarithms: a picture that misleads is as far from what was expected as one after
/// jerk, and a frame that comes where it was expected may do so by chance. Chosen, not tuned. Wider, single frames change the density by
/// more.
const LOGS: [f64; 2] = [-4.0, 3.0];
/// Frames after the first whose innovations say nothing: how the camera moves is not known yet. As many as place, velocity and acceleration
/// take. Raised, the density is learnt later; lowered, it falls as all is within the wide first expectation.
const UNTOLD_FRAMES: u32 = 3;

/// White jerk as learnt so far, in shares of the usual.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProcessNoise {
    shift: f64,
    turn: f64,
    /// Frames that it has seen.
    frames: u32,
}

impl Default for ProcessNoise {
    fn default() -> Self {
        Self { shift: 1.0, turn: 1.0, frames: 0 }
    }
}

impl ProcessNoise {
    /// Spectral density of the shift's jerk at a distance from the stage, m²/s⁵.
    pub fn of_shift(&self, distance_m: f64) -> f64 {
        self.shift * USUAL_SHIFT * (distance_m / DISTANCE_M).powi(2)
    }

    /// Spectral density of the turn's jerk, rad²/s⁵.
    pub fn of_turn(&self) -> f64 {
        self.turn * USUAL_TURN
    }

    /// Learns from the squared innovations of shift and turn ([`squared_innovations`](super::MotionEstimate::squared_innovations)).
    pub fn learn(&mut self, squared_innovations: [Option<f64>; 2]) {
        self.frames = self.frames.saturating_add(1);
        if self.frames <= UNTOLD_FRAMES {
            return;
        }
        for (squared, share) in squared_innovations.into_iter().zip([&mut self.shift, &mut self.turn]) {
            let Some(squared) = squared else { continue };
            let change = SHARE * (squared.max(f64::MIN_POSITIVE).ln() - MEAN_LOG).clamp(LOGS[0], LOGS[1]);
            *share = (*share * change.exp()).clamp(LEAST, MOST);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::Pose;
    use crate::motion::{Motion, MotionEstimate, MotionMatrix};

    const STEPS: usize = 30;

    /// What is learnt of a motion that white jerk carries from frame to frame, by what it is: logarithms, on average over the later frames.
    fn learnt(shift: f64, turn: f64) -> [f64; 2] {
        let mut random = Pcg64Mcg::seed_from_u64(5);
        let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let (dt, distance) = (1.0 / 30.0, 4.0);
        // All of the motion is known, as no shutter shows it: what is not expected is jerk alone.
        let rest = Motion::still(Pose::new(UnitQuaternion::identity(), Vector3::zeros()));
        let known = MotionEstimate { motion: rest, covariance: MotionMatrix::identity() * 1e-14 };
        let mut process_noise = ProcessNoise::default();
        let (mut sums, mut n) = ([0.0; 2], 0.0);
        for frame in 0..600 {
            // Small steps: jerk changes acceleration, the rest follows.
            let mut truth = rest;
            for _ in 0..STEPS {
                truth = truth.after(dt / STEPS as f64);
                let mut step = |q: f64| Vector3::from_fn(|_, _| normal() * (q * dt / STEPS as f64).sqrt());
                truth.acceleration += step(shift);
                truth.turn_acceleration += step(turn);
            }
            process_noise.learn(known.after(dt, distance, &process_noise).squared_innovations(&truth));
            if frame >= 100 {
                sums = [sums[0] + (process_noise.of_shift(distance) / shift).ln(), sums[1] + (process_noise.of_turn() / turn).ln()];
                n += 1.0;
            }
        }
        sums.map(|s| s / n)
    }

    #[test]
    fn jerk_is_learnt_from_innovations() {
        for (shift, turn) in [(20.0, 600.0), (100.0, 3000.0), (5000.0, 90_000.0)] {
            let off = learnt(shift, turn);
            assert!(off.iter().all(|ln| ln.abs() < 0.4), "{shift}, {turn}: {off:?}");
        }
    }
}
