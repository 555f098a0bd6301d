//! How noisy a camera is, learnt from what its frames leave unexplained.
//!
//! The variance of a pixel is a part that is always there (reading, rounding, compression), a part that grows with the light (shot
//! noise), and the error of the prediction, which grows with how steep the picture is there. The squared residuals of the finest level
//! tell all three apart: they are fitted by a straight line in grey and squared slope, frame after frame (weighted least squares,
//! as for the photon transfer curve: Janesick 2007).

use nalgebra::{Matrix3, Vector3};

/// Taken until frames tell more: variance of a usual camera's pixel at black, grey levels² (read noise 1.5 levels, and rounding); its
/// growth per grey level; error of the prediction, pixels of the level. Assumed, and replaced within a few sharp frames. Raised, first
/// covariances are wider.
const USUAL_DARK: f64 = 2.25 + 1.0 / 12.0;
const USUAL_SHOT: f64 = 0.03;
const USUAL_MODEL_PX: f64 = 0.02;
/// Least variance at black, grey levels²: that of rounding to whole levels. Raised, quiet cameras are believed less than they deserve.
const MIN_DARK: f64 = 1.0 / 12.0;
/// Least error of the prediction, pixels of the level: below the 0.005 to 0.012 that rendered clips show. Raised, a still camera scatters
/// more.
const MIN_MODEL_PX: f64 = 0.003;
/// Least error of the prediction while the camera moves, pixels of the finest level, and of those above. What is wrong at an edge is wrong
/// all along it and in the next frames too: weights by the bare scatter made d-steep and d-handheld worse by a tenth. Raised, edges count
/// less beside flat texture, and covariances are wider. The second is chosen, twice the first.
const MOVING_MODEL_PX: f64 = 0.02;
const COARSE_MODEL_PX: f64 = 0.04;
/// Of what is remembered this share fades with every frame: a memory of 200 frames. Chosen, not tuned. Raised, the noise follows chance;
/// lowered, a change of the camera's gain is learnt later.
const FADES: f64 = 0.005;
/// Weight of the usual noise, pixels, so that what a frame cannot tell apart stays near it. Chosen: less than a tenth of what a single
/// frame tells (`ROUGH_PIXELS` in `level_problem`). Raised, the noise is learnt later.
const USUAL_PIXELS: f64 = 200.0;
/// Of what is remembered this share stays where the frames are asked with another model. Raised, what a wrong lens or a fold left counts as noise for many rounds; with
/// 0, the first frames of a round are judged by a usual camera.
const KEPT_OF_OTHER_MODEL: f64 = 0.1;

/// What the noise of a pixel is made of, at one level of the frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Variance at black, and its growth per grey level, of one pixel of the level.
    pub dark: f32,
    /// See `dark`.
    pub per_intensity: f32,
    /// Error of the prediction, pixels of the level.
    pub model_px: f32,
}

/// Sums over pixels for the fit: of what the variance may be made of (1, grey, squared slope) by each other, and by the squared residual.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseSums {
    pub(in crate::track::align) by_each_other: Matrix3<f64>,
    pub(in crate::track::align) by_squared: Vector3<f64>,
}

impl Default for NoiseSums {
    fn default() -> Self {
        Self { by_each_other: Matrix3::zeros(), by_squared: Vector3::zeros() }
    }
}

/// The noise of one camera as learnt so far, as variances of a pixel at the finest level.
#[derive(Debug, Clone)]
pub struct CameraNoise {
    /// The finest level.
    level: usize,
    sums: NoiseSums,
    /// At black, per grey level, per squared slope.
    variance: Vector3<f64>,
}

impl CameraNoise {
    /// A usual camera's, with what frames tell at a level.
    pub fn usual(level: usize) -> Self {
        let n = f64::from(1u32 << (2 * level));
        Self { level, sums: NoiseSums::default(), variance: Vector3::new(USUAL_DARK / n, USUAL_SHOT / n, USUAL_MODEL_PX.powi(2)) }
    }

