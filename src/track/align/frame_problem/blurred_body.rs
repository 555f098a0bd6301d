//! The velocity of bodies that were just found, by their motion blur.
//!
//! One frame does not show how a body moves, only how it is smeared. Blur is estimated only for
//! bodies where it is likely and useful. Where it shows a velocity, the finest level is solved once
//! more with it. The estimate itself is `hypotheses::velocity_by_blur`.

use super::super::hypotheses::velocity_by_blur::{KnownBlur, VelocityByBlur, velocity_by_blur};
use super::super::picture::surface::nearest_centre;
use super::super::pixels::level_spec::LevelSpec;
use super::super::solve::level_problem::LevelPrior;
use super::{Buffers, FrameProblem, LevelFit};
use crate::track::align::tuning::TUNING;
use crate::track::frame::frame_levels::{FINEST, LEVELS};

impl FrameProblem<'_> {
    /// Whether the velocity by blur may be estimated in this frame: for a body that was just found,
    /// under a rolling shutter, where the pose depends on the velocity.
    pub(super) fn may_ask_blur(&self) -> bool {
        !self.is_followed && !self.slow.shutter.is_global()
    }

    /// Solves the finest level once more with the velocity that the blur of a newly found body
    /// shows; false if it shows none. `None` if no solution remains.
    pub fn solve_with_blur(&mut self) -> Option<bool> {
        // A still camera has no blur. In a wrong pose the better half of the tiles takes part as
        // always, and their blur means nothing.
        let is_global = self.slow.shutter.is_global();
        let residual_sigma = self.buffers.fine.solution()?.found.residual_sigma;
        let is_blurred = self.is_clearly_blurred(residual_sigma);
        if self.buffers.has_kept || (self.buffers.fine.inlier_tile_ratio() < TUNING.min_blur_inlier_ratio && !is_blurred) {
            return Some(false);
        }
        // With a global shutter the pose does not depend on the velocity. A picture that is large
        // enough for the coarsest level can be followed without it, unless it fits badly.
        if is_global && !is_blurred && self.has_pixels(LEVELS - 1) {
            return Some(false);
        }
        self.settle_with_blur()
    }

    /// Does the same for a partly occluded body, once it is known which tiles fit.
    /// `residual_sigma`: its residuals, sigmas.
    pub fn solve_covered_with_blur(&mut self, residual_sigma: f64) -> Option<bool> {
        let may_be_blurred = self.is_found_again() && self.slow.shutter.is_global() && residual_sigma > TUNING.min_occluded_blur_sigma;
        if !may_be_blurred || self.has_pixels(LEVELS - 1) {
            return Some(false);
        }
        self.settle_with_blur()
    }

    /// Continues to convergence with the velocity that the blur shows; false if it shows none.
    fn settle_with_blur(&mut self) -> Option<bool> {
        let Some(by_blur) = self.velocity_by_blur() else { return Some(false) };
        // Fuses the predicted velocity with the blur's.
        let (mut expected, mut information) = (self.expected.motion, *self.known.information);
        let mut of_velocity = information.fixed_view_mut::<6, 6>(6, 6);
        let score = of_velocity.clone_owned() * expected.twist() + by_blur.score;
        of_velocity += by_blur.information;
        expected = expected.with_twist(&of_velocity.clone_owned().cholesky()?.solve(&score));
        self.has_opposite = by_blur.has_opposite;
        self.by_blur = Some((expected, information));
        self.settle(by_blur.motion, &LevelPrior { motion: &expected, information: &information, ..self.known })?;
        Some(true)
    }

    /// Whether a newly found body's residuals at the finest level come from blur. Only under a
    /// global shutter; rows of a rolling one show the velocity themselves.
    pub(super) fn is_clearly_blurred(&self, residual_sigma: f64) -> bool {
        !self.is_followed && self.slow.shutter.is_global() && shows_blur(residual_sigma, self.progress.above.as_ref())
    }

    /// Returns the velocity that the blur of the solved frame shows, if any.
    fn velocity_by_blur(&mut self) -> Option<VelocityByBlur> {
        let found = self.buffers.fine.solution()?.found;
        let spec = self.spec(FINEST, &found.motion);
        let estimate = self.buffers.fine.solution()?.estimate();
        let middle = nearest_centre(self.surfaces, &found.motion.pose);
        let spec = LevelSpec { count: TUNING.blur_pixels, ..spec };
        // The coarse levels are finished, so their buffers are free.
        let Buffers { coarse: aside, selector, light, .. } = &mut *self.buffers;
        if !aside.lay_out(&spec, self.levels, &found.motion, selector, light) {
            return None;
        }
        let known = KnownBlur {
            exposure_sigma: self.slow.exposure_sigma(),
            psf_variance: self.slow.psf_variance,
            psf_variance_sigma: TUNING.psf_variance_sigma,
        };
        velocity_by_blur(aside, &spec, &estimate, middle, known)
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
