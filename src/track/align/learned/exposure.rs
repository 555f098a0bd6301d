//! Learns the exposure time from blurred frames where it is not configured.
//!
//! The length of the motion blur is the speed times the exposure. So each blurred frame yields a
//! [`Clue`] on how much longer or shorter the exposure should be ([`exposure_clue`]), and
//! [`UnknownExposure`] follows these clues slowly.

use super::clue::Clue;
use crate::camera::Shutter;
use crate::track::align::tuning::TUNING;

/// What is known of the point spread when a frame's blur is evaluated, in the kernel's unit of
/// variance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownPsfVariance {
    /// Its slow average minus the value that the frame was solved with.
    pub error: f64,
    /// One sigma of that.
    pub sigma: f64,
}

/// Follows an unknown exposure by the clues of blurred frames.
#[derive(Debug, Clone, Default)]
pub struct UnknownExposure {
    /// Sum of the weights of all frames so far, each at most 1.
    accumulated: f64,
}

impl UnknownExposure {
    /// Returns the state of an exposure that an earlier session learnt to this relative sigma.
    pub fn known_to(sigma: f64) -> Self {
        let of_frames = (sigma.powi(2) - TUNING.learnt_exposure_sigma.powi(2)).max(0.0).sqrt().max(TUNING.learnt_exposure_sigma);
        Self { accumulated: (TUNING.initial_exposure_sigma / of_frames - 1.0).max(0.0) }
    }

    /// Whether frames have determined it, with a total weight of at least one frame.
    pub fn is_learnt(&self) -> bool {
        self.accumulated >= 1.0
    }

    /// Returns the relative sigma of the exposure.
    pub fn sigma(&self) -> f64 {
        TUNING.learnt_exposure_sigma.hypot(TUNING.initial_exposure_sigma / (1.0 + self.accumulated))
    }

    /// Corrects the exposure of `shutter` by a frame's clue. `blur_px`: length of the frame's blur,
    /// pixels of the frame.
    pub fn learn(&mut self, shutter: &mut Shutter, clue: Clue, blur_px: f64) {
        let weight = (blur_px / TUNING.full_weight_blur_px).min(1.0).powi(4);
        self.accumulated += weight;
        let share = weight * TUNING.exposure_learning_rate.max(2.0 / (self.accumulated + 1.0)).min(1.0);
        // Blur is linear in the square of the exposure.
        let change = (2.0 * share * clue.score / clue.information).clamp(-TUNING.max_exposure_decrease, TUNING.max_exposure_increase);
        shutter.exposure_s = (shutter.exposure_s * (1.0 + change).sqrt()).clamp(TUNING.min_exposure_s, TUNING.max_exposure_s);
    }
}

/// Returns a frame's clue on the exposure, as a relative change, with the point spread free; `None`
/// where the frame is too sharp or blur and point spread cannot be told apart. `blur`:
/// `RunEvidence::blur` summed over the tiles; `blur_px`: length of the blur, pixels of the frame.
pub fn exposure_clue(blur: &[f64; 5], psf_variance: KnownPsfVariance, blur_px: f64) -> Option<Clue> {
    if blur_px <= TUNING.min_exposure_blur_px {
        return None;
    }
    let mut s = *blur;
    // The prior of the point spread keeps it from passing for motion.
    s[0] += psf_variance.sigma.powi(-2);
    s[3] += psf_variance.error * psf_variance.sigma.powi(-2);
    let determinant = s[0] * s[2] - s[1] * s[1];
    if determinant <= 1e-3 * s[0] * s[2] {
        return None;
    }
    // A relative change c of the exposure changes the light by -2 c times "sharper", because blur
    // grows with the square of the exposure.
    Some(Clue { score: -2.0 * (s[0] * s[4] - s[1] * s[3]) / s[0], information: 4.0 * determinant / s[0] })
}