    /// The noise of a pixel of a level.
    pub fn at(&self, level: usize) -> Noise {
        let smaller = 0.25_f64.powi(level as i32 - self.level as i32);
        let least_px = if level == self.level { MOVING_MODEL_PX } else { COARSE_MODEL_PX };
        Noise {
            dark: (self.variance.x * smaller) as f32,
            per_intensity: (self.variance.y * smaller) as f32,
            model_px: least_px.max(self.variance.z.sqrt()) as f32,
        }
    }

    /// The noise of a pixel of the finest level while nothing moves: the prediction's error stays as it is, and scatters nothing.
    pub fn of_still(&self) -> Noise {
        Noise { model_px: self.variance.z.sqrt() as f32, ..self.at(self.level) }
    }

    /// Pixels that it is learnt from, of those that are remembered.
    pub fn told(&self) -> f64 {
        self.sums.by_each_other[(0, 0)]
    }

    /// What frames left so far, they left of another model.
    pub fn doubt(&mut self) {
        self.sums.by_each_other *= KEPT_OF_OTHER_MODEL;
        self.sums.by_squared *= KEPT_OF_OTHER_MODEL;
    }

    /// Learns from a frame that was aligned.
    pub fn learn(&mut self, frame: &NoiseSums) {
        self.sums.by_each_other = self.sums.by_each_other * (1.0 - FADES) + frame.by_each_other;
        self.sums.by_squared = self.sums.by_squared * (1.0 - FADES) + frame.by_squared;
        let usual = Self::usual(self.level).variance;
        let [least_dark, least_model] = [MIN_DARK / f64::from(1u32 << (2 * self.level)), MIN_MODEL_PX.powi(2)];
        // As much as that number of pixels of the usual grey and slope would tell of each part alone.
        let weight = USUAL_PIXELS * Vector3::from(usual.map(|v| (v * v).recip())).component_mul(&self.share_of(&usual));
        let mut a = self.sums.by_each_other;
        let mut b = self.sums.by_squared;
        for k in 0..3 {
            a[(k, k)] += weight[k];
            b[k] += weight[k] * usual[k];
        }
        if let Some(variance) = at_least(&a, &b, &Vector3::new(least_dark, 0.0, least_model)) {
            self.variance = variance;
            tracing::trace!(dark = variance.x, per_intensity = variance.y, model_px = variance.z.sqrt(), "noise");
        }
    }

    /// How large each part of the usual variance is beside all of it, squared, at grey 100 and a slope of 30 grey levels a pixel.
    fn share_of(&self, usual: &Vector3<f64>) -> Vector3<f64> {
        let parts = usual.component_mul(&Vector3::new(1.0, 100.0, 900.0));
        (parts / parts.sum()).map(|share| share * share)
    }
}

