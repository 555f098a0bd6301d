//! Learns how noisy a camera is from the residuals of its frames.
//!
//! The variance of a pixel has three parts: a constant one (read noise, rounding, compression), one
//! proportional to the light (shot noise), and the error of the prediction, proportional to the
//! squared gradient. The squared residuals of the finest level separate them: they are fitted as a
//! linear function of light and squared gradient, over many frames (weighted least squares, as for
//! the photon transfer curve: Janesick 2007).

use crate::track::align::tuning::TUNING;
use nalgebra::{Matrix3, Vector3};

use crate::light::CameraCurve;

/// The parts of a pixel's noise, at one level of the frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Variance at black of one pixel of the level, squared units of light.
    pub dark: f32,
    /// Growth of the variance per unit of light.
    pub per_intensity: f32,
    /// Error of the prediction, pixels of the level.
    pub model_px: f32,
}

/// Sums over pixels for the fit: products of the regressors (1, light, squared gradient) with each
/// other, and with the squared residual.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NoiseSums {
    /// Products of the regressors with each other.
    pub(in crate::track::align) by_each_other: Matrix3<f64>,
    /// Products of the regressors with the squared residual.
    pub(in crate::track::align) by_squared: Vector3<f64>,
}

/// The grey at which the usual noise is exact. Raised, dark pixels count as noisier at first;
/// lowered, bright ones count as less noisy than they are.
const USUAL_GREY: u8 = 160;

/// The noise of one camera as learnt so far, as variances of a pixel at the finest level.
#[derive(Debug, Clone)]
pub struct CameraNoise {
    /// The finest level.
    level: usize,
    /// Variance before any frame, and its minimum.
    usual: Vector3<f64>,
    least: Vector3<f64>,
    sums: NoiseSums,
    /// Variance at black, per unit of light, and per squared gradient.
    variance: Vector3<f64>,
}

impl CameraNoise {
    /// Returns the noise of a usual camera. `level`: the finest one, whose frames it will learn
    /// from. `curve`: the camera's, along which noise of its grey levels becomes noise of light.
    pub fn usual(level: usize, curve: &CameraCurve) -> Self {
        let n = f64::from(1u32 << (2 * level));
        let [dark, per_light] = in_light(curve, |grey| TUNING.initial_dark_variance + TUNING.initial_shot_variance * grey);
        let [least_dark, least_per_light] = in_light(curve, |_| TUNING.min_dark_variance);
        let usual = Vector3::new(dark / n, per_light / n, TUNING.initial_model_error_px.powi(2));
        let least = Vector3::new(least_dark / n, least_per_light / n, TUNING.min_model_error_px.powi(2));
        Self { level, usual, least, sums: NoiseSums::default(), variance: usual }
    }

    /// Returns the noise of a pixel of a level, for a moving camera.
    pub fn at(&self, level: usize) -> Noise {
        let smaller = 0.25_f64.powi(level as i32 - self.level as i32);
        let least_px = if level == self.level { TUNING.min_moving_model_error_px } else { TUNING.min_coarse_model_error_px };
        Noise {
            dark: (self.variance.x * smaller) as f32,
            per_intensity: (self.variance.y * smaller) as f32,
            model_px: least_px.max(self.variance.z.sqrt()) as f32,
        }
    }

    /// Returns the noise of a pixel of the finest level while nothing moves. The prediction's error
    /// is then the same in all frames and adds no scatter, so it has no minimum.
    pub fn of_still(&self) -> Noise {
        Noise { model_px: self.variance.z.sqrt() as f32, ..self.at(self.level) }
    }

    /// Returns the total weight of the remembered pixels, each weighing the squared inverse of its
    /// variance. The larger, the better the noise is known.
    pub fn total_weight(&self) -> f64 {
        self.sums.by_each_other[(0, 0)]
    }

    /// Forgets most of the memory, because the frames so far were solved with another model.
    pub fn doubt(&mut self) {
        self.sums.by_each_other *= TUNING.memory_kept_after_model_change;
        self.sums.by_squared *= TUNING.memory_kept_after_model_change;
    }

    /// Learns from the sums of an aligned frame.
    pub fn learn(&mut self, frame: &NoiseSums) {
        self.sums.by_each_other = self.sums.by_each_other * (1.0 - TUNING.noise_forgetting_rate) + frame.by_each_other;
        self.sums.by_squared = self.sums.by_squared * (1.0 - TUNING.noise_forgetting_rate) + frame.by_squared;
        let usual = self.usual;
        // The prior weighs as much as that number of pixels of the usual light and gradient would,
        // in each part alone.
        let weight =
            TUNING.initial_noise_weight_pixels * Vector3::from(usual.map(|v| (v * v).recip())).component_mul(&self.share_of(&usual));
        let mut a = self.sums.by_each_other;
        let mut b = self.sums.by_squared;
        for k in 0..3 {
            a[(k, k)] += weight[k];
            b[k] += weight[k] * usual[k];
        }
        if let Some(variance) = at_least(&a, &b, &self.least) {
            self.variance = variance;
            tracing::trace!(dark = variance.x, per_intensity = variance.y, model_px = variance.z.sqrt(), "noise");
        }
    }

