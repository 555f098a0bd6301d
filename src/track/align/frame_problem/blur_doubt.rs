//! Whether a body that was just found may be blurred by its motion. Its descent ends differently
//! then.

use super::{FrameProblem, LevelFit};
use crate::track::align::tuning::TUNING;

impl FrameProblem<'_> {
    /// Whether the velocity by blur may be estimated in this frame: for a body that was just found,
    /// under a rolling shutter, where the pose depends on the velocity.
    pub fn may_ask_blur(&self) -> bool {
        !self.is_followed && !self.slow.shutter.is_global()
    }

    /// Whether a newly found body's residuals at the finest level come from blur. Only under a
    /// global shutter; rows of a rolling one show the velocity themselves.
    pub fn is_clearly_blurred(&self, residual_sigma: f64) -> bool {
        !self.is_followed && self.slow.shutter.is_global() && shows_blur(residual_sigma, self.progress.above.as_ref())
    }
}

/// Whether residuals of the finest level (`residual_sigma`, sigmas) come from blur, judged by the
/// fit of the level above.
fn shows_blur(residual_sigma: f64, above: Option<&LevelFit>) -> bool {
    let Some(above) = above else { return false };
    let ratio = if above.inlier_tile_ratio > TUNING.min_coarse_inlier_ratio {
        TUNING.min_blur_residual_ratio_of_coarse_fit
    } else {
        TUNING.min_blur_residual_ratio
    };
    residual_sigma > TUNING.clear_fit_sigma.max(ratio * above.residual_sigma)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_fine_detail_marks_a_body_as_blurred() {
        let above = |residual_sigma, inlier_tile_ratio| LevelFit { residual_sigma, inlier_tile_ratio };
        assert!(shows_blur(4.2, Some(&above(2.9, 0.88))) && !shows_blur(4.2, Some(&above(2.9, 0.55))));
        assert!(
            shows_blur(7.8, Some(&above(5.0, 0.5)))
                && shows_blur(3.0, Some(&above(3.1, 0.85)))
                && !shows_blur(7.8, Some(&above(11.0, 0.9)))
        );
        // Noise is not blur, and without a level above nothing is known.
        assert!(!shows_blur(1.5, Some(&above(0.8, 0.9))) && !shows_blur(9.0, None));
    }
}