/// The least-squares solution with no entry below its least: an entry that would be is held there, and the others are solved again.
fn at_least(a: &Matrix3<f64>, b: &Vector3<f64>, least: &Vector3<f64>) -> Option<Vector3<f64>> {
    let mut held = [false; 3];
    for _ in 0..4 {
        let (mut m, mut r) = (*a, *b);
        for k in (0..3).filter(|k| held[*k]) {
            r -= a.column(k) * least[k];
            m.row_mut(k).fill(0.0);
            m.column_mut(k).fill(0.0);
            m[(k, k)] = 1.0;
        }
        for k in (0..3).filter(|k| held[*k]) {
            r[k] = least[k];
        }
        let x = m.cholesky()?.solve(&r);
        let Some(lowest) =
            (0..3).filter(|k| !held[*k] && x[*k] < least[*k]).max_by(|i, k| (least[*i] - x[*i]).total_cmp(&(least[*k] - x[*k])))
        else {
            return x.iter().all(|v| v.is_finite()).then_some(x);
        };
        held[lowest] = true;
    }
    None
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::track::align::kernel::noise_sums::{KEPT_VARIANCE, MAX_SQUARED};

    /// Sums over pixels of random grey and slope whose variance is known.
    fn sums(truth: &Vector3<f64>, weights: &CameraNoise, random: &mut Pcg64Mcg) -> NoiseSums {
        let mut sums = NoiseSums::default();
        for _ in 0..3000 {
            let regressors = Vector3::new(1.0, random.random_range(5.0..240.0), random.random_range(0.0..60.0_f64).powi(2));
            let normal = (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            let squared = truth.dot(&regressors) * normal * normal;
            let expected = weights.variance.dot(&regressors);
            let scale2 = truth.dot(&regressors) / expected;
            if squared < f64::from(MAX_SQUARED) * scale2 * expected {
                let w = expected.powi(-2);
                sums.by_each_other += regressors * regressors.transpose() * w;
                sums.by_squared += regressors * (w * squared / KEPT_VARIANCE);
            }
        }
        sums
    }

    #[test]
    fn the_noise_of_a_camera_is_learnt() {
        let mut random = Pcg64Mcg::seed_from_u64(7);
        for truth in [[0.3, 0.004, 1e-5], [2.0, 0.02, 2e-4], [0.6, 0.0, 5e-4], [5.0, 0.05, 1e-5]] {
            let truth = Vector3::from(truth);
            let mut learnt = CameraNoise::usual(1);
            for _ in 0..40 {
                learnt.learn(&sums(&truth, &learnt, &mut random));
            }
            // The whole variance of dark and bright, flat and steep pixels.
            for regressors in [[1.0, 20.0, 0.0], [1.0, 200.0, 0.0], [1.0, 100.0, 900.0], [1.0, 50.0, 3000.0]] {
                let regressors = Vector3::from(regressors);
                let ratio = learnt.variance.dot(&regressors) / truth.dot(&regressors);
                assert!((0.85..1.2).contains(&ratio), "{truth:?}, {regressors:?}: {ratio}, {:?}", learnt.variance);
            }
        }
    }

    #[test]
    fn what_a_wrong_model_left_is_soon_forgotten() {
        let mut random = Pcg64Mcg::seed_from_u64(8);
        let [wrong, right] = [[20.0, 0.3, 2e-3], [0.6, 0.01, 1e-4]].map(Vector3::from);
        // How many times too large the variance still is after three rounds of a better model.
        let mut too_large = |doubts: bool| {
            let mut learnt = CameraNoise::usual(1);
            for _ in 0..30 {
                learnt.learn(&sums(&wrong, &learnt, &mut random));
            }
            for frame in 0..30 {
                if doubts && frame % 10 == 0 {
                    learnt.doubt();
                }
                learnt.learn(&sums(&right, &learnt, &mut random));
            }
            let regressors = Vector3::new(1.0, 100.0, 900.0);
            learnt.variance.dot(&regressors) / right.dot(&regressors)
        };
        let ratios = [true, false].map(&mut too_large);
        assert!(ratios[0] < 1.3 && ratios[1] > 2.0 * ratios[0], "{ratios:?}");
    }

    #[test]
    fn what_frames_cannot_tell_stays_usual() {
        let usual = CameraNoise::usual(1);
        let mut learnt = usual.clone();
        learnt.learn(&NoiseSums::default());
        assert!((learnt.variance - usual.variance).norm() < 1e-9);
        // Pixels of one grey and slope: their variance is met, and nothing vanishes.
        let regressors = Vector3::new(1.0, 128.0, 400.0);
        let w = usual.variance.dot(&regressors).powi(-2) * 3000.0;
        for _ in 0..20 {
            learnt.learn(&NoiseSums { by_each_other: regressors * regressors.transpose() * w, by_squared: regressors * (w * 5.0) });
        }
        assert!((learnt.variance.dot(&regressors) - 5.0).abs() < 0.3);
        assert!(learnt.variance.iter().all(|v| *v > 0.0));
    }

    #[test]
    fn coarser_levels_are_less_noisy() {
        let noise = CameraNoise::usual(1);
        assert!((noise.at(1).dark - 4.0 * noise.at(2).dark).abs() < 1e-6);
        assert!(noise.at(2).model_px >= noise.at(1).model_px);
    }
}
