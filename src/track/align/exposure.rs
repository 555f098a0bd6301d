//! How long the shutter is open, where nobody said: learnt from blurred frames.

use super::system::schur_complement::Clue;
use crate::camera::Shutter;

/// Exposure that an unknown camera is begun with, seconds.
pub const USUAL_EXPOSURE_S: f64 = 0.004;
/// Shortest exposure that differs from none, seconds.
const SHORTEST_EXPOSURE_S: f64 = 5e-4;
/// Longest exposure of a camera at 25 frames a second, seconds.
const LONGEST_EXPOSURE_S: f64 = 0.04;
/// It is learnt from frames with at least so much blur, pixels of the frame, by this share of what each says; of those
/// with less than the second by less, as their information falls with its fourth power.
const LEAST_BLUR_PX: f64 = 0.8;
const TELLING_BLUR_PX: f64 = 1.5;
/// The first of them say the more, and the exposure's square falls and rises by these shares a frame at most.
const LEARNT_SHARE: f64 = 0.2;
const LARGEST_FALL: f64 = 0.5;
const LARGEST_RISE: f64 = 1.0;

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
    /// Learns from a frame's clue.
    pub fn learn(&mut self, shutter: &mut Shutter, clue: Clue, blur_px: f64) {
        let weight = (blur_px / TELLING_BLUR_PX).min(1.0).powi(4);
        self.told += weight;
        let share = weight * LEARNT_SHARE.max(2.0 / (self.told + 1.0)).min(1.0);
        // Blur is linear in the square of the exposure.
        let change = (2.0 * share * clue.score / clue.information).clamp(-LARGEST_FALL, LARGEST_RISE);
        shutter.exposure_s = (shutter.exposure_s * (1.0 + change).sqrt()).clamp(SHORTEST_EXPOSURE_S, LONGEST_EXPOSURE_S);
    }
}

/// What the residuals of a frame with so much blur say of the exposure, beside the point spread, as a share of it; `None` where the frame
/// is too sharp to tell. `blur`: sums of the tiles' evidence.
pub fn exposure_clue(blur: &[f64; 5], psf_variance: KnownPsfVariance, blur_px: f64) -> Option<Clue> {
    if blur_px <= LEAST_BLUR_PX {
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
