//! Whether the blur of moving frames contradicts a configured exposure.
//!
//! Each blurred frame yields a clue on the relative change of the exposure. A single frame may be
//! wrong by half, because defocus and motion blur look alike along one direction; many frames that
//! agree are not. The configured exposure stays in use: a contradiction is only reported.

use super::clue::Clue;
use crate::track::align::tuning::TUNING;

/// Weighted mean and scatter of the clues on a configured exposure.
#[derive(Debug, Clone, Copy, Default)]
pub struct ExposureWatch {
    frames: f64,
    sum: f64,
    squares: f64,
}

impl ExposureWatch {
    /// Adds a frame's clue. `blur_px`: length of the frame's blur, pixels of the frame.
    pub fn take(&mut self, clue: Clue, blur_px: f64) {
        let weight = (blur_px / TUNING.full_weight_blur_px).min(1.0).powi(4);
        let change = (clue.score / clue.information).clamp(-TUNING.max_exposure_clue, TUNING.max_exposure_clue);
        if change.is_finite() {
            self.frames += weight;
            self.sum += weight * change;
            self.squares += weight * change * change;
        }
    }

    /// Returns the ratio of the fitted to the configured exposure where the frames clearly
    /// contradict the configured one.
    pub fn contradiction(&self) -> Option<f64> {
        if self.frames < TUNING.min_contradicting_frames {
            return None;
        }
        let mean = self.sum / self.frames;
        let scatter = (self.squares / self.frames - mean * mean).max(0.0).sqrt();
        let sigma = scatter / (self.frames / TUNING.correlated_frames).sqrt();
        // Blur is linear in the square of the exposure.
        let ratio = (1.0 + 2.0 * mean).max(0.01).sqrt();
        let is_far =
            !(1.0 / TUNING.min_exposure_factor..TUNING.min_exposure_factor).contains(&ratio) && ratio > TUNING.min_reported_exposure_ratio;
        (is_far && mean.abs() > TUNING.min_exposure_standard_errors * sigma).then_some(ratio)
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Returns the contradiction after frames whose real exposure is `ratio` times the configured
    /// one.
    fn after(frames: u32, ratio: f64, blur_px: f64, noise: f64) -> Option<f64> {
        let mut random = Pcg64Mcg::seed_from_u64(5);
        let mut watch = ExposureWatch::default();
        for _ in 0..frames {
            let change = 0.5 * (ratio * ratio - 1.0) + noise * random.random_range(-1.0..1.0);
            watch.take(Clue { score: 10.0 * change, information: 10.0 }, blur_px);
        }
        watch.contradiction()
    }

    #[test]
    fn an_exposure_off_by_a_factor_of_two_is_reported() {
        for ratio in [0.4, 0.5, 1.8] {
            let found = after(60, ratio, 3.0, 0.2).expect("a contradiction");
            assert!((found / ratio - 1.0).abs() < 0.15, "{ratio}: {found}");
        }
    }

    #[test]
    fn a_right_or_rounded_exposure_is_not_reported() {
        for ratio in [0.8, 1.0, 1.3] {
            assert_eq!(after(2000, ratio, 3.0, 0.4), None, "{ratio}");
        }
        // A camera that sharpens shows no blur at all.
        assert_eq!(after(2000, 0.1, 3.0, 0.2), None);
    }

    #[test]
    fn few_or_sharp_frames_do_not_judge_the_exposure() {
        assert_eq!(after(20, 0.5, 3.0, 0.1), None);
        assert_eq!(after(200, 0.5, 0.5, 0.1), None);
        // Frames that disagree with each other do not either.
        assert_eq!(after(60, 0.6, 3.0, 3.0), None);
    }
}
