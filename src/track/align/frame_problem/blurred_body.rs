//! Bodies that were just found: the velocity that their blur shows.
//!
//! One frame does not show how a body moves, but how it is smeared. Not every body is asked; where the blur shows a velocity, the finest level is solved once more with it.

use super::super::hypotheses::velocity_by_blur::{KnownBlur, VelocityByBlur, velocity_by_blur};
use super::super::picture::surface::nearest_centre;
use super::super::pixels::level_spec::LevelSpec;
use super::super::solve::level_problem::Expected;
use super::{Buffers, CLOSE_SCALE, FrameProblem, LevelFit, PSF_VARIANCE_SIGMA};
use crate::track::frame::frame_levels::{FINEST, LEVELS};

/// Pixels that are asked for their blur. Chosen: of a body that is just found, an alignment asks six times as many. Raised, the frame that finds it takes
/// longer; lowered, the velocity is less sure.
const BLUR_PIXELS: usize = 1500;
/// Residuals of a body that is blurred, over those of the level above, at least: there the blur is half as long. Of a flag that moved by 7 pixels while the shutter was open they were 1.85 times as
/// large, of wrong poses 0.9 to 1.3 times. Raised, blurred bodies are refused where they are found; lowered, wrong poses cost more.
const BLURRED: f64 = 1.5;
/// Share of the tiles that take part at the level above, from which on residuals that are about as large as there, or larger, are blur: what is blurred in one tile is blurred in all, and more so at the
/// finest level. Of 90 alignments of objects the share was 0.69 to 0.96 where a blurred body was found and 0.5 to 0.65 where something else was, or much was covered. Raised and lowered as `BLURRED`.
const FITS_ABOVE: f64 = 0.67;
/// Such residuals, over those of the level above, at least. Chosen: a flag whose rim was covered left 3.03 and 3.07 sigmas, and 1.7 once its blur was known. Raised and lowered as `BLURRED`.
const BLURRED_WHERE_IT_FITS: f64 = 0.75;
/// Share of the tiles that take part in a pose whose blur is asked: a little more than the half that always does. Raised, strongly blurred bodies are not asked;
/// lowered, wrong poses cost more.
const HOPEFUL_SHARE: f64 = 0.55;

/// Residuals of the tiles that fit of a covered body, sigmas, from which on its blur is asked. Without blur they are 0.9 to 1.2. Raised, quick bodies are found later where they come out from behind
/// something; lowered, bodies that stand still cost more.
const COVERED_BLUR_SCALE: f64 = 1.4;

impl FrameProblem<'_> {
    /// Whether a frame of a body that was just found may be asked for the velocity that its blur shows: where rows are read one after another the pose goes with it.
    pub(super) fn may_ask_blur(&self) -> bool {
        !self.is_followed && !self.slow.shutter.is_global()
    }

    /// Solves the finest level once more with the velocity that its blur shows, of a body that was just found; false if it shows none. `None` where there is no
    /// solution any more.
    pub fn solve_with_blur(&mut self) -> Option<bool> {
        // What stands still has none. Of a wrong pose the better half takes part, as ever, and its blur says nothing.
        let is_global = self.slow.shutter.is_global();
        let scale = self.buffers.fine.solution()?.found.scale;
        let is_blurred = self.is_clearly_blurred(scale);
        if self.buffers.has_kept || (self.buffers.fine.open_share() < HOPEFUL_SHARE && !is_blurred) {
            return Some(false);
        }
        // Where all rows are exposed together the pose does not need it. A picture that is large enough for the coarsest level is followed without, too, unless it does not fit.
        if is_global && !is_blurred && self.has_pixels(LEVELS - 1) {
            return Some(false);
        }
        self.settle_with_blur()
    }

    /// The same for a body that is covered in part, once it is known what fits; `scale`: of its residuals, sigmas.
    pub fn solve_covered_with_blur(&mut self, scale: f64) -> Option<bool> {
        let may_be_blurred = self.is_found_again() && self.slow.shutter.is_global() && scale > COVERED_BLUR_SCALE;
        if !may_be_blurred || self.has_pixels(LEVELS - 1) {
            return Some(false);
        }
        self.settle_with_blur()
    }

    /// Settles with the velocity that the blur shows; false if it shows none.
    fn settle_with_blur(&mut self) -> Option<bool> {
        let Some(by_blur) = self.velocity_by_blur() else { return Some(false) };
        // The velocity that is expected, and the blur's, together.
        let (mut expected, mut information) = (self.expected.motion, *self.known.information);
        let mut of_velocity = information.fixed_view_mut::<6, 6>(6, 6);
        let score = of_velocity.clone_owned() * expected.twist() + by_blur.score;
        of_velocity += by_blur.information;
        expected = expected.with_twist(&of_velocity.clone_owned().cholesky()?.solve(&score));
        self.has_opposite = by_blur.has_opposite;
        self.settle(by_blur.motion, &Expected { motion: &expected, information: &information, ..self.known })?;
        Some(true)
    }

    /// Whether a body that was just found leaves such residuals at the finest level because it is blurred. Where rows are read one after another, they tell its velocity.
    pub(super) fn is_clearly_blurred(&self, scale: f64) -> bool {
        !self.is_followed && self.slow.shutter.is_global() && shows_blur(scale, &self.above)
    }

    /// The velocity that the blur of the solved frame shows.
    fn velocity_by_blur(&mut self) -> Option<VelocityByBlur> {
        let found = self.buffers.fine.solution()?.found;
        let spec = self.spec(FINEST, &found.motion);
        let estimate = self.buffers.fine.solution()?.estimate();
        let middle = nearest_centre(self.surfaces, &found.motion.pose);
        let spec = LevelSpec { count: BLUR_PIXELS, ..spec };
        // The coarse levels are done with: their buffers are free.
        let Buffers { coarse: aside, selector, light, .. } = &mut *self.buffers;
        if !aside.lay_out(&spec, self.levels, &found.motion, selector, light) {
            return None;
        }
        let known = KnownBlur {
            exposure_sigma: self.slow.exposure_sigma(),
            psf_variance: self.slow.psf_variance,
            psf_variance_sigma: PSF_VARIANCE_SIGMA,
        };
        velocity_by_blur(aside, &spec, &estimate, middle, known)
    }
}

/// Whether residuals of the finest level, sigmas, are those of a blur, by the fit of the level above.
fn shows_blur(scale: f64, above: &LevelFit) -> bool {
    let ratio = if above.open_share > FITS_ABOVE { BLURRED_WHERE_IT_FITS } else { BLURRED };
    scale > CLOSE_SCALE.max(ratio * above.scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_fits_but_for_its_detail_is_blurred_and_what_fits_in_part_only_if_its_detail_is_far_worse() {
        let above = |scale, open_share| LevelFit { scale, open_share };
        assert!(shows_blur(4.2, &above(2.9, 0.88)) && !shows_blur(4.2, &above(2.9, 0.55)));
        assert!(shows_blur(7.8, &above(5.0, 0.5)) && shows_blur(3.0, &above(3.1, 0.85)) && !shows_blur(7.8, &above(11.0, 0.9)));
        // Noise is no blur, and without a level above nothing is known.
        assert!(!shows_blur(1.5, &above(0.8, 0.9)) && !shows_blur(9.0, &LevelFit::NONE));
    }
}
