//! Process noise of a motion: the density of the white jerk that propagates a motion estimate,
//! learnt from the frames.
//!
//! A dolly, a hand and a whip pan differ by factors of hundreds. Too little jerk ties velocity and
//! acceleration to their past values, and through the shutter that pulls the pose. Too much lets
//! them absorb what belongs to the pose. So the density adapts within about ten frames to how far
//! poses were from their predictions, relative to chance (Mehra 1970: innovations reveal the
//! process noise).

/// Initial spectral density of the jerk: m²/s⁵ at `DISTANCE_M` (proportional to the squared
/// distance), and rad²/s⁵. From a prototype, where they suited dolly, hand and whip pan alike;
/// frames refine them. Raised, the first frames' motion and pose are less certain.
const USUAL_SHIFT: f64 = 100.0;
const USUAL_ROTATION: f64 = 3000.0;
const DISTANCE_M: f64 = 4.0;
/// Limits of the densities as factors of the initial ones. At the lower limit earlier frames hardly
/// smooth the pose: errors of a still camera correlate by 0.16 from frame to frame.
/// `MIN_DENSITY_FACTOR` lowered, they smooth more; `MAX_DENSITY_FACTOR` raised, misleading frames
/// can leave the motion practically unknown.
const MIN_DENSITY_FACTOR: f64 = 0.01;
const MAX_DENSITY_FACTOR: f64 = 1000.0;
/// The logarithm of a density follows one frame by this fraction of the logarithm of its squared
/// innovation (in sigmas, per degree of freedom), minus that logarithm's mean. Innovations a tenth
/// of the prediction thus halve the predicted width within two frames; with plain squares it would
/// take seven. Raised, densities follow chance: at 0.4, covariances of steady cameras are too small
/// by a tenth.
const LEARNING_RATE: f64 = 0.3;
/// Mean logarithm of the mean of n squared normal variables, n from 1: the digamma function of n/2,
/// plus ln(2/n). With other values, densities drift.
const MEAN_LOG: [f64; 3] = [-1.270, -0.577, -0.369];
/// Limits of one frame's logarithm: a misleading picture is as far from the prediction as one after
/// jerk, and a frame close to the prediction may be so by chance. Chosen, not tuned. Wider, single
/// frames change the density more.
const LOGS: [f64; 2] = [-4.0, 3.0];
/// Number of first frames whose innovations are ignored, because the motion is not known yet: as
/// many as position, velocity and acceleration need. Raised, the density is learnt later; lowered,
/// it falls because everything is within the wide first prediction.
const UNLEARNT_FRAMES: u32 = 3;

/// Deviation of a frame from its prediction ([`innovations`](super::MotionEstimate::innovations)).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation {
    /// Its square, in expected variances, per degree of freedom.
    pub squared: f64,
    /// Number of directions in which the frame was informative, 1 to 3.
    pub freedom: usize,
}

/// The learnt white jerk, as factors of the initial densities.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProcessNoise {
    shift: f64,
    rotation: f64,
    /// Number of frames learnt from.
    frames: u32,
}

impl Default for ProcessNoise {
    fn default() -> Self {
        Self { shift: 1.0, rotation: 1.0, frames: 0 }
    }
}

impl ProcessNoise {
    /// Creates a known process noise: its densities as factors of the usual ones.
    #[cfg(feature = "cli")]
    pub fn with_factors(shift: f64, rotation: f64) -> Self {
        Self { shift, rotation, frames: UNLEARNT_FRAMES }
    }

    /// Returns the spectral density of the shift's jerk at a distance from the stage, m²/s⁵.
    pub fn of_shift(&self, distance_m: f64) -> f64 {
        self.shift * USUAL_SHIFT * (distance_m / DISTANCE_M).powi(2)
    }

    /// Returns the spectral density of the rotation's jerk, rad²/s⁵.
    pub fn of_rotation(&self) -> f64 {
        self.rotation * USUAL_ROTATION
    }

    /// Whether too few frames have been seen.
    pub fn is_unlearnt(&self) -> bool {
        self.frames < UNLEARNT_FRAMES
    }

