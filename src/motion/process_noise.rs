//! How jerky a motion is: the white jerk that carries a motion estimate from frame to frame, learnt from the frames.
//!
//! A dolly, a hand and a whip pan differ by factors of hundreds. Too little jerk ties velocity and acceleration to what they were,
//! and through the shutter that pulls the pose; too much lets them take up what is the pose's own. So its density
//! follows how far poses were found from where they were expected, in sigmas of what chance does to that (Mehra 1970:
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
/// Mean logarithm of the mean of n squared normal variables, n from 1: the digamma function of n/2, plus ln(2/n). Any other and densities drift.
const MEAN_LOG: [f64; 3] = [-1.270, -0.577, -0.369];
/// One frame counts as no less and no more than these logarithms: a picture that misleads is as far from what was expected as one after
/// jerk, and a frame that comes where it was expected may do so by chance. Chosen, not tuned. Wider, single frames change the density by
/// more.
const LOGS: [f64; 2] = [-4.0, 3.0];
/// Frames after the first whose innovations say nothing: how the camera moves is not known yet. As many as place, velocity and acceleration
/// take. Raised, the density is learnt later; lowered, it falls as all is within the wide first expectation.
const UNTOLD_FRAMES: u32 = 3;

/// How far a frame was from what was expected ([`innovations`](super::MotionEstimate::innovations)).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation {
    /// Its square, in variances of what chance does, a degree of freedom.
    pub squared: f64,
    /// Directions in which the frame told enough, 1 to 3.
    pub freedom: usize,
}

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

    /// Whether it has seen too few frames to tell.
    pub fn is_untold(&self) -> bool {
        self.frames < UNTOLD_FRAMES
    }

    /// Learns from the innovations of shift and turn ([`innovations`](super::MotionEstimate::innovations)).
    pub fn learn(&mut self, innovations: [Option<Innovation>; 2]) {
        self.frames = self.frames.saturating_add(1);
        if self.frames <= UNTOLD_FRAMES {
            return;
        }
        for (innovation, density) in innovations.into_iter().zip([&mut self.shift, &mut self.turn]) {
            let Some(Innovation { squared, freedom }) = innovation else { continue };
            // The fewer the squares, the more their logarithm scatters.
            let share = SHARE * freedom as f64 / 3.0;
            let change = share * (squared.max(f64::MIN_POSITIVE).ln() - MEAN_LOG[freedom - 1]).clamp(LOGS[0], LOGS[1]);
            *density = (*density * change.exp()).clamp(LEAST, MOST);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::geometry::Pose;
    use crate::motion::{Motion, MotionError, MotionEstimate, MotionMatrix};

    const STEPS: usize = 30;
    const DT_S: f64 = 1.0 / 30.0;
    const AT_M: f64 = 4.0;

    /// One frame of a Kalman filter: a pose seen with this noise, variances by axis of shift and turn.
    fn updated(expected: &MotionEstimate, seen: &Motion, noise: &Vector6<f64>) -> MotionEstimate {
        let innovation = expected.motion.pose_error_to(seen);
        let of_pose = expected.covariance.fixed_rows::<6>(0).into_owned();
        let together = of_pose.fixed_columns::<6>(0) + Matrix6::from_diagonal(noise);
        let gain = of_pose.transpose() * together.try_inverse().expect("positive definite");
        MotionEstimate { motion: expected.motion.corrected(&(gain * innovation)), covariance: expected.covariance - gain * of_pose }
    }

    /// What is learnt of a motion that white jerk carries from frame to frame, by what it is: logarithms, on average over the later frames. `noise`: standard deviations
    /// by which frames see the pose; `known_every`: frames after which all of the motion is known again.
    fn learnt(shift: f64, turn: f64, noise: &Vector6<f64>, known_every: usize) -> [f64; 2] {
        let mut random = Pcg64Mcg::seed_from_u64(5);
        let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let rest = Motion::still(Pose::new(UnitQuaternion::identity(), Vector3::zeros()));
        let known = MotionEstimate { motion: rest, covariance: MotionMatrix::identity() * 1e-14 };
        let (mut truth, mut estimate) = (rest, known);
        let mut process_noise = ProcessNoise::default();
        let (mut sums, mut n) = ([0.0; 2], 0.0);
        for frame in 0..900 {
            if frame % known_every == 0 {
                (truth, estimate) = (rest, known);
            }
            // Small steps: jerk changes acceleration, the rest follows.
            for _ in 0..STEPS {
                truth = truth.after(DT_S / STEPS as f64);
                let mut step = |q: f64| Vector3::from_fn(|_, _| normal() * (q * DT_S / STEPS as f64).sqrt());
                truth.acceleration += step(shift);
                truth.turn_acceleration += step(turn);
            }
            let off = MotionError::from_fn(|row, _| if row < 6 { noise[row] * normal() } else { 0.0 });
            let expected = estimate.after(DT_S, AT_M, &process_noise);
            estimate = updated(&expected, &truth.corrected(&off), &noise.map(|sigma| sigma * sigma));
            process_noise.learn(expected.innovations(&estimate));
            if frame >= 100 {
                sums = [sums[0] + (process_noise.of_shift(AT_M) / shift).ln(), sums[1] + (process_noise.of_turn() / turn).ln()];
                n += 1.0;
            }
        }
        sums.map(|s| s / n)
    }

    #[test]
    fn jerk_is_learnt_from_innovations() {
        for (shift, turn) in [(20.0, 600.0), (100.0, 3000.0), (5000.0, 90_000.0)] {
            let off = learnt(shift, turn, &Vector6::repeat(1e-5), 1);
            assert!(off.iter().all(|ln| ln.abs() < 0.4), "{shift}, {turn}: {off:?}");
        }
    }

    #[test]
    fn what_a_body_does_not_show_is_no_sign_of_a_smooth_motion() {
        // Off by far in two axes of three: taken for smooth in these, the motion would be expected where it is not in the third.
        let hardly = Vector6::new(0.5, 0.5, 1e-4, 0.1, 0.1, 1e-3);
        // As far off in all axes as jerk moves it within some frames.
        let little = Vector6::new(0.003, 0.003, 0.003, 0.003, 0.003, 0.003);
        for noise in [hardly, little] {
            let off = learnt(100.0, 60.0, &noise, 5);
            // What turns unseen about two axes shows in the third, by its square.
            assert!(off.iter().all(|ln| ln.abs() < 0.9), "{noise:?}: {off:?}");
        }
    }
}