    /// Returns the squared ratio of each part of the usual variance to their sum, at light 100 and
    /// a gradient of 30 per pixel.
    fn share_of(&self, usual: &Vector3<f64>) -> Vector3<f64> {
        let parts = usual.component_mul(&Vector3::new(1.0, 100.0, 900.0));
        (parts / parts.sum()).map(|share| share * share)
    }
}

/// Converts a variance of grey levels to one of light: at black, and its growth per light. It is
/// exact at black and at [`USUAL_GREY`].
fn in_light(curve: &CameraCurve, variance: impl Fn(f64) -> f64) -> [f64; 2] {
    let at = |grey: u8| variance(f64::from(grey)) * f64::from(curve.slope(grey)).powi(2);
    let dark = at(0);
    [dark, (at(USUAL_GREY) - dark).max(0.0) / f64::from(curve.light()[usize::from(USUAL_GREY)])]
}

/// Returns the least-squares solution with no entry below its minimum: an entry below is fixed
/// there, and the others are solved again.
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
    use crate::light::Transfer;
    use crate::track::align::kernel::noise_sums::TRUNCATED_VARIANCE;

    /// Sums over pixels of random light and gradient with a known variance.
    fn sums(truth: &Vector3<f64>, weights: &CameraNoise, random: &mut Pcg64Mcg) -> NoiseSums {
        let mut sums = NoiseSums::default();
        for _ in 0..3000 {
            let regressors = Vector3::new(1.0, random.random_range(5.0..240.0), random.random_range(0.0..60.0_f64).powi(2));
            let normal = (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            let squared = truth.dot(&regressors) * normal * normal;
            let expected = weights.variance.dot(&regressors);
            let scale2 = truth.dot(&regressors) / expected;
            if squared < f64::from(TUNING.max_squared_noise_residual) * scale2 * expected {
                let w = expected.powi(-2);
                sums.by_each_other += regressors * regressors.transpose() * w;
                sums.by_squared += regressors * (w * squared / TRUNCATED_VARIANCE);
            }
        }
        sums
    }

    #[test]
    fn the_noise_of_a_camera_is_learnt() {
        let mut random = Pcg64Mcg::seed_from_u64(7);
        for truth in [[0.3, 0.004, 1e-5], [2.0, 0.02, 2e-4], [0.6, 0.0, 5e-4], [5.0, 0.05, 1e-5]] {
            let truth = Vector3::from(truth);
            let mut learnt = CameraNoise::usual(1, &CameraCurve::new(Transfer::Linear));
            for _ in 0..40 {
                learnt.learn(&sums(&truth, &learnt, &mut random));
            }
            // The total variance of dark and bright, flat and steep pixels.
            for regressors in [[1.0, 20.0, 0.0], [1.0, 200.0, 0.0], [1.0, 100.0, 900.0], [1.0, 50.0, 3000.0]] {
                let regressors = Vector3::from(regressors);
                let ratio = learnt.variance.dot(&regressors) / truth.dot(&regressors);
                assert!((0.85..1.2).contains(&ratio), "{truth:?}, {regressors:?}: {ratio}, {:?}", learnt.variance);
            }
        }
    }

    #[test]
    fn residuals_of_a_wrong_model_are_soon_forgotten() {
        let mut random = Pcg64Mcg::seed_from_u64(8);
        let [wrong, right] = [[20.0, 0.3, 2e-3], [0.6, 0.01, 1e-4]].map(Vector3::from);
        // Returns the ratio of the learnt to the true variance after three rounds with a better
        // model.
        let mut too_large = |doubts: bool| {
            let mut learnt = CameraNoise::usual(1, &CameraCurve::new(Transfer::Linear));
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
    fn unobservable_noise_terms_keep_their_defaults() {
        let usual = CameraNoise::usual(1, &CameraCurve::new(Transfer::Linear));
        let mut learnt = usual.clone();
        learnt.learn(&NoiseSums::default());
        assert!((learnt.variance - usual.variance).norm() < 1e-9);
        // Pixels of one light and gradient determine only their total variance; no part vanishes.
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
        let noise = CameraNoise::usual(1, &CameraCurve::new(Transfer::Linear));
        assert!((noise.at(1).dark - 4.0 * noise.at(2).dark).abs() < 1e-6);
        assert!(noise.at(2).model_px >= noise.at(1).model_px);
    }
}