    /// Learns from the innovations of shift and rotation
    /// ([`innovations`](super::MotionEstimate::innovations)).
    pub fn learn(&mut self, innovations: [Option<Innovation>; 2]) {
        self.frames = self.frames.saturating_add(1);
        if self.frames <= UNLEARNT_FRAMES {
            return;
        }
        for (innovation, density) in innovations.into_iter().zip([&mut self.shift, &mut self.rotation]) {
            let Some(Innovation { squared, freedom }) = innovation else { continue };
            // The fewer the squares, the more their logarithm scatters.
            let share = LEARNING_RATE * freedom as f64 / 3.0;
            let change = share * (squared.max(f64::MIN_POSITIVE).ln() - MEAN_LOG[freedom - 1]).clamp(LOGS[0], LOGS[1]);
            *density = (*density * change.exp()).clamp(MIN_DENSITY_FACTOR, MAX_DENSITY_FACTOR);
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

    /// One Kalman filter step: a pose seen with this noise, variances per axis of shift and
    /// rotation.
    fn updated(expected: &MotionEstimate, seen: &Motion, noise: &Vector6<f64>) -> MotionEstimate {
        let innovation = expected.motion.pose_error_to(seen);
        let of_pose = expected.covariance.fixed_rows::<6>(0).into_owned();
        let together = of_pose.fixed_columns::<6>(0) + Matrix6::from_diagonal(noise);
        let gain = of_pose.transpose() * together.try_inverse().expect("positive definite");
        MotionEstimate { motion: expected.motion.corrected(&(gain * innovation)), covariance: expected.covariance - gain * of_pose }
    }

    /// Returns the logarithm of learnt over true jerk density, averaged over the later frames.
    /// `noise`: standard deviations of the observed pose; `known_every`: number of frames after
    /// which the whole motion becomes known again.
    fn learnt(shift: f64, rotation: f64, noise: &Vector6<f64>, known_every: usize) -> [f64; 2] {
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
            // Small steps: jerk changes the acceleration, the rest follows.
            for _ in 0..STEPS {
                truth = truth.after(DT_S / STEPS as f64);
                let mut step = |q: f64| Vector3::from_fn(|_, _| normal() * (q * DT_S / STEPS as f64).sqrt());
                truth.acceleration += step(shift);
                truth.angular_acceleration += step(rotation);
            }
            let off = MotionError::from_fn(|row, _| if row < 6 { noise[row] * normal() } else { 0.0 });
            let expected = estimate.after(DT_S, AT_M, &process_noise);
            estimate = updated(&expected, &truth.corrected(&off), &noise.map(|sigma| sigma * sigma));
            process_noise.learn(expected.innovations(&estimate));
            if frame >= 100 {
                sums = [sums[0] + (process_noise.of_shift(AT_M) / shift).ln(), sums[1] + (process_noise.of_rotation() / rotation).ln()];
                n += 1.0;
            }
        }
        sums.map(|s| s / n)
    }

    #[test]
    fn jerk_is_learnt_from_innovations() {
        for (shift, rotation) in [(20.0, 600.0), (100.0, 3000.0), (5000.0, 90_000.0)] {
            let off = learnt(shift, rotation, &Vector6::repeat(1e-5), 1);
            assert!(off.iter().all(|ln| ln.abs() < 0.4), "{shift}, {rotation}: {off:?}");
        }
    }

    #[test]
    fn unobserved_axes_do_not_count_as_smooth_motion() {
        // Poorly observed along two of three axes: if that counted as smooth there, predictions
        // would be wrong along the third.
        let hardly = Vector6::new(0.5, 0.5, 1e-4, 0.1, 0.1, 1e-3);
        // Equally noisy along all axes, about as much as jerk moves it within some frames.
        let little = Vector6::new(0.003, 0.003, 0.003, 0.003, 0.003, 0.003);
        for noise in [hardly, little] {
            let off = learnt(100.0, 60.0, &noise, 5);
            // Unobserved rotation about two axes shows in the third, by its square.
            assert!(off.iter().all(|ln| ln.abs() < 0.9), "{noise:?}: {off:?}");
        }
    }
}
