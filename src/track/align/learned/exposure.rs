//! How long the shutter is open, where nobody said: learnt from blurred frames.

use super::clue::Clue;
use crate::camera::Shutter;

/// Exposure that an unknown camera is begun with, seconds. Chosen, not tuned: learning only begins there, and found the 12 ms of d-handheld
/// from it. Raised, blur is predicted in the first frames that may not be there.
pub const USUAL_EXPOSURE_S: f64 = 0.004;
/// Shortest exposure that is learnt, seconds. Chosen: at 300 pixels a second it blurs by 0.15. Never 0, from which an exposure that changes
/// by shares of itself could not rise again. Raised, cameras with short exposures are predicted too blurred.
const MIN_EXPOSURE_S: f64 = 5e-4;
/// Longest exposure that is learnt, seconds: the time from frame to frame at 25 a second. Raised, frames that mislead can lead further
/// astray.
const MAX_EXPOSURE_S: f64 = 0.04;
/// Frames with this much blur or less, pixels of the frame, say nothing of the exposure; with less than `TELLING_BLUR_PX` they count by the
/// fourth power of it, as their information falls. With 1.5 for both, d-handheld was 0.106 mm off instead of 0.095. `MIN_BLUR_PX`
/// lowered, the point spread passes for motion; `TELLING_BLUR_PX` raised, a slow camera learns its exposure later.
const MIN_BLUR_PX: f64 = 0.8;
pub const TELLING_BLUR_PX: f64 = 1.5;
/// Share of what a frame says that is taken over: a memory of some ten frames, once the first ones, which count more, are in. Raised, the
/// exposure follows the noise of single frames.
const LEARNT_SHARE: f64 = 0.2;
/// Shares by which the exposure's square falls and rises in one frame at most: to a half, to twice. Chosen, not tuned: so far off the blur
/// is not linear in it any more. Raised, one frame that misleads does more harm; lowered, a wrong start is left later.
const MAX_FALL: f64 = 0.5;
const MAX_RISE: f64 = 1.0;

/// One sigma of an exposure that is not known, as a share of it: before any frame told of it, and after many. Chosen, not tuned: cameras expose for 1 to 20 ms.
/// Raised, the speed of a body that was just found is less sure.
const FIRST_SIGMA: f64 = 1.0;
const LEARNT_SIGMA: f64 = 0.05;

/// What is known of the point spread when a frame is asked for its blur.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownPsfVariance {
    /// Its slow average less what the frame was solved with.
    pub error: f64,
    /// One sigma.
    pub sigma: f64,
}

/// An exposure that follows slowly what blurred frames say of it.
#[derive(Debug, Clone, Default)]
pub struct UnknownExposure {
    /// Frames that told of it, by how much they did.
    told: f64,
}

impl UnknownExposure {
    /// One that earlier frames told, to this share of it, one sigma.
    pub fn known_to(sigma: f64) -> Self {
        let of_frames = (sigma.powi(2) - LEARNT_SIGMA.powi(2)).max(0.0).sqrt().max(LEARNT_SIGMA);
        Self { told: (FIRST_SIGMA / of_frames - 1.0).max(0.0) }
    }

    /// Whether frames told of it.
    pub fn is_told(&self) -> bool {
        self.told >= 1.0
    }

    /// One sigma of the exposure, as a share of it.
    pub fn sigma(&self) -> f64 {
        LEARNT_SIGMA.hypot(FIRST_SIGMA / (1.0 + self.told))
    }

    /// Learns from a frame's clue.
    pub fn learn(&mut self, shutter: &mut Shutter, clue: Clue, blur_px: f64) {
        let weight = (blur_px / TELLING_BLUR_PX).min(1.0).powi(4);
        self.told += weight;
        let share = weight * LEARNT_SHARE.max(2.0 / (self.told + 1.0)).min(1.0);
        // Blur is linear in the square of the exposure.
        let change = (2.0 * share * clue.score / clue.information).clamp(-MAX_FALL, MAX_RISE);
        shutter.exposure_s = (shutter.exposure_s * (1.0 + change).sqrt()).clamp(MIN_EXPOSURE_S, MAX_EXPOSURE_S);
    }
}

/// What the residuals of a frame with so much blur say of the exposure, beside the point spread, as a share of it; `None` where the frame
/// is too sharp to tell. `blur`: sums of the tiles' evidence.
pub fn exposure_clue(blur: &[f64; 5], psf_variance: KnownPsfVariance, blur_px: f64) -> Option<Clue> {
    if blur_px <= MIN_BLUR_PX {
        return None;
    }
    let mut s = *blur;
    // What is known of the point spread keeps it from passing for motion.
    s[0] += psf_variance.sigma.powi(-2);
    s[3] += psf_variance.error * psf_variance.sigma.powi(-2);
    let determinant = s[0] * s[2] - s[1] * s[1];
    if determinant <= 1e-3 * s[0] * s[2] {
        return None;
    }
    // Grey changes by -2 / exposure of "sharper" per second of exposure: blur grows with its square.
    Some(Clue { score: -2.0 * (s[0] * s[4] - s[1] * s[3]) / s[0], information: 4.0 * determinant / s[0] })
}
